"""Looks: a transformation that was found too bad runs for some seconds, to see whether it has become better.

A transformation that does not run is not observed. If streams have said that it is worse than declared, and the planner
would choose it if it were as good as declared, it runs for LOOK_S seconds without subscribers; a slow stream is looked
at until it has given enough elements. If a look finds nothing new, the next one at this transformation comes later.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from math import inf
from typing import Final, NamedTuple

from cfgplan.domain import Environment, Statement
from cfgplan.observed import Estimates
from cfgplan_runtime.lifecycle.seen_qualities import SeenQualities

LOOK_S: Final = 3.0
LONGEST_LOOK_S: Final = 60.0
"""A stream that has said too little by then is not waited for."""
LONGEST_INTERVAL_S: Final = 960.0
NEW: Final = 0.2
"""A look finds something new if a quality differs by more than this share from its known value."""


class Pause(NamedTuple):
    """When a transformation was looked at last, or was of no use, and the seconds from then to its next look."""

    since_s: float
    interval_s: float


@dataclass(frozen=True, slots=True)
class Looks:
    """When the next look at each transformation is due, and the look under way."""

    pauses: Mapping[str, Pause] = field(default_factory=dict)
    """By transformation, whether it said anything in its look or not."""
    label: str = ""
    """The transformation that is looked at."""
    units: tuple[str, ...] = ()
    """The units of the look."""
    since_s: float = 0.0
    until_s: float = inf
    known: Mapping[Statement, int] = field(default_factory=dict)
    """The deviations of the observed outputs that were known before the look, in micro-units."""

    def due_s(self, label: str, seen_s: float, least_interval_s: float) -> float:
        """Return when the next look is due at a transformation that was observed last at `seen_s`."""
        pause = self.pauses.get(label)
        return max(seen_s + least_interval_s, -inf if pause is None else pause.since_s + pause.interval_s)

    def begun(self, labels: Iterable[str], at_s: float, least_interval_s: float) -> Looks:
        """Note that looks at transformations were planned: the next ones come after twice their intervals, at least."""
        doubled_s = {label: 2 * self.pauses[label].interval_s if label in self.pauses else 0.0 for label in labels}
        new = {
            label: Pause(at_s, min(max(next_s, least_interval_s), LONGEST_INTERVAL_S))
            for label, next_s in doubled_s.items()
        }
        return Looks({**self.pauses, **new})

    def at(self, label: str, qualities: Mapping[Statement, int]) -> Looks:
        """Look at this transformation, and keep its known deviations for comparison."""
        known = {one: seen for one, seen in qualities.items() if one.transformation == label}
        return replace(self, label=label, known=known)

    def running(self, units: tuple[str, ...], at_s: float) -> Looks:
        """Note that the units of the look run from now on."""
        return replace(self, units=units, since_s=at_s, until_s=at_s + LOOK_S)

    def longer(self, running: Environment, seen: SeenQualities) -> Looks:
        """Continue a look at running units that have given too few elements, for LONGEST_LOOK_S at most."""
        sampled = {
            Statement(running.unit[stream.unit].transformation, stream.port, attribute)
            for (stream, attribute), window in seen.windows.items()
            if stream.unit in self.units and stream.unit in running.unit and window.sample is not None
        }
        taught = {one for one in self.known if one in seen.estimates and seen.estimates[one].seen_s >= self.since_s}
        is_running = any(unit in running.unit for unit in self.units)
        if not is_running or self.known.keys() <= sampled | taught or self.until_s >= self.since_s + LONGEST_LOOK_S:
            return self
        return replace(self, until_s=self.until_s + LOOK_S)

    def over(self, world: Environment, qualities: Mapping[Statement, int], least_interval_s: float) -> Looks:
        """End the look; if it has found something new, the next one comes sooner."""
        has_taught = any(
            abs(qualities.get(one, 0) - seen) > NEW * abs(stated.stated + seen)
            for one, seen in self.known.items()
            if (stated := world.stated(one)) is not None
        )
        pause = self.pauses.get(self.label)
        if pause is None or not has_taught:
            return Looks(self.pauses)
        sooner = pause._replace(interval_s=max(pause.interval_s / 4, least_interval_s))
        return Looks({**self.pauses, self.label: sooner})


def worse_seen_s(world: Environment, qualities: Mapping[Statement, int], estimates: Estimates) -> dict[str, float]:
    """Return when each transformation that is known to be worse than declared was last observed, by label."""
    found: dict[str, float] = {}
    for statement, seen in qualities.items():
        attribute, known = world.quality.get(statement.attribute), estimates.get(statement)
        if attribute is not None and known is not None and attribute.sign * seen > 0:
            found[statement.transformation] = max(known.seen_s, found.get(statement.transformation, -inf))
    return found
