"""The history of a transformation: short lists of samples, and the rate of failures of its units."""

from __future__ import annotations

from typing import Annotated, TypeAlias

import msgspec

Second: TypeAlias = Annotated[float, msgspec.Meta(ge=-1e12, le=1e12)]
NotNegative: TypeAlias = Annotated[float, msgspec.Meta(ge=0, le=1e16)]
Weight: TypeAlias = Annotated[float, msgspec.Meta(ge=1e-6, le=1e12)]
"""Limits for values read from a file, far beyond anything observed."""


class CostSample(msgspec.Struct, array_like=True):
    """A mean `value` over the time from `since` to `until`; `weight` is the amount of observation."""

    since: Second
    until: Second
    value: NotNegative
    weight: Weight

    @property
    def at(self) -> float:
        """The middle of the interval."""
        return (self.since + self.until) / 2


class History(msgspec.Struct):
    """The newest samples, oldest first. Observations within one `grain` of time are one sample."""

    grain: float
    most: int
    samples: list[CostSample] = msgspec.field(default_factory=list)

    def add(self, since: float, until: float, value: float, weight: float) -> bool:
        """Add a mean over an interval. Returns whether it makes a new sample.

        Intervals are added in order of their ends; those of several units may overlap.
        """
        last = self.samples[-1] if self.samples else None
        if last is not None and until - last.since <= self.grain:
            total = last.weight + weight
            last.value += (value - last.value) * weight / total
            last.weight, last.until = total, max(last.until, until)
            return False
        self.samples.append(CostSample(since, until, value, weight))
        del self.samples[: -self.most]
        return True

    @property
    def is_in_order(self) -> bool:
        """Whether the samples are as `add` would have left them; samples from a file may not be."""
        ends = [one.until for one in self.samples]
        return ends == sorted(ends) and all(one.since <= one.until for one in self.samples)

    def take_limits(self, other: History) -> None:
        """Use the limits of `other`."""
        self.grain, self.most = other.grain, other.most
        del self.samples[: -self.most]

    def moved(self, by: float) -> History:
        """The same history on a clock that is ahead by `by` seconds."""
        moved = [CostSample(one.since + by, one.until + by, one.value, one.weight) for one in self.samples]
        return History(self.grain, self.most, moved)


PRIOR_S = 60.0
"""A new transformation counts as having run for this many seconds without a failure."""


class FailureHistory(msgspec.Struct):
    """The number of failures, and the time that units ran; both fade with half-life `forget_s`.

    The rate is that of a Poisson process with a prior of `PRIOR_S` seconds without a failure: 0 before the first
    failure, one per minute after a failure at the start. It falls while units run without failing.
    """

    forget_s: float
    failures: NotNegative = 0.0
    ran_s: NotNegative = 0.0
    at_s: Second = 0.0

    def ran(self, unit_s: float, now_s: float) -> None:
        """Add a total of `unit_s` seconds in which units ran without failing."""
        self._fade(now_s)
        self.ran_s += unit_s

    def failed(self, now_s: float) -> None:
        """Add a failure: a unit has died, hung, kept failing, or could not start."""
        self._fade(now_s)
        self.failures += 1

    def rate(self, now_s: float) -> float:
        """The expected failures per second of one unit."""
        share = self._share(now_s)
        return self.failures * share / (PRIOR_S + self.ran_s * share)

    def moved(self, by: float) -> FailureHistory:
        """The same history on a clock that is ahead by `by` seconds."""
        return FailureHistory(self.forget_s, self.failures, self.ran_s, self.at_s + by)

    def _share(self, now_s: float) -> float:
        return float(0.5 ** (max(0.0, now_s - self.at_s) / self.forget_s))

    def _fade(self, now_s: float) -> None:
        share = self._share(now_s)
        self.failures *= share
        self.ran_s *= share
        self.at_s = max(self.at_s, now_s)
