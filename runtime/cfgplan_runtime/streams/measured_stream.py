"""Qualities of a stream that the run measures itself: rate, age and jitter.

The helper in the user's ROS Python imports this module, which needs nothing but the standard library.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import isfinite
from typing import Final, NamedTuple

MEASURED: Final = "measured."
"""`observe` names a measured quality by this and its name."""
_LEAST_MEASURED_S: Final = 0.5
"""Rates are measured over this time at least."""


class Quality(NamedTuple):
    """The qualities that an output's elements had since the last sign of life, in units of the attribute.

    `squares` is the sum of the squares of the distances from the mean.
    """

    elements: int
    mean: float
    squares: float

    def with_more(self, other: Quality) -> Quality:
        """Return the sums of both (Welford, Chan)."""
        elements = self.elements + other.elements
        if not elements:
            return self
        distance = other.mean - self.mean
        squares = self.squares + other.squares + distance**2 * self.elements * other.elements / elements
        return Quality(elements, self.mean + distance * other.elements / elements, squares)


NONE_SAID: Final = Quality(0, 0.0, 0.0)


class MeasuredStream:
    """Measures the elements of an output. `kinds` has the attributes of the output with what is measured for them.

    The rate is in elements per second. The age of an element, in seconds, is counted from when its source element was
    made. Jitter is the mean difference between intervals in a row (RFC 3550), in seconds. Before the first element,
    nothing is measured; a stream that is silent later has a rate of 0.
    """

    def __init__(self, kinds: Mapping[str, str]) -> None:
        self._kinds = kinds
        self._ages = self._jitters = NONE_SAID
        self._since_s: float | None = None
        """When the elements that `_elements` counts began to come."""
        self._last_s = self._interval_s = 0.0
        self._seen = self._elements = 0

    def note(self, age_s: float, now_s: float) -> None:
        """Take in an element that came now."""
        if isfinite(age_s):
            self._ages = self._ages.with_more(Quality(1, age_s, 0.0))
        if self._since_s is None:
            self._since_s = now_s
        else:
            self._elements += 1
            interval_s = now_s - self._last_s
            if self._seen > 1:
                self._jitters = self._jitters.with_more(Quality(1, abs(interval_s - self._interval_s), 0.0))
            self._interval_s = interval_s
        self._seen += 1
        self._last_s = now_s

    def taken(self, now_s: float) -> dict[str, Quality]:
        """Return the sums since the last call, by attribute."""
        found = {"age": self._ages, "jitter": self._jitters}
        self._ages = self._jitters = NONE_SAID
        if self._since_s is not None and now_s - self._since_s >= _LEAST_MEASURED_S:
            found["rate"] = Quality(1, self._elements / (now_s - self._since_s), 0.0)
            self._since_s, self._elements = now_s, 0
        return {name: sums for name, kind in self._kinds.items() if (sums := found.get(kind, NONE_SAID)).elements}


def measured_kinds(fields: Mapping[str, str | None]) -> dict[str, str]:
    """Return what is measured for each attribute of an output, by what the file observes of it."""
    return {
        attribute: field.removeprefix(MEASURED)
        for attribute, field in fields.items()
        if field is not None and field.startswith(MEASURED)
    }
