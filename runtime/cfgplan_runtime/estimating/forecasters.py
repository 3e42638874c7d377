"""Forecasters: functions from a history of samples to a forecast, each with its own weights of samples."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Protocol

from cfgplan_runtime.estimating.history import CostSample


@dataclass(frozen=True, slots=True)
class Forecast:
    """The expected course of a quantity: `level` now, changing by `slope` per second.

    The slope fades: the total change tends to `slope * reach_s`, with about two thirds of it after `reach_s` seconds.
    The forecast stays within `low` and `high`. `error` is the standard error of the level.
    """

    level: float
    error: float
    slope: float = 0.0
    reach_s: float = 1.0
    low: float = 0.0
    high: float = math.inf

    def value(self, ahead_s: float) -> float:
        """The expected value in `ahead_s` seconds."""
        gone = self.slope * self.reach_s * -math.expm1(-ahead_s / self.reach_s)
        return min(max(self.level + gone, self.low), self.high)

    def mean(self, horizon_s: int) -> float:
        """The mean of `value(t)` for t = 1, ..., `horizon_s`: the sum of Definition 8 divided by its length."""
        if horizon_s <= 0 or self.slope == 0.0:
            return self.value(0.0)
        free_s = self._free_s(horizon_s)
        fading = math.exp(-1 / self.reach_s)
        faded = fading * (1 - fading**free_s) / (1 - fading)
        total = free_s * self.level + self.slope * self.reach_s * (free_s - faded)
        return (total + (horizon_s - free_s) * self.value(horizon_s)) / horizon_s

    def _free_s(self, horizon_s: int) -> int:
        """The number of seconds before the forecast reaches the bound that it moves towards."""
        way = (self.low if self.slope < 0 else self.high) - self.level
        share = way / (self.slope * self.reach_s)
        if share >= 1:
            return horizon_s
        return min(horizon_s, math.floor(-self.reach_s * math.log1p(-share)))


class Forecaster(Protocol):
    """Makes a forecast from one or more samples. Times are the samples' own."""

    def __call__(self, samples: Sequence[CostSample]) -> Forecast: ...


@dataclass(frozen=True, slots=True)
class Latest:
    """The last sample: no memory, and no protection from noise."""

    def __call__(self, samples: Sequence[CostSample]) -> Forecast:
        return Forecast(samples[-1].value, 0.0)


@dataclass(frozen=True, slots=True)
class Average:
    """The weighted mean of the samples. A sample that is `memory` old counts half as much as a new one."""

    memory: float

    def __call__(self, samples: Sequence[CostSample]) -> Forecast:
        weights = recent_weights(samples, self.memory)
        level = _weighted_mean([one.value for one in samples], weights)
        return Forecast(level, standard_error([one.value - level for one in samples], weights, level))


@dataclass(frozen=True, slots=True)
class Trend:
    """A line through the samples (weighted least squares, weights as in `Average`).

    Only the part of the slope counts that noise can't explain: nothing below two standard errors, and nearly all of it
    at many. A trend lasts about `memory`, and leaves the samples' range by at most the width of that range.
    """

    memory: float

    def __call__(self, samples: Sequence[CostSample]) -> Forecast:
        flat = Average(self.memory)(samples)
        if len(samples) < _FEWEST_FOR_A_LINE:
            return flat
        weights = recent_weights(samples, self.memory)
        middle = _weighted_mean([one.at for one in samples], weights)
        spread = _weighted_mean([(one.at - middle) ** 2 for one in samples], weights)
        if spread <= 0:
            return flat
        slope = _weighted_mean([(one.at - middle) * (one.value - flat.level) for one in samples], weights) / spread
        left = [one.value - flat.level - slope * (one.at - middle) for one in samples]
        error = standard_error(left, weights, 0.0)
        slope *= _share_beyond_noise(slope, error / math.sqrt(spread))
        low, high = min(one.value for one in samples), max(one.value for one in samples)
        level = min(max(flat.level + slope * (samples[-1].until - middle), low), high)
        error = error if slope else flat.error
        return Forecast(level, error, slope, self.memory, max(0.0, 2 * low - high), 2 * high - low)


