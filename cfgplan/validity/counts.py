"""Rules of optional inputs, which may stay unfed at a price, and of outputs that serve only so many."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator

from cfgplan.domain import ALL, ComputationUnit, Environment, InputPort, Similarity, Stream
from cfgplan.validity.facts import known_units, offers, running_inputs
from cfgplan.validity.rules import Rule, Violation


def unfed_violations(environment: Environment, similarity: Similarity) -> Iterator[Violation]:
    """Yield each optional input that is not fed although running units could feed it at no cost."""
    for unit, port in running_inputs(environment):
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
    unfed = (port for unit, port in running_inputs(environment) if port.optional and port.name not in unit.feeds)
    return sum(port.worth_us for port in unfed) * horizon_s


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
    for stream, feeder in offers(environment, similarity, port):
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
