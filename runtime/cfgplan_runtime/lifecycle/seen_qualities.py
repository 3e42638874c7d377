"""What streams have said of how good they are, and what was learned of it, as one value."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from math import isfinite

from cfgplan.domain import Stream
from cfgplan.observed import Estimates, Figures, Lesson, Said, Window
from cfgplan.qualities import MICRO
from cfgplan_runtime.supervision.events import UnitStatus


@dataclass(frozen=True, slots=True)
class SeenQualities:
    """What streams have said of quality attributes since the last update, and what was learned ever."""

    windows: Mapping[Said, Window] = field(default_factory=dict)
    heard: frozenset[str] = frozenset()
    """Units that have spoken since the last update; the first time, they may speak of streams before it."""
    taught_s: Mapping[Said, float] = field(default_factory=dict)
    """When each stream last taught, since the last update, though nothing was new."""
    is_new: bool = False
    """Whether something was said of which nobody has learned."""
    estimates: Estimates = field(default_factory=dict)

    def after_status(self, status: UnitStatus, at_s: float) -> SeenQualities:
        """Take in what the outputs of a unit said."""
        if not status.qualities:
            return self
        if status.unit not in self.heard:
            return replace(self, heard=self.heard | {status.unit})
        windows = dict(self.windows)
        for port, said in status.qualities.items():
            for attribute, quality in said.items():
                key = (Stream(status.unit, port), attribute)
                figures = Figures(quality.elements, quality.mean * MICRO, quality.squares * MICRO**2)
                if not (isfinite(figures.mean) and isfinite(figures.squares)):
                    continue  # children send no such sums: what is on the wire is from something else
                windows[key] = windows.get(key, Window(at_s)).after(figures, at_s)
        return replace(self, windows=windows, is_new=True)

    def after_lesson(self, lesson: Lesson, fresh: Collection[Said], at_s: float) -> SeenQualities:
        """Keep what was learned. What was news begins anew, so that its mean is soon of what is so now."""
        windows = {said: window for said, window in self.windows.items() if said not in lesson.news}
        taught_s = {**self.taught_s, **dict.fromkeys(fresh, at_s)}
        return replace(self, windows=windows, taught_s=taught_s, is_new=False, estimates=lesson.estimates)

    def after_update(self, started: Iterable[str]) -> SeenQualities:
        """Begin anew: units have other inputs now. What was learned stays. The first word of new units counts."""
        return SeenQualities(heard=frozenset(started), estimates=self.estimates)

    def without(self, unit: str) -> SeenQualities:
        """Forget what the outputs of a unit said that has ended."""
        if unit not in self.heard:
            return self
        windows = {said: window for said, window in self.windows.items() if said[0].unit != unit}
        taught_s = {said: at_s for said, at_s in self.taught_s.items() if said[0].unit != unit}
        return replace(self, windows=windows, heard=self.heard - {unit}, taught_s=taught_s)
