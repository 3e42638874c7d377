"""Noisy values: their mean, and the side of each bound that they are on for sure.

A mean of half-life HALF_LIFE_S is compared, and changes sides of a bound only BAND_ERRORS standard errors beyond it, in
both directions. With 20 % noise at 5 values a second this follows each of 24 crossings in 480 s, 6 s late, and changes
its mind at most 10 times an hour where the truth lies exactly on a bound. Raw values make 1107 changes of these 24.
"""

from __future__ import annotations

from collections.abc import Iterable
from math import sqrt
from typing import Final

from cfgplan.frozen import dataclass
from cfgplan.qualities import MICRO, units

HALF_LIFE_S: Final = 2.0
BAND_ERRORS: Final = 3


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
        """How far beyond a bound a mean has to be; `variance` is that of the mean, as a share of a single value's."""
        return BAND_ERRORS * self.at(bound) * sqrt(variance)


@dataclass(frozen=True, slots=True)
class NoisyMean:
    """An exponential mean of values in millionths; `variance` is its variance as a share of a single value's."""

    mean: float
    at_s: float
    variance: float = 1.0
    values: int = 1

    def after(self, value: int, at_s: float) -> NoisyMean:
        """Return the mean after one more value. The first values have equal weights."""
        values = self.values + 1
        share = max(_share(at_s - self.at_s), 1 / values)
        variance = (1 - share) ** 2 * self.variance + share**2
        return NoisyMean(self.mean + share * (value - self.mean), at_s, variance, values)

    def told(self, noise: Noise, before: int, bounds: Iterable[int]) -> int:
        """The value to go by, in millionths, after `before`: the mean, on the sides of all bounds that are sure.

        A value is on the upper side of a bound if it is at least that.
        """
        upper: list[int] = []
        lower: list[int] = []
        for bound in bounds:
            band = noise.band(bound, self.variance)
            is_upper = self.mean >= (bound - band if before >= bound else bound + band)
            (upper if is_upper else lower).append(bound)
        value = max(round(self.mean), *upper) if upper else round(self.mean)
        return min(value, *(bound - 1 for bound in lower)) if lower else value


def settled_variance(rate_hz: float) -> float:
    """The variance of a mean after many values, as a share of a single value's."""
    share = _share(1 / rate_hz)
    return share / (2 - share)


def _share(seconds: float) -> float:
    """Return the weight of a new value that comes `seconds` after the one before."""
    return float(1 - 0.5 ** (seconds / HALF_LIFE_S))
