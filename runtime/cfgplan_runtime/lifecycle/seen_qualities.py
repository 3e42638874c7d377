"""The qualities that streams say, and the estimates learned from them, as one value."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from math import isfinite

from cfgplan.domain import Environment, Stream
from cfgplan.observed import Estimates, Figures, Lesson, Said, Window
from cfgplan.qualities import MICRO
from cfgplan_runtime.children.messages import Qualities
from cfgplan_runtime.supervision.events import UnitStatus

Losing = Mapping[tuple[str, str], Said]
"""By unit and input: the stream that feeds it alone, and the attribute that is its measured loss."""


def losing_streams(running: Environment, library: Environment) -> Losing:
    """Return the inputs of running units at which the loss of a stream is measured, as a library says."""
    found: dict[tuple[str, str], Said] = {}
    for statement in library.losing:
        for unit in running.units:
            for port, streams in unit.feeds.items():
                provider = running.unit.get(streams[0].unit)
                if (
                    len(streams) == 1
                    and provider is not None
                    and (provider.transformation, streams[0].port) == (statement.transformation, statement.output)
                ):
                    found[unit.id, port] = streams[0], statement.attribute
    return found


@dataclass(frozen=True, slots=True)
class SeenQualities:
    """The qualities that streams have said since the last update, and the estimates learned in the whole run."""

    windows: Mapping[Said, Window] = field(default_factory=dict)
    heard: frozenset[str] = frozenset()
    """Units that have reported since the last update; their first report may be about elements before it."""
    taught_s: Mapping[Said, float] = field(default_factory=dict)
    """When each stream last confirmed the estimates, since the last update."""
    counts: Mapping[tuple[str, str], tuple[int, int]] = field(default_factory=dict)
    """By unit and input: the elements that came and those that were lost, at the last report since the last update."""
    is_new: bool = False
    """Whether streams have said something since the last lesson."""
    estimates: Estimates = field(default_factory=dict)

    def after_status(self, status: UnitStatus, at_s: float) -> SeenQualities:
        """Take in the qualities in a unit's report."""
        return self.after_said(status.unit, status.qualities, at_s)

    def after_said(self, unit: str, qualities: Qualities, at_s: float) -> SeenQualities:
        """Take in the qualities of a unit's outputs."""
        if not qualities:
            return self
        if unit not in self.heard:
            return replace(self, heard=self.heard | {unit})
        windows = dict(self.windows)
        for port, said in qualities.items():
            for attribute, quality in said.items():
                key = (Stream(unit, port), attribute)
                figures = Figures(quality.elements, quality.mean * MICRO, quality.squares * MICRO**2)
                if not (isfinite(figures.mean) and isfinite(figures.squares)):
                    continue  # children send no such sums: what is on the wire is from something else
                windows[key] = windows.get(key, Window(at_s)).after(figures, at_s)
        return replace(self, windows=windows, is_new=True)

    def after_counts(self, status: UnitStatus, losing: Losing, at_s: float) -> SeenQualities:
        """Take in the share of elements that were lost on the way to the inputs of a unit, if streams are `losing`."""
        counts, windows, is_new = dict(self.counts), dict(self.windows), self.is_new
        for port, now in status.inputs.items():
            if (status.unit, port) not in losing:
                continue
            came, lost = now.elements, now.dropped
            before = counts.get((status.unit, port))
            counts[status.unit, port] = came, lost
            if before is None or came + lost <= sum(before):
                continue
            share = Figures(1, (lost - before[1]) / (came + lost - sum(before)) * MICRO)
            said = losing[status.unit, port]
            windows[said] = windows.get(said, Window(at_s)).after(share, at_s)
            is_new = True
        return replace(self, counts=counts, windows=windows, is_new=is_new)

    def after_lesson(self, lesson: Lesson, fresh: Collection[Said], at_s: float) -> SeenQualities:
        """Keep the learned estimates. Clear the windows of streams with news, so that old values no longer count."""
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
        counts = {key: count for key, count in self.counts.items() if key[0] != unit}
        return replace(self, windows=windows, heard=self.heard - {unit}, taught_s=taught_s, counts=counts)
