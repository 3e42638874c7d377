"""The quality of a wiring's streams, and whether it is enough for the targets."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator

from cfgplan.domain import ComputationUnit, Environment, Stream, Target, Transformation
from cfgplan.qualities import QualityAttribute, Wish, delayed, is_met, price_us, propagated, units
from cfgplan.validity.facts import known_units
from cfgplan.validity.hosts import latency
from cfgplan.validity.rules import Rule, Violation


def quality_violations(environment: Environment) -> Iterator[Violation]:
    """The bounds of targets that their streams miss."""
    for target, wish, value in _asked(environment, lambda wish: wish.bound is not None):
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
    """The prices that targets set on the quality of their streams."""
    priced = _asked(environment, lambda wish: wish.weight_us > 0)
    return sum(price_us(environment.quality[wish.attribute], wish, value) for _, wish, value in priced)


def _asked(environment: Environment, counts: Callable[[Wish], bool]) -> Iterator[tuple[Target, Wish, int]]:
    """Yield the wishes for which `counts` holds of targets that have a stream, with the value of that stream."""
    publisher = {p.topic: (unit, p.port) for unit in environment.units for p in unit.publications}
    served = [target for target in environment.targets if target.topic in publisher]
    wishes = [(target, wish) for target in served for wish in target.quality if counts(wish)]
    order = _feeders_first(environment) if wishes else []
    asked = {wish.attribute for _, wish in wishes}
    values = {name: _values(environment, environment.quality[name], order) for name in asked}
    for target, wish in wishes:
        attribute, (unit, port) = environment.quality[wish.attribute], publisher[target.topic]
        value = values[wish.attribute].get((unit.id, port), attribute.worst)
        by = latency(environment, attribute.name, unit.host, target.host)
        yield target, wish, delayed(attribute, value, by)


def _feeders_first(environment: Environment) -> list[tuple[ComputationUnit, Transformation]]:
    """Return the units, each after its feeders (except by feedback); units in a cycle or behind one are left out."""
    known = {unit.id: (unit, transformation) for unit, transformation in known_units(environment)}
    feeders, readers = dict[str, int](), defaultdict[str, list[str]](list)
    for unit, transformation in known.values():
        ordinary = [port.name for port in transformation.inputs if not port.feedback]
        feeding = {feed.unit for name in ordinary for feed in unit.feeds.get(name, ())} & known.keys()
        feeders[unit.id] = len(feeding)
        for feeder in feeding:
            readers[feeder].append(unit.id)
    order = [unit_id for unit_id, number in feeders.items() if not number]
    for unit_id in order:
        for reader in readers[unit_id]:
            feeders[reader] -= 1
            order += [reader] if not feeders[reader] else []
    return [known[unit_id] for unit_id in order]


def _values(
    environment: Environment,
    attribute: QualityAttribute,
    order: Iterable[tuple[ComputationUnit, Transformation]],
) -> dict[tuple[str, str], int]:
    """Return the value of each stream, by its unit and port; an input has the worst value if it is unfed, or fed from
    outside `order`.
    """
    values: dict[tuple[str, str], int] = {}

    def come(feed: Stream | None, host: str | None) -> int:
        value = None if feed is None else values.get((feed.unit, feed.port))
        if feed is None or value is None:
            return attribute.worst
        return delayed(attribute, value, latency(environment, attribute.name, at[feed.unit], host))

    at = {unit.id: unit.host for unit, _ in order}
    for unit, transformation in order:
        ordinary = [port.name for port in transformation.inputs if not port.feedback]
        gap = {port.name: () if port.optional else (None,) for port in transformation.inputs}
        feeds = [feed for name in ordinary for feed in unit.feeds.get(name, gap[name])]
        inputs = [come(feed, unit.host) for feed in feeds]
        for port in transformation.outputs:
            stated = {contribution.attribute: contribution.on(unit.host) for contribution in port.quality}
            values[unit.id, port.name] = propagated(attribute, stated.get(attribute.name), inputs)
    return values
