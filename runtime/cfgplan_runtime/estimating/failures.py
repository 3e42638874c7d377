"""How often units of a transformation fail, and what that costs."""

from __future__ import annotations

import msgspec

from cfgplan_runtime.estimating.history import Amount, Moment

PRIOR_S = 60.0
"""Before anything is known, a transformation counts as having run so long without a failure."""


class FailureHistory(msgspec.Struct):
    """Failures and the time that units ran, both fading with half-life `forget_s`.

    The rate is that of a Poisson process, and the prior is `PRIOR_S` seconds without a failure: it is 0 before the
    first failure, one per minute after one at the start, and what runs on without failing becomes trusted again.
    """

    forget_s: float
    failures: Amount = 0.0
    ran_s: Amount = 0.0
    at_s: Moment = 0.0

    def ran(self, unit_s: float, now_s: float) -> None:
        """Units have run without failing for `unit_s` seconds together."""
        self._fade(now_s)
        self.ran_s += unit_s

    def failed(self, now_s: float) -> None:
        """A unit has died, hung, failed for good, or could not start."""
        self._fade(now_s)
        self.failures += 1

    def rate(self, now_s: float) -> float:
        """Expected failures per second of one unit."""
        share = self._share(now_s)
        return self.failures * share / (PRIOR_S + self.ran_s * share)

    def moved(self, by: float) -> FailureHistory:
        """The same on a clock that shows `by` more."""
        return FailureHistory(self.forget_s, self.failures, self.ran_s, self.at_s + by)

    def _share(self, now_s: float) -> float:
        return float(0.5 ** (max(0.0, now_s - self.at_s) / self.forget_s))

    def _fade(self, now_s: float) -> None:
        share = self._share(now_s)
        self.failures *= share
        self.ran_s *= share
        self.at_s = max(self.at_s, now_s)
