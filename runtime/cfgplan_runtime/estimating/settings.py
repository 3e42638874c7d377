"""The settings of an estimator."""

from __future__ import annotations

from dataclasses import dataclass

from cfgplan_runtime.estimating.history import FailureHistory, History

_SAMPLES_PER_MEMORY = 12
_MEMORIES = 4
"""The number of half-lives after which samples are dropped: they count for 6 % then."""
_MOST_STARTS = 20


@dataclass(frozen=True, slots=True)
class Learning:
    """The settings of an estimator. Times in seconds.

    `memory_s` is the age at which an upkeep counts half as much as a new one, `memory_starts` the same for labor, in
    starts. `forget_s` is the half-life of failures, and of estimates without new observations. A failure costs a start,
    and `failure_us` for the interruption. An estimate changes only by more than `least_change` of it,
    `least_change_us`, and `errors` standard errors.
    """

    memory_s: float = 60.0
    memory_starts: float = 3.0
    forget_s: float = 3600.0
    failure_us: int = 1_000_000
    least_change: float = 0.05
    least_change_us: int = 200
    errors: float = 2.0

    def labor(self) -> History:
        return History(0.0, _MOST_STARTS)

    def upkeep(self) -> History:
        return History(self.memory_s / _SAMPLES_PER_MEMORY, _SAMPLES_PER_MEMORY * _MEMORIES)

    def failures(self) -> FailureHistory:
        return FailureHistory(self.forget_s)

    def settled(self, last_us: int | None, new_us: float, error_us: float) -> int:
        """The estimate to use after `last_us`: `last_us` while the new value is within the band, else the new one,
        rounded half up.
        """
        if last_us is not None:
            band = max(self.least_change * last_us, self.least_change_us, self.errors * error_us)
            if abs(new_us - last_us) <= band:
                return last_us
        return int(new_us + 0.5)