FORECASTERS: Mapping[str, Callable[[float], Forecaster]] = MappingProxyType(
    {"latest": lambda _: Latest(), "trend": Trend}
)
"""By name: a function from a memory, which is a half-life in seconds, to a forecaster."""

_FEWEST_FOR_A_LINE = 4


def recent_weights(samples: Sequence[CostSample], memory: float) -> list[float]:
    """Return the samples' weights; a sample that is `memory` older than the newest one has half of its own."""
    newest = samples[-1].until if samples else 0.0
    return [one.weight * 0.5 ** ((newest - one.until) / memory) for one in samples]


def _weighted_mean(values: Sequence[float], weights: Sequence[float]) -> float:
    mean = math.fsum(value * weight for value, weight in zip(values, weights, strict=True)) / math.fsum(weights)
    return min(max(mean, min(values)), max(values))


def standard_error(misses: Sequence[float], weights: Sequence[float], level: float) -> float:
    """The standard error of a weighted mean. With a single sample it is the level itself, as nothing is known."""
    number = math.fsum(weights) ** 2 / math.fsum(weight * weight for weight in weights)
    if number < 1.5:
        return abs(level)
    return math.sqrt(_weighted_mean([miss * miss for miss in misses], weights) / (number - 1))


def _share_beyond_noise(slope: float, error: float) -> float:
    """The share of a slope that noise can't explain, from 0 (two standard errors) towards 1."""
    return 0.0 if slope == 0.0 else max(0.0, 1 - (2 * error / slope) ** 2)


_DEVIATIONS = 3.0
_NORMAL = 1.4826
"""Times the median absolute deviation is the standard deviation of a normal distribution."""
_NO_OUTLIER = 0.1
"""A value within this share of the median is no outlier: a quiet history has no deviation at all."""
_SHIFT = 0.25
"""A step by a smaller share of the larger level is left to the forecaster, as a drift is."""


@dataclass(frozen=True, slots=True)
class Damped:
    """Forecasts from the samples since the last step, without outliers.

    Each sample is clipped to three standard deviations from the median of the `width` samples around it. The standard
    deviation is 1.4826 times the median absolute deviation (Hampel's filter, with clipping instead of replacement). A
    step is a place where the medians of half the width before and after differ by more than three deviations, and by a
    quarter of the larger.
    """

    inner: Forecaster
    width: int = 9

    def __call__(self, samples: Sequence[CostSample]) -> Forecast:
        return self.inner(damped(since_step(samples, (self.width + 1) // 2), self.width))


def damped(samples: Sequence[CostSample], width: int) -> list[CostSample]:
    """The samples with outliers clipped. At either end the window lies to one side."""
    spreads = _spreads([one.value for one in samples], width)
    drawn = []
    for place, one in enumerate(samples):
        middle, deviation = spreads[max(0, min(place - width // 2, len(spreads) - 1))]
        reach = max(_DEVIATIONS * deviation, _NO_OUTLIER * middle)
        drawn.append(CostSample(one.since, one.until, min(max(one.value, middle - reach), middle + reach), one.weight))
    return drawn


def since_step(samples: Sequence[CostSample], width: int) -> Sequence[CostSample]:
    """The samples after the last step that has lasted for `width` samples."""
    spreads = _spreads([one.value for one in samples], width)
    for place in range(len(samples) - width, width - 1, -1):
        before, before_deviation = spreads[place - width]
        after, after_deviation = spreads[place]
        least = max(_DEVIATIONS * max(before_deviation, after_deviation), _SHIFT * max(before, after))
        if abs(after - before) > least:
            return samples[place:]
    return samples


def _spreads(values: Sequence[float], width: int) -> list[tuple[float, float]]:
    """The median of each window, and its standard deviation by the median absolute deviation."""
    found = []
    for start in range(max(1, len(values) - width + 1)):
        window = values[start : start + width]
        middle = _median(window)
        found.append((middle, _NORMAL * _median([abs(value - middle) for value in window])))
    return found


def _median(values: Sequence[float]) -> float:
    """The median, as `statistics.median`, but several times as fast for a few values."""
    ordered, half = sorted(values), len(values) // 2
    return ordered[half] if len(ordered) % 2 else (ordered[half - 1] + ordered[half]) / 2
