"""Double exponential smoothing as a forecaster. It is not better than cfgplan's own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from cfgplan_runtime.estimating.forecasters import Forecast, recent_weights, standard_error
from cfgplan_runtime.estimating.history import CostSample


@dataclass(frozen=True, slots=True)
class Holt:
    """Double exponential smoothing: a level and a trend, each moved towards the observations (Holt 1957).

    `memory` is the half-life of the trend, and twice that of the level. Samples may be irregular (Wright 1986).
    """

    memory: float

    def __call__(self, samples: Sequence[CostSample]) -> Forecast:
        level, slope, before = samples[0].value, 0.0, samples[0].at
        misses = []
        for one in samples[1:]:
            gap = max(one.at - before, 1e-9)
            expected = level + slope * gap
            misses.append(one.value - expected)
            to_value = 1 - 0.5 ** (2 * gap / self.memory)
            to_slope = 1 - 0.5 ** (gap / self.memory)
            new = expected + to_value * (one.value - expected)
            slope += to_slope * ((new - level) / gap - slope)
            level, before = new, one.at
        low, high = min(one.value for one in samples), max(one.value for one in samples)
        level = min(max(level + slope * (samples[-1].until - before), low), high)
        weights = recent_weights(samples[1:], self.memory / 2)
        error = standard_error(misses, weights, level) if misses else abs(level)
        return Forecast(level, error, slope, self.memory, max(0.0, 2 * low - high), 2 * high - low)
