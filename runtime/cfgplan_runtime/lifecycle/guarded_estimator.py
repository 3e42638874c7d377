"""An estimator that may raise: in this case the life-cycle uses declared costs, and warns."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

from cfgplan.domain import Host, Transformation
from cfgplan_runtime.lifecycle.seams import DeclaredCosts, Estimator
from cfgplan_runtime.supervision.listeners import LOG
from cfgplan_runtime.supervision.observation import Observation

T = TypeVar("T")


class GuardedEstimator:
    """Asks an estimator, and declared costs where that raises or gives no cost.

    `warning` tells of the last failure; it is empty if there was none.
    """

    def __init__(self, estimator: Estimator) -> None:
        self._estimator = estimator
        self._declared = DeclaredCosts()
        self.warning = ""

    def observe(self, observations: Sequence[Observation], now_s: float) -> None:
        self._declared.observe(observations, now_s)
        self._tried(lambda: self._estimator.observe(observations, now_s), None)

    def failed(self, transformation: str, now_s: float, host: str | None = None) -> None:
        there = () if host is None else (host,)
        self._declared.failed(transformation, now_s, host)
        self._tried(lambda: self._estimator.failed(transformation, now_s, *there), None)

    def labor_us(self, transformation: Transformation, horizon_s: int, host: Host | None = None) -> int:
        there = () if host is None else (host,)
        declared_us = self._declared.labor_us(transformation, horizon_s, host)
        return self._tried(lambda: _cost(self._estimator.labor_us(transformation, horizon_s, *there)), declared_us)

    def upkeep_us(self, transformation: Transformation, horizon_s: int, host: Host | None = None) -> int:
        there = () if host is None else (host,)
        declared_us = self._declared.upkeep_us(transformation, horizon_s, host)
        return self._tried(lambda: _cost(self._estimator.upkeep_us(transformation, horizon_s, *there)), declared_us)

    def _tried(self, ask: Callable[[], T], otherwise: T) -> T:
        try:
            return ask()
        except Exception as error:
            if not self.warning:
                LOG.exception("the estimator has failed; declared costs are used where it does")
            self.warning = f"the estimator has failed ({type(error).__name__}: {error}): declared costs are used"
            return otherwise


def _cost(value: object) -> int:
    if type(value) is not int or value < 0:
        raise ValueError(f"{value!r} is not a cost in whole microseconds")
    return value
