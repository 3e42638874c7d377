"""Outliers are drawn in before anything is made of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median

from cfgplan_runtime.estimating.forecasting import Forecast, Forecaster
from cfgplan_runtime.estimating.history import Sample

_DEVIATIONS = 3.0
_NORMAL = 1.4826
"""Times the median absolute deviation is the standard deviation of a normal distribution."""
_LEAST_SHARE = 0.1
"""Values are never called outliers within so much of the median: a quiet history has no deviation at all."""


@dataclass(frozen=True, slots=True)
class Damped:
    """Draws each sample in to three standard deviations from the median of the `width` samples around it.

    The deviation is 1.4826 times the median absolute deviation (Hampel's filter, but drawing in instead of replacing);
    within a tenth of the median nothing is drawn in. A change that lasts for half the width is no outlier any more.
    """

    inner: Forecaster
    width: int = 9

    def __call__(self, samples: Sequence[Sample]) -> Forecast:
        return self.inner(damped(samples, self.width))


def damped(samples: Sequence[Sample], width: int) -> list[Sample]:
    """The samples with outliers drawn in; the window of those at an end is all on the other side."""
    drawn = []
    for place, one in enumerate(samples):
        start = max(0, min(place - width // 2, len(samples) - width))
        values = [other.value for other in samples[start : start + width]]
        middle = median(values)
        deviation = _NORMAL * median(abs(value - middle) for value in values)
        reach = _DEVIATIONS * max(deviation, _LEAST_SHARE / _DEVIATIONS * abs(middle))
        drawn.append(Sample(one.since, one.until, min(max(one.value, middle - reach), middle + reach), one.weight))
    return drawn
