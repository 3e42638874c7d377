"""Every rule that a running configuration breaks (Definition 9)."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Collection, Iterator
from graphlib import CycleError, TopologicalSorter

from cfgplan.arguments import Natural
from cfgplan.domain import Environment, Similarity, Stream
from cfgplan.planning import Failures
from cfgplan.validity.counts import count_violations, serving_violations, unfed_violations
from cfgplan.validity.facts import company_of, known_units, meeting_targets, needed_by, tag_of
from cfgplan.validity.hosts import company_violations, link_violations, placing_violations
from cfgplan.validity.quality import quality_violations
from cfgplan.validity.rules import Rule, Violation
from cfgplan.validity.survival import justified_spares, survival_violations


def violations(
    environment: Environment,
    similarity: Similarity,
    survive: Failures | None = None,
    horizon_s: Natural = 0,
    spares: Collection[str] = (),
    before: Environment | None = None,
) -> list[Violation]:
    """Return every rule that the running configuration violates; empty when it is valid (Definition 9).

    `before` is the environment that an update changed into this one; a pinned unit that it does not have must be
    needed. With `survive`, the configuration must survive every single failure of that kind. Host energy must last for
    `horizon_s` seconds. A caller that has checked survival already passes the `justified_spares` as `spares`, without
    `survive`.
    """
    return [*each_violation(environment, similarity, survive, horizon_s, spares, before)]


def each_violation(
    environment: Environment,
    similarity: Similarity,
    survive: Failures | None,
    horizon_s: int,
    spares: Collection[str],
    before: Environment | None,
) -> Iterator[Violation]:
    """Yield the violations that `violations` lists, rule by rule; a caller that stops at the first one leaves the other
    rules unchecked.
    """
    yield from _unknown_transformations(environment)
    yield from _bad_subscriptions(environment, similarity)
    yield from _bad_publications(environment, similarity)
    yield from missing_units(environment)
    yield from count_violations(environment, similarity)
    yield from unfed_violations(environment, similarity)
    yield from serving_violations(environment)
    yield from _cycles(environment)
    yield from _indistinct_feeds(environment)
    yield from quality_violations(environment)
    yield from placing_violations(environment, horizon_s)
    yield from company_violations(environment)
    yield from link_violations(environment)
    yield from instance_violations(environment)
    yield from survival_violations(environment, similarity, survive)
    yield from _needless_units(environment, similarity, survive, spares, environment if before is None else before)


def _unknown_transformations(environment: Environment) -> Iterator[Violation]:
    for unit in environment.units:
        if unit.transformation not in environment.transformation:
            yield Violation(
                Rule.KNOWN, f"unit {unit.id} instantiates {unit.transformation}, which is not in the library", unit.id
            )


def _bad_subscriptions(environment: Environment, similarity: Similarity) -> Iterator[Violation]:
    for unit, transformation in known_units(environment):
        for port in transformation.inputs if not unit.standby else ():
            if port.name not in unit.feeds and not port.optional:
                text = f"input {port.name} of unit {unit.id} is not connected"
                yield Violation(Rule.FED, text, unit.id, port.name)
        for name, stream in [(s.port, s.stream) for s in unit.subscriptions]:
            if name not in transformation.input:
                text = f"unit {unit.id} subscribes at {name}, which is not an input of {transformation.label}"
                yield Violation(Rule.FED, text, unit.id, name)
                continue
            offered = tag_of(environment, stream)
            if offered is None:
                text = f"input {name} of unit {unit.id} subscribes to {stream}, which nothing produces"
                yield Violation(Rule.FED, text, unit.id, name)
            elif not similarity.holds(offered, transformation.input[name].tag):
                wanted = transformation.input[name].tag
                is_open = similarity.is_open(offered, wanted)
                text = f"input {name} of unit {unit.id} needs {wanted}, {_unfit(stream, offered, is_open=is_open)}"
                yield Violation(Rule.MATCHING, text, unit.id, name, is_open=is_open)


def _bad_publications(environment: Environment, similarity: Similarity) -> Iterator[Violation]:
    published: dict[str, list[Stream]] = defaultdict(list)
    topics = {target.topic for target in environment.stream_targets}
    for unit, transformation in known_units(environment):
        for publication in unit.publications:
            published[publication.topic].append(Stream(unit.id, publication.port))
            if publication.port not in transformation.output:
                text = f"unit {unit.id} publishes {publication.port}, which is not an output of {transformation.label}"
                yield Violation(Rule.PUBLISHED, text, unit.id, publication.port)
            if publication.topic not in topics:
                text = f"unit {unit.id} publishes on {publication.topic}, which no target names"
                yield Violation(Rule.PUBLISHED, text, unit.id, publication.port)
    for target in environment.stream_targets:
        streams = published[target.topic]
        if len(streams) != 1:
            found = f"{len(streams)} streams are" if streams else "no stream is"
            text = f"{found} published on {target.topic}, the topic of target {target.label}"
            yield Violation(Rule.MET, text, target=target.label)
        for stream in streams:
            offered = tag_of(environment, stream)
            if offered is not None and not similarity.holds(offered, target.tag):
                is_open = similarity.is_open(offered, target.tag)
                text = f"target {target.label} wants {target.tag}, {_unfit(stream, offered, is_open=is_open)}"
                yield Violation(Rule.MATCHING, text, target=target.label, is_open=is_open)


def missing_units(environment: Environment) -> Iterator[Violation]:
    """Yield each target that wants a running unit of a transformation that has none."""
    running = {unit.transformation for unit in environment.units if not unit.standby}
    for target in environment.targets:
        if target.run is not None and target.run not in running:
            text = f"no unit of {target.run} runs, which target {target.label} wants"
            yield Violation(Rule.MET, text, target=target.label)


def _unfit(stream: Stream, offered: str, *, is_open: bool) -> str:
    gives = f"{stream} gives {offered}"
    return f"and it is undecided whether this matches: {gives}" if is_open else f"but {gives}"


def _cycles(environment: Environment) -> Iterator[Violation]:
    sorter: TopologicalSorter[str] = TopologicalSorter()
    for unit, transformation in known_units(environment):
        for s in unit.subscriptions:
            if s.port in transformation.input and not transformation.input[s.port].feedback:
                sorter.add(unit.id, s.stream.unit)
    try:
        sorter.prepare()
    except CycleError as error:
        cycle = error.args[1]
        text = f"units feed each other in a cycle with nothing from outside: {' -> '.join(cycle)}"
        yield Violation(Rule.GROUNDED, text, cycle[0])


def _indistinct_feeds(environment: Environment) -> Iterator[Violation]:
    for unit, transformation in known_units(environment):
        feeders: dict[tuple[str, str], list[str]] = defaultdict(list)
        for port in transformation.inputs:
            for stream in unit.feeds.get(port.name, ()) if port.distinct is not None else ():
                if port.distinct is not None and stream.unit in environment.unit:
                    feeders[port.distinct, environment.unit[stream.unit].transformation].append(port.name)
        for (_, feeder), ports in feeders.items():
            if len(ports) > 1:
                text = f"inputs {' and '.join(ports)} of unit {unit.id} must differ, but {feeder} feeds them all"
                yield Violation(Rule.DISTINCT, text, unit.id, ports[0])


def _needless_units(
    environment: Environment,
    similarity: Similarity,
    survive: Failures | None,
    spares: Collection[str],
    before: Environment,
) -> Iterator[Violation]:
    pinned = {
        unit.id for unit, transformation in known_units(environment) if transformation.pinned and not unit.standby
    }
    kept = pinned & before.unit.keys()
    kept |= asked_by_number(environment)
    company = company_of(environment)
    needed = needed_by(environment, meeting_targets(environment).union(kept, spares), company)
    if len(needed) < len(environment.units):
        needed |= needed_by(environment, justified_spares(environment, similarity, survive, needed), company)
    for unit in environment.units:
        if unit.id not in needed:
            yield Violation(Rule.LEAN, f"unit {unit.id} runs, but no target needs it", unit.id)


def instance_violations(environment: Environment) -> Iterator[Violation]:
    """Yield conflicting transformations that both have units, and transformations with too few or too many units."""
    there = Counter(unit.transformation for unit in environment.units)
    running = _running(environment)
    for transformation in environment.library:
        label = transformation.label
        for other in transformation.conflicts:
            if label in there and other in there and label != other:
                unit = next(u for u in environment.units if u.transformation == label)
                yield Violation(Rule.APART, f"units of {label} and {other}, which conflict, run together", unit.id)
        if len(running[label]) < transformation.min_instances:
            text = f"{len(running[label])} units of {label} run, but it asks for {transformation.min_instances}"
            yield Violation(Rule.INSTANCES, text)
        if transformation.max_instances is not None and there[label] > transformation.max_instances:
            yield Violation(
                Rule.INSTANCES,
                f"{there[label]} units of {label} are there, but it allows {transformation.max_instances}",
            )


def asked_by_number(environment: Environment) -> set[str]:
    """Return the running units of transformations that have at most `min_instances` of them."""
    running = _running(environment)
    return {
        unit_id
        for transformation in environment.library
        if len(running[transformation.label]) <= transformation.min_instances
        for unit_id in running[transformation.label]
    }


def _running(environment: Environment) -> dict[str, list[str]]:
    running: dict[str, list[str]] = defaultdict(list)
    for unit in environment.units:
        if not unit.standby:
            running[unit.transformation].append(unit.id)
    return running
