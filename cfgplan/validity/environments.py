"""Every rule that a running configuration breaks (Definition 9)."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterator
from graphlib import CycleError, TopologicalSorter
from typing import Final, NamedTuple

from cfgplan.arguments import Natural
from cfgplan.domain import ALL, Environment, Similarity, Stream
from cfgplan.planning import Failures, Feature
from cfgplan.validity.counts import serving_violations, unfed_violations
from cfgplan.validity.facts import (
    company_of,
    known_units,
    meeting_targets,
    needed_by,
    offers,
    running_inputs,
    tag_of,
)
from cfgplan.validity.hosts import company_violations, link_violations, placing_violations
from cfgplan.validity.quality import quality_violations
from cfgplan.validity.rules import Rule, Violation
from cfgplan.validity.survival import justified_spares, survival_violations


class _Judged(NamedTuple):
    """A configuration that is judged, with the other arguments of `violations`."""

    environment: Environment
    similarity: Similarity
    survive: Failures | None
    horizon_s: int
    spares: Collection[str]
    before: Environment


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
    before = environment if before is None else before
    judged = _Judged(environment, similarity, survive, horizon_s, spares, before)
    asked = environment.features if survive is None else environment.features | {Feature.SURVIVAL}
    for find, features in _CHECKS:
        if not features or not features.isdisjoint(asked):
            yield from find(judged)


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


def _bad_counts(environment: Environment, similarity: Similarity) -> Iterator[Violation]:
    """Yield each input that has too few or too many streams, several of one unit, or not all that it must take."""
    for unit, port in running_inputs(environment):
        streams = unit.feeds.get(port.name, ())
        where, number = f"input {port.name} of unit {unit.id}", len(streams)
        if port.count == ALL:
            offered = {stream for stream, _ in offers(environment, similarity, port) if stream.unit != unit.id}
            missed = sorted(offered.difference(streams))
            if any(stream.unit == unit.id for stream in streams):
                yield Violation(Rule.FED, f"{where} takes the streams of other units, not its own", unit.id, port.name)
            if missed:
                yield Violation(Rule.FED, f"{where} takes all that matches, but not {missed[0]}", unit.id, port.name)
        elif number and number != port.count:
            counted = "one stream" if port.count == 1 else f"{port.count} streams"
            text = f"{where} takes {counted}, but has {number}: {', '.join(map(str, streams))}"
            yield Violation(Rule.FED, text, unit.id, port.name)
        if port.count > 1 and len({stream.unit for stream in streams}) < number:
            yield Violation(Rule.FED, f"{where} takes streams of different units", unit.id, port.name)


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


def _needless_units(judged: _Judged) -> Iterator[Violation]:
    environment, similarity, survive, _, spares, before = judged
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


_ALWAYS: Final = frozenset[Feature]()
_CHECKS: Final[tuple[tuple[Callable[[_Judged], Iterator[Violation]], frozenset[Feature]], ...]] = (
    (lambda judged: _unknown_transformations(judged.environment), _ALWAYS),
    (lambda judged: _bad_subscriptions(judged.environment, judged.similarity), _ALWAYS),
    (lambda judged: _bad_publications(judged.environment, judged.similarity), _ALWAYS),
    (lambda judged: missing_units(judged.environment), frozenset({Feature.RUNS})),
    (lambda judged: _bad_counts(judged.environment, judged.similarity), _ALWAYS),
    (lambda judged: unfed_violations(judged.environment, judged.similarity), frozenset({Feature.OPTIONAL})),
    (lambda judged: serving_violations(judged.environment), frozenset({Feature.LIMITS})),
    (lambda judged: _cycles(judged.environment), _ALWAYS),
    (lambda judged: _indistinct_feeds(judged.environment), _ALWAYS),
    (lambda judged: quality_violations(judged.environment), frozenset({Feature.QUALITY})),
    (lambda judged: placing_violations(judged.environment, judged.horizon_s), frozenset({Feature.HOSTS})),
    (
        lambda judged: company_violations(judged.environment),
        frozenset({Feature.BESIDE, Feature.INSTANCES, Feature.CONFLICTS}),
    ),
    (lambda judged: link_violations(judged.environment), frozenset({Feature.HOSTS})),
    (lambda judged: instance_violations(judged.environment), frozenset({Feature.INSTANCES, Feature.CONFLICTS})),
    (
        lambda judged: survival_violations(judged.environment, judged.similarity, judged.survive),
        frozenset({Feature.SURVIVAL}),
    ),
    (_needless_units, _ALWAYS),
)
"""Each rule, in order, and the features that it is about: without them nothing can break it. _ALWAYS has none: the rule
holds for all environments.
"""
