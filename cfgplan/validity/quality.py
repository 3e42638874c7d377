"""How good the streams of a wiring are, and whether targets ask for more."""

from __future__ import annotations

from collections.abc import Iterator

from cfgplan.domain import Environment, Stream, Target
from cfgplan.qualities import QualityAttribute, Wish, is_met, price_us, propagated, units
from cfgplan.validity.rules import Rule, Violation


def quality_violations(environment: Environment) -> Iterator[Violation]:
    """The bounds of targets that their streams miss."""
    for target, wish, value in _asked(environment):
        attribute = environment.quality[wish.attribute]
        if not is_met(attribute, wish, value):
            assert wish.bound is not None
            side = "at most" if attribute.better == "lower" else "at least"
            text = (
                f"target {target.label} asks for {attribute.name} of {side} {units(wish.bound):f}, "
                f"but its stream has {units(value):f}"
            )
            yield Violation(Rule.QUALITY, text, target=target.label)


def priced_us(environment: Environment) -> int:
    """What targets charge for the quality of their streams."""
    return sum(price_us(environment.quality[wish.attribute], wish, value) for _, wish, value in _asked(environment))


def _asked(environment: Environment) -> Iterator[tuple[Target, Wish, int]]:
    """Each wish of a target that has a stream, with the value of that stream."""
    publisher = {p.topic: Stream(unit.id, p.port) for unit in environment.units for p in unit.publications}
    for target in environment.targets:
        if target.quality and target.topic in publisher:
            for wish in target.quality:
                value = _value(environment, environment.quality[wish.attribute], publisher[target.topic], {})
                yield target, wish, value


def _value(environment: Environment, attribute: QualityAttribute, stream: Stream, seen: dict[Stream, int]) -> int:
    """The value of a stream; the worst one where the wiring is broken, in a ring or at a gap."""
    if stream in seen:
        return seen[stream]
    seen[stream] = attribute.worst
    unit = environment.unit.get(stream.unit)
    transformation = environment.transformation.get(unit.transformation) if unit else None
    if unit is None or transformation is None or stream.port not in transformation.output:
        return attribute.worst
    ports = [port.name for port in transformation.inputs if not port.feedback]
    values = [
        _value(environment, attribute, unit.feeds[port], seen) if port in unit.feeds else attribute.worst
        for port in ports
    ]
    stated = {contribution.attribute: contribution for contribution in transformation.output[stream.port].quality}
    seen[stream] = propagated(attribute, stated.get(attribute.name), values)
    return seen[stream]
