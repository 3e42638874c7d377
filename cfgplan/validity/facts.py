"""Facts that the judge derives from an environment: known units, their inputs and costs, streams, needed units."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping

from cfgplan.domain import ComputationUnit, Environment, InputPort, Similarity, Stream, Transformation


def known_units(environment: Environment) -> Iterator[tuple[ComputationUnit, Transformation]]:
    for unit in environment.units:
        if unit.transformation in environment.transformation:
            yield unit, environment.transformation[unit.transformation]


def running_inputs(environment: Environment) -> Iterator[tuple[ComputationUnit, InputPort]]:
    """Yield the inputs of the units that run."""
    for unit, transformation in known_units(environment):
        for port in transformation.inputs if not unit.standby else ():
            yield unit, port


def offers(
    environment: Environment, similarity: Similarity, port: InputPort
) -> Iterator[tuple[Stream, Transformation]]:
    """Yield the streams of running units that match an input, with the units' transformations."""
    for other, transformation in known_units(environment):
        for output in transformation.outputs if not other.standby else ():
            if similarity.holds(output.tag, port.tag):
                yield Stream(other.id, output.name), transformation


def costs_there(
    environment: Environment, unit: ComputationUnit, transformation: Transformation
) -> tuple[int, int, int]:
    """Return a unit's labor, upkeep and standby on its host, in microseconds: as seen there, else divided by
    its speed.
    """
    costs = (transformation.labor_us, transformation.upkeep_us, transformation.standby_us or 0)
    host = environment.host.get(unit.host or "")
    if host is None:
        return costs
    labor_us, upkeep_us, standby_us = (-(-cost * 10**6 // host.speed) for cost in costs)
    return (*transformation.seen_us.get(host.name, (labor_us, upkeep_us)), standby_us)


def tag_of(environment: Environment, stream: Stream) -> str | None:
    unit = environment.unit.get(stream.unit)
    transformation = environment.transformation.get(unit.transformation) if unit and not unit.standby else None
    port = transformation.output.get(stream.port) if transformation else None
    return port.tag if port else None


def meeting_targets(environment: Environment) -> set[str]:
    """Return the units that publish on a target's topic, and the first running unit of each wanted transformation."""
    topics = {target.topic for target in environment.targets if target.run is None}
    found = {unit.id for unit in environment.units if any(p.topic in topics for p in unit.publications)}
    for target in environment.targets:
        found.update(sorted(u.id for u in environment.units if u.transformation == target.run and not u.standby)[:1])
    return found


NOBODY: Mapping[str, list[str]] = {}


def company_of(environment: Environment) -> dict[str, list[str]]:
    """Return, for each running unit, the units of `beside` that are the only ones of their kind on its host."""
    running: dict[tuple[str, str | None], list[str]] = defaultdict(list)
    for unit in environment.units:
        if not unit.standby:
            running[unit.transformation, unit.host].append(unit.id)
    found = {}
    for unit, transformation in known_units(environment):
        beside = [running[other, unit.host] for other in transformation.beside if not unit.standby]
        found[unit.id] = [ids[0] for ids in beside if len(ids) == 1]
    return found


def needed_by(environment: Environment, roots: Collection[str], company: Mapping[str, list[str]] = NOBODY) -> set[str]:
    """Return the ids of `roots`, of all units whose streams they use, directly or through others, and of their
    `company`.

    An input that starts nothing (`starts_nothing`) makes no unit needed.
    """
    needed: set[str] = set()
    ahead = [root for root in roots if root in environment.unit]
    while ahead:
        unit_id = ahead.pop()
        if unit_id not in needed:
            needed.add(unit_id)
            unit = environment.unit[unit_id]
            transformation = environment.transformation.get(unit.transformation)
            idle = {port.name for port in transformation.inputs if port.starts_nothing} if transformation else ()
            feeders = [s.stream.unit for s in unit.subscriptions if s.port not in idle]
            ahead += [feeder for feeder in feeders if feeder in environment.unit]
            ahead += company.get(unit_id, ())
    return needed
