"""Outliers are drawn in, and what was before a lasting change is left out, before anything is made of a history."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from cfgplan_runtime.estimating.forecasting import Forecast, Forecaster
from cfgplan_runtime.estimating.history import Sample

_DEVIATIONS = 3.0
_NORMAL = 1.4826
"""Times the median absolute deviation is the standard deviation of a normal distribution."""
_NO_OUTLIER = 0.1
"""Nothing within so much of the median is an outlier: a quiet history has no deviation at all."""
_SHIFT = 0.25
"""A step that is less of the larger level is left to the forecaster, and so is a drift."""


@dataclass(frozen=True, slots=True)
class Damped:
    """What a forecaster makes of a history without outliers, since the last step.

    Each sample is drawn in to three standard deviations from the median of the `width` samples around it. The deviation
    is 1.4826 times the median absolute deviation (Hampel's filter, but drawing in instead of replacing). A step is
    where the medians of half the width before and after differ by more than that, and by a quarter.
    """

    inner: Forecaster
    width: int = 9

    def __call__(self, samples: Sequence[Sample]) -> Forecast:
        return self.inner(damped(since_step(samples, (self.width + 1) // 2), self.width))


def damped(samples: Sequence[Sample], width: int) -> list[Sample]:
    """The samples with outliers drawn in; the window of those at an end is all on the other side."""
    spreads = _spreads([one.value for one in samples], width)
    drawn = []
    for place, one in enumerate(samples):
        middle, deviation = spreads[max(0, min(place - width // 2, len(spreads) - 1))]
        reach = max(_DEVIATIONS * deviation, _NO_OUTLIER * middle)
        drawn.append(Sample(one.since, one.until, min(max(one.value, middle - reach), middle + reach), one.weight))
    return drawn


def since_step(samples: Sequence[Sample], width: int) -> Sequence[Sample]:
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
    """Of each window, the median, and the standard deviation as the median absolute deviation tells it."""
    found = []
    for start in range(max(1, len(values) - width + 1)):
        window = values[start : start + width]
        middle = _median(window)
        found.append((middle, _NORMAL * _median([abs(value - middle) for value in window])))
    return found


def _median(values: Sequence[float]) -> float:
    """The same as that of `statistics`, several times as fast for a few values."""
    ordered, half = sorted(values), len(values) // 2
    return ordered[half] if len(ordered) % 2 else (ordered[half - 1] + ordered[half]) / 2
