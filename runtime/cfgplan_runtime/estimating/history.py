"""What was observed of one quantity, as a short list of samples."""

from __future__ import annotations

from typing import Annotated, TypeAlias

import msgspec

Moment: TypeAlias = Annotated[float, msgspec.Meta(ge=-1e12, le=1e12)]
Amount: TypeAlias = Annotated[float, msgspec.Meta(ge=0, le=1e16)]
Weight: TypeAlias = Annotated[float, msgspec.Meta(ge=1e-6, le=1e12)]
"""What may be read from a file; far beyond anything observed."""


class Sample(msgspec.Struct, array_like=True):
    """A mean `value` over the time from `since` to `until`; `weight` says how much was observed."""

    since: Moment
    until: Moment
    value: Amount
    weight: Weight

    @property
    def at(self) -> float:
        """The middle of the time that it is about."""
        return (self.since + self.until) / 2


class History(msgspec.Struct):
    """The newest samples, oldest first. What is observed within one `grain` of time is one sample."""

    grain: float
    most: int
    samples: list[Sample] = msgspec.field(default_factory=list)

    def add(self, since: float, until: float, value: float, weight: float) -> bool:
        """Add a mean over an interval; whether it makes a new sample.

        Intervals come in order of their ends, those of several units side by side.
        """
        last = self.samples[-1] if self.samples else None
        if last is not None and until - last.since <= self.grain:
            total = last.weight + weight
            last.value += (value - last.value) * weight / total
            last.weight, last.until = total, max(last.until, until)
            return False
        self.samples.append(Sample(since, until, value, weight))
        del self.samples[: -self.most]
        return True

    @property
    def is_in_order(self) -> bool:
        """Whether the samples are as `add` would have left them; those of a file may not be."""
        ends = [one.until for one in self.samples]
        return ends == sorted(ends) and all(one.since <= one.until for one in self.samples)

    def take_limits(self, other: History) -> None:
        """Go on as `other` would."""
        self.grain, self.most = other.grain, other.most
        del self.samples[: -self.most]

    def moved(self, by: float) -> History:
        """The same on a clock that shows `by` more."""
        moved = [Sample(one.since + by, one.until + by, one.value, one.weight) for one in self.samples]
        return History(self.grain, self.most, moved)
