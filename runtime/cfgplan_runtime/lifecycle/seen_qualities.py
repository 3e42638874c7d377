"""The qualities that streams say, and the estimates learned from them, as one value."""

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
    """The qualities that streams have said since the last update, and the estimates learned in the whole run."""

    windows: Mapping[Said, Window] = field(default_factory=dict)
    heard: frozenset[str] = frozenset()
    """Units that have reported since the last update; their first report may be about elements before it."""
    taught_s: Mapping[Said, float] = field(default_factory=dict)
    """When each stream last confirmed the estimates, since the last update."""
    is_new: bool = False
    """Whether streams have said something since the last lesson."""
    estimates: Estimates = field(default_factory=dict)

    def after_status(self, status: UnitStatus, at_s: float) -> SeenQualities:
        """Take in the qualities in a unit's report."""
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
        """Keep the learned estimates. Clear the windows of streams with news: their means then follow it."""
        windows = {said: window for said, window in self.windows.items() if said not in lesson.news}
        taught_s = {**self.taught_s, **dict.fromkeys(fresh, at_s)}
        return replace(self, windows=windows, taught_s=taught_s, is_new=False, estimates=lesson.estimates)

    def after_update(self, started: Iterable[str]) -> SeenQualities:
        """Clear the windows, since units have other inputs now. Reports of new units count from the first."""
        return SeenQualities(heard=frozenset(started), estimates=self.estimates)

    def without(self, unit: str) -> SeenQualities:
        """Forget the reports of a unit that has ended."""
        if unit not in self.heard:
            return self
        windows = {said: window for said, window in self.windows.items() if said[0].unit != unit}
        taught_s = {said: at_s for said, at_s in self.taught_s.items() if said[0].unit != unit}
        return replace(self, windows=windows, heard=self.heard - {unit}, taught_s=taught_s)
