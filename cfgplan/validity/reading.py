"""What the judge reads off an environment: known units, tags of streams, what is needed."""

from __future__ import annotations

from collections.abc import Collection, Iterator

from cfgplan.domain import ComputationUnit, Environment, Stream, Transformation


def known_units(environment: Environment) -> Iterator[tuple[ComputationUnit, Transformation]]:
    for unit in environment.units:
        if unit.transformation in environment.transformation:
            yield unit, environment.transformation[unit.transformation]


def tag_of(environment: Environment, stream: Stream) -> str | None:
    unit = environment.unit.get(stream.unit)
    transformation = environment.transformation.get(unit.transformation) if unit and not unit.standby else None
    port = transformation.output.get(stream.port) if transformation else None
    return port.tag if port else None


def publishers(environment: Environment) -> set[str]:
    topics = {target.topic for target in environment.targets}
    return {unit.id for unit in environment.units if any(p.topic in topics for p in unit.publications)}


def needed_by(environment: Environment, roots: Collection[str]) -> set[str]:
    """The ids of `roots` and of all units whose streams they use, directly or through others."""
    needed: set[str] = set()
    ahead = [root for root in roots if root in environment.unit]
    while ahead:
        unit_id = ahead.pop()
        if unit_id not in needed:
            needed.add(unit_id)
            feeders = [s.stream.unit for s in environment.unit[unit_id].subscriptions]
            ahead += [feeder for feeder in feeders if feeder in environment.unit]
    return needed
