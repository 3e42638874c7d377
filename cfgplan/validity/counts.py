"""Rules of inputs: the number of their streams, and the price of unfed optional ones."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator

from cfgplan.domain import ALL, ComputationUnit, Environment, InputPort, Similarity, Stream, Transformation
from cfgplan.validity.facts import known_units
from cfgplan.validity.rules import Rule, Violation


def count_violations(environment: Environment, similarity: Similarity) -> Iterator[Violation]:
    """Yield each input that has too few or too many streams, several of one unit, or not all that it must take."""
    for unit, port in _ports(environment):
        streams = unit.feeds.get(port.name, ())
        where, number = f"input {port.name} of unit {unit.id}", len(streams)
        if port.count == ALL:
            offered = {stream for stream, _ in _offers(environment, similarity, port) if stream.unit != unit.id}
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


def unfed_violations(environment: Environment, similarity: Similarity) -> Iterator[Violation]:
    """Yield each optional input that is not fed although running units could feed it at no cost."""
    for unit, port in _ports(environment):
        if port.starts_nothing and port.count != ALL and port.name not in unit.feeds:
            free = _free(environment, similarity, unit, port)
            if len(free) >= port.count:
                text = (
                    f"optional input {port.name} of unit {unit.id} is not fed, but {min(free.values())} could feed it"
                )
                yield Violation(Rule.FED, text, unit.id, port.name)


def serving_violations(environment: Environment) -> Iterator[Violation]:
    """Yield each stream with more subscribers and topics than its output serves."""
    for stream, left in _left_to_serve(environment).items():
        if left < 0:
            text = f"stream {stream} feeds too many inputs and topics: {-left} more than its output serves"
            yield Violation(Rule.SERVES, text, stream.unit, stream.port)


def _left_to_serve(environment: Environment) -> dict[Stream, int]:
    """Return how many more inputs and topics may take each stream of an output with a `serves` limit."""
    taken = Counter(s.stream for unit in environment.units for s in unit.subscriptions)
    taken.update(Stream(unit.id, p.port) for unit in environment.units for p in unit.publications)
    return {
        stream: port.serves - taken[stream]
        for unit, transformation in known_units(environment)
        for port in transformation.outputs
        for stream in [Stream(unit.id, port.name)]
        if port.serves is not None
    }


def unfed_us(environment: Environment, horizon_s: int) -> int:
    """The price of the unfed optional inputs, in microseconds."""
    unfed = (port for unit, port in _ports(environment) if port.optional and port.name not in unit.feeds)
    return sum(port.worth_us for port in unfed) * horizon_s


def _ports(environment: Environment) -> Iterator[tuple[ComputationUnit, InputPort]]:
    """The inputs of the units that run."""
    for unit, transformation in known_units(environment):
        for port in transformation.inputs if not unit.standby else ():
            yield unit, port


def _offers(
    environment: Environment, similarity: Similarity, port: InputPort
) -> Iterator[tuple[Stream, Transformation]]:
    """The streams of running units that match an input, with the units' transformations."""
    for other, transformation in known_units(environment):
        for output in transformation.outputs if not other.standby else ():
            if similarity.holds(output.tag, port.tag):
                yield Stream(other.id, output.name), transformation


def _free(
    environment: Environment, similarity: Similarity, unit: ComputationUnit, port: InputPort
) -> dict[str, Stream]:
    """The first stream of each unit (of each transformation where the input is distinct) that may feed an input."""
    group = [p for p in environment.transformation[unit.transformation].inputs if p.distinct == port.distinct]
    fed = [stream.unit for p in group for stream in unit.feeds.get(p.name, ())]
    there = {environment.unit[feeder].transformation for feeder in fed if feeder in environment.unit}
    barred = set() if port.feedback else _downstream(environment, unit)
    left = _left_to_serve(environment)
    found: dict[str, Stream] = {}
    for stream, feeder in _offers(environment, similarity, port):
        if (
            stream.unit not in barred
            and left.get(stream, 1) > 0
            and not (port.distinct is not None and feeder.label in there)
        ):
            found.setdefault(stream.unit if port.distinct is None else feeder.label, stream)
    return found


def _downstream(environment: Environment, unit: ComputationUnit) -> set[str]:
    """Return a unit and all units that it feeds, directly or through others, except by feedback inputs."""
    readers: dict[str, set[str]] = defaultdict(set)
    for other, transformation in known_units(environment):
        feedback = {port.name for port in transformation.inputs if port.feedback}
        for subscription in other.subscriptions:
            if subscription.port not in feedback:
                readers[subscription.stream.unit].add(other.id)
    found, ahead = {unit.id}, [unit.id]
    for here in ahead:
        new = readers[here] - found
        found |= new
        ahead += sorted(new)
    return found
