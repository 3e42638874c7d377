"""Noisy values: their mean, and on which side of a bound the true value certainly is.

A mean of half-life HALF_LIFE_S is compared, and changes sides of a bound only BAND_ERRORS standard errors beyond it, in
both directions. With 20 % noise at 5 values a second this follows each of 24 crossings in 480 s, 6 s late, and changes
its mind at most 10 times an hour where the truth lies exactly on a bound. Raw values make 1107 changes of these 24.

A value that its noise does not explain (the innovation gate of a Kalman filter) is left out as an outlier, unless the
last JUMP_VALUES values were all outliers on the same side: then the truth has jumped, and the mean restarts there.
If values on both sides alternate, it restarts on the side of most of MOST_OUTLIERS outliers in a row.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from math import sqrt
from typing import Final

from cfgplan.qualities import MICRO, units

HALF_LIFE_S: Final = 2.0
BAND_ERRORS: Final = 3
OUTLIER_ERRORS: Final = 5
"""A value more than this many standard deviations from the mean is an outlier."""
JUMP_VALUES: Final = 3
MOST_OUTLIERS: Final = 2 * JUMP_VALUES - 1
_JUMP_VARIANCE: Final = 0.4487
"""The variance of the median of JUMP_VALUES values, as a share of a single value's: 1 - sqrt(3) / pi."""


@dataclass(frozen=True, slots=True)
class Noise:
    """The standard deviation of single values: in millionths, or as a share of the true value in millionths."""

    amount: int
    is_share: bool = False

    def __str__(self) -> str:
        return f"{units(self.amount * 100):f} %" if self.is_share else f"{units(self.amount):f}"

    def at(self, value: int) -> float:
        """The standard deviation where the true value is this one, both in millionths."""
        return abs(value) * self.amount / MICRO if self.is_share else float(self.amount)

    def band(self, bound: int, variance: float) -> float:
        """How far a mean must be beyond a bound to be sure; `variance` is the mean's, as a share of one value's."""
        return BAND_ERRORS * self.at(bound) * sqrt(variance)


@dataclass(frozen=True, slots=True)
class NoisyMean:
    """An exponential mean of values in millionths; `variance` is its variance as a share of a single value's.

    Before the first value, the mean is the value that counts so far; the first values may contradict it.
    """

    mean: float
    at_s: float
    variance: float = 0.0
    values: int = 0
    """The number of values in the mean."""
    outliers: tuple[int, ...] = ()
    """The outliers on one side since the last value that counted, at most the last JUMP_VALUES - 1."""
    before: tuple[int, ...] = ()
    """The outliers on both sides between that value and these."""

    def after(self, value: int, at_s: float, noise: Noise) -> NoisyMean:
        """Return the mean after one more value. The first values have equal weights."""
        if self._explains(value, noise):
            values = self.values + 1
            share = max(_share(at_s - self.at_s), 1 / values)
            variance = (1 - share) ** 2 * self.variance + share**2
            return NoisyMean(self.mean + share * (value - self.mean), at_s, variance, values)
        outliers, before = (*self.outliers, value), self.before
        if any((other - self.mean) * (value - self.mean) < 0 for other in self.outliers):
            before += tuple(other for other in self.outliers if not self._explains(other, noise))
            outliers = (value,)
        if len(outliers) == JUMP_VALUES:
            return NoisyMean(_median(outliers), at_s, _JUMP_VARIANCE, JUMP_VALUES, outliers[1:])
        if len(before) + len(outliers) < MOST_OUTLIERS:
            return replace(self, outliers=outliers, before=before)
        above, below = list[int](), list[int]()
        for other in (*before, *outliers):
            (above if other > self.mean else below).append(other)
        most = above if len(above) >= JUMP_VALUES else below
        return NoisyMean(_median(most[-JUMP_VALUES:]), at_s, _JUMP_VARIANCE, JUMP_VALUES)

    def _explains(self, value: int, noise: Noise) -> bool:
        """Return whether a value is so near to the mean that it may be noise.

        Relative noise is taken at the geometric mean of both, so that zeros and saturated values are outliers
        whatever the share.
        """
        variance = noise.at(round(self.mean)) * noise.at(value) * (1 + self.variance)
        return (value - self.mean) ** 2 <= OUTLIER_ERRORS**2 * variance

    def planned_value(self, noise: Noise, before: int, bounds: Iterable[int]) -> int:
        """Return the value to plan with, in millionths: the mean, moved to the certain side of each bound.

        A mean that is not certain keeps the side of the last value, `before`. A value is on the upper side of a bound
        if it is at least the bound.
        """
        upper: list[int] = []
        lower: list[int] = []
        for bound in bounds:
            band = noise.band(bound, self.variance)
            is_upper = self.mean >= (bound - band if before >= bound else bound + band)
            (upper if is_upper else lower).append(bound)
        value = max(round(self.mean), *upper) if upper else round(self.mean)
        return min(value, *(bound - 1 for bound in lower)) if lower else value


def _median(values: Sequence[int]) -> int:
    return sorted(values)[len(values) // 2]


def settled_variance(rate_hz: float) -> float:
    """The variance of a mean after many values, as a share of a single value's."""
    share = _share(1 / rate_hz)
    return share / (2 - share)


def _share(seconds: float) -> float:
    """Return the weight of a new value that comes `seconds` after the one before."""
    return float(1 - 0.5 ** (seconds / HALF_LIFE_S))
