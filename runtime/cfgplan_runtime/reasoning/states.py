"""States made from streams: aligned in time, with a bound on their delay, and with missing samples marked.

In a state of time T each feature has the value of its last sample up to T, if that is at most `hold` old; else its
value is missing. A state is given as soon as every feature has a sample at or after T, or `delay` after T on the clock,
or when the sample that makes it a state comes, if that is later still. A sample that comes after a later state was
given is not used, and counts as late.

A missing value makes atoms unknown, never false.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from cfgplan.errors import InvalidValueError
from cfgplan_runtime.reasoning.reader import SECOND_NS


@dataclass(frozen=True, slots=True)
class Timing:
    """The times of states, and the age of values; in nanoseconds.

    With a rate, states come at each period. Without one, each sample makes a state (samples within `tolerance_ns` of
    the first make one), as does a value that becomes too old; and states come at least every `beat_ns`, so that silence
    is noticed. States begin without the features that have no sample after `patience_ns`.
    """

    hold_ns: int = SECOND_NS
    delay_ns: int = SECOND_NS // 5
    rate_hz: float | None = None
    tolerance_ns: int = 0
    beat_ns: int = SECOND_NS // 4
    patience_ns: int = 10 * SECOND_NS

    def __post_init__(self) -> None:
        if self.rate_hz is not None and not 0 < self.rate_hz <= 1e6:
            raise InvalidValueError(
                f"{self.rate_hz} states per second can't be a rate: write a number above 0 and up to 1,000,000"
            )
        if min(self.hold_ns, self.delay_ns, self.tolerance_ns, self.patience_ns) < 0 or self.beat_ns <= 0:
            raise InvalidValueError("a span of time is negative: give 0 or more seconds")


@dataclass(frozen=True, slots=True)
class FeatureState:
    """The features' values at a time; a feature without a value is missing."""

    time_ns: int
    values: Mapping[str, Any]
    is_forced: bool
    """True if the state was given at the end of the delay, before every feature had passed its time."""


@dataclass(slots=True)
class _Feature:
    hold_ns: int
    samples: deque[tuple[int, Any]] = field(default_factory=deque)
    """The last sample at or before the last state, and all after it."""


class Synchroniser:
    """Makes states from samples. Every `now_ns` is a time on the clock of the samples."""

    def __init__(self, holds_ns: Mapping[str, int | None], timing: Timing, *, begin_ns: int) -> None:
        self.late = 0
        """The number of samples that came after their state was given, or out of order."""
        self.missing = dict.fromkeys(holds_ns, 0)
        """For each feature, the number of states without its value."""
        self.states = 0
        self.forced = 0
        """The number of states that were given at the end of the delay."""
        self._timing = timing
        self._features = {
            name: _Feature(timing.hold_ns if hold_ns is None else hold_ns) for name, hold_ns in holds_ns.items()
        }
        self._begin_ns = begin_ns
        self._start_ns: int | None = None
        self._last_ns: int | None = None
        self._number = 0

    def push(self, feature: str, time_ns: int, value: Any) -> None:
        """Add a sample of a feature."""
        samples = self._features[feature].samples
        if samples and time_ns <= samples[-1][0]:
            self.late += 1
            return
        if self._last_ns is not None and time_ns <= self._last_ns:
            self.late += 1
        samples.append((time_ns, value))

    def ready(self, now_ns: int) -> Iterator[FeatureState]:
        """The states that can be given now, in the order of time."""
        while True:
            self._start(now_ns)
            time_ns = self._next()
            passed_ns = min(
                (each.samples[-1][0] if each.samples else -1 for each in self._features.values()), default=-1
            )
            complete_ns = time_ns + self._waits_ns()
            if self._start_ns is None or complete_ns > max(passed_ns, now_ns - self._timing.delay_ns):
                return
            yield self._state(self._grouped(time_ns), is_forced=complete_ns > passed_ns)

    def due_ns(self) -> int:
        """The time at which `ready` gives the next state without another sample."""
        if self._start_ns is None:
            return self._begin_ns + self._timing.patience_ns
        return self._next() + self._waits_ns() + self._timing.delay_ns

    def _start(self, now_ns: int) -> None:
        """Begin to give states once each feature has a sample, or the patience is over."""
        if self._start_ns is not None:
            return
        if all(each.samples for each in self._features.values()):
            self._start_ns = max((each.samples[0][0] for each in self._features.values()), default=self._begin_ns)
        elif now_ns >= self._begin_ns + self._timing.patience_ns:
            self._start_ns = self._begin_ns + self._timing.patience_ns

    def _next(self) -> int:
        """The time of the next state; with a tolerance, that of the first sample in it."""
        start = self._begin_ns if self._start_ns is None else self._start_ns
        if self._last_ns is None:
            return start
        if self._timing.rate_hz is not None:
            return start + round(self._number * SECOND_NS / self._timing.rate_hz)
        least = self._last_ns + self._timing.beat_ns
        for each in self._features.values():
            for time_ns, _ in each.samples:
                if time_ns > self._last_ns:
                    least = min(least, time_ns)
                    break
                if time_ns + each.hold_ns + 1 > self._last_ns:
                    least = min(least, time_ns + each.hold_ns + 1)
        return least

    def _waits_ns(self) -> int:
        return self._timing.tolerance_ns if self._timing.rate_hz is None and self._last_ns is not None else 0

    def _grouped(self, time_ns: int) -> int:
        """The time of the last sample that is in one state with those at `time_ns`."""
        last = time_ns + self._waits_ns()
        times = (each for feature in self._features.values() for each, _ in feature.samples)
        return max((each for each in times if time_ns <= each <= last), default=time_ns)

    def _state(self, time_ns: int, *, is_forced: bool) -> FeatureState:
        values = {}
        for name, each in self._features.items():
            while len(each.samples) > 1 and each.samples[1][0] <= time_ns:
                each.samples.popleft()
            if each.samples and time_ns - each.hold_ns <= each.samples[0][0] <= time_ns:
                values[name] = each.samples[0][1]
            else:
                self.missing[name] += 1
        self._last_ns = time_ns
        self._number += 1
        self.states += 1
        self.forced += is_forced
        return FeatureState(time_ns, values, is_forced)
