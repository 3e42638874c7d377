"""Targets whose topics are silent for longer than they may be, and the units that cause this."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from cfgplan.domain import ComputationUnit, Environment, Stream
from cfgplan_runtime.children.messages import Flow
from cfgplan_runtime.supervision.events import UnitStatus
from cfgplan_runtime.supervision.wiring import starved_units

_SIGN_S = 2.0
"""A sign of life may tell of elements that were given this long before."""
_TOLD_APART_S = 3.5
"""Seconds of silence after which it is known of every unit whether it sends elements."""


@dataclass(frozen=True, slots=True)
class Silence:
    """A target whose topic has been silent since `since_s` on the manager's clock.

    `units` are the cause, once known: they send nothing though all their sources send.
    """

    target: str
    topic: str
    stream: Stream
    since_s: float
    units: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Giving:
    """The last known streams of units and topics. Immutable: `after_...` return the next.

    `units`: how many elements a unit has given, and since when. `topics`: the stream that is published on a topic, and
    since when. `silent_s`: when a target fell silent, a review was last requested for it, or the configuration last
    changed.
    """

    units: Mapping[str, tuple[int, float]] = field(default_factory=dict)
    topics: Mapping[str, tuple[Stream, float]] = field(default_factory=dict)
    silent_s: Mapping[str, float] = field(default_factory=dict)
    looked_at: tuple[ComputationUnit, ...] = ()

    def after_status(self, status: UnitStatus, at_s: float) -> Giving:
        """Take in a unit's counts."""
        elements = sum(counts.elements for counts in status.outputs.values())
        known = self.units.get(status.unit)
        if known is not None and known[0] == elements:
            return self
        return replace(self, units={**self.units, status.unit: (elements, at_s)})

    def after_look(self, running: Environment, at_s: float) -> Giving:
        """Compare with the running configuration: forget units that have ended, and restart the times of topics with
        another stream.
        """
        published = {p.topic: Stream(unit.id, p.port) for unit in running.units for p in unit.publications}
        known = self.topics
        topics = {
            topic: known[topic] if topic in known and known[topic][0] == stream else (stream, at_s)
            for topic, stream in published.items()
        }
        units = {unit: gave for unit, gave in self.units.items() if unit in running.unit}
        is_new = running.units != self.looked_at
        return Giving(units, topics, dict.fromkeys(self.silent_s, at_s) if is_new else self.silent_s, running.units)

    def after_silences(self, silences: Sequence[Silence]) -> Giving:
        """Note that these targets are silent, and no others."""
        return replace(self, silent_s={one.target: self.silent_s.get(one.target, one.since_s) for one in silences})

    def after_asking(self, target: str, at_s: float) -> Giving:
        """Note that a review was requested because a target is silent."""
        return replace(self, silent_s={**self.silent_s, target: at_s})

    def silences(
        self, wanted: Environment, running: Environment, flows: Mapping[str, Flow], at_s: float
    ) -> tuple[Silence, ...]:
        """The targets of `wanted` that are silent for longer than they may be, by label."""
        silences, starved = [], starved_units(running)
        for target in wanted.targets:
            if target.silent_us is None or target.topic not in self.topics:
                continue
            stream, fed_s = self.topics[target.topic]
            if stream.unit in starved:  # something that it needs is missing, which a review knows
                continue
            came_s = flows.get(target.topic, Flow()).silent_s
            since_s = fed_s if came_s is None else max(fed_s, at_s - came_s)
            if at_s - since_s > target.silent_us / 1e6:
                is_known = at_s - since_s > _TOLD_APART_S
                units = self._reasons(stream.unit, running, since_s) if is_known else ()
                silences.append(Silence(target.label, target.topic, stream, since_s, units))
        return tuple(silences)

    def _reasons(self, last: str, running: Environment, since_s: float) -> tuple[str, ...]:
        """The units that send nothing though their sources send: `last`, or units upstream of it."""
        reasons, seen, ahead = set(), {last}, [last]
        while ahead:
            unit = ahead.pop()
            if self._gives(unit, since_s):
                continue
            feeders = {s.stream.unit for s in running.unit[unit].subscriptions} & running.unit.keys()
            silent = [feeder for feeder in feeders if not self._gives(feeder, since_s)]
            if not silent:
                reasons.add(unit)
            ahead += [feeder for feeder in silent if feeder not in seen]
            seen.update(silent)
        return tuple(sorted(reasons))

    def _gives(self, unit: str, since_s: float) -> bool:
        return unit in self.units and self.units[unit][1] > since_s + _SIGN_S
