"""Units that are observed in thought, for the tests of estimators."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from cfgplan_runtime.estimating.estimator import LearningEstimator
from cfgplan_runtime.supervision.observation import Observation

from cfgplan.domain import Transformation

WORK = Transformation("work", labor_us=300_000, upkeep_us=20_000, source="units.py:Work")
HORIZON_S = 600


def observation(
    unit: str,
    cpu_us: float,
    *,
    transformation: str | None = None,
    labor_us: int = 100_000,
    steps: int = 0,
    host: str | None = None,
) -> Observation:
    label = transformation or unit.rpartition(".")[0]
    return Observation(unit, label, labor_us, None, round(cpu_us), 1 << 20, steps, 0.0, 0, None, {}, {}, host=host)


class Watched:
    """Lets units of one transformation run for an estimator that looks every `every_s` seconds."""

    def __init__(
        self, estimator: LearningEstimator, label: str = "work", *, every_s: float = 1.0, host: str | None = None
    ) -> None:
        self.estimator = estimator
        self.host = host
        self.label = label
        self.every_s = every_s
        self.now_s = 0.0
        self._starts = 0

    def run(self, upkeep_us: Callable[[float], float], for_s: float, *, labor_us: int = 100_000) -> None:
        """Start a unit and let it run; `upkeep_us` gives what it uses per second at a moment of the clock."""
        self.run_once([upkeep_us(self.now_s + n * self.every_s) for n in range(round(for_s / self.every_s))], labor_us)

    def run_once(self, upkeeps_us: Iterable[float], labor_us: int = 100_000) -> None:
        """Start a unit and let it use so much per second, one value for the time up to each look."""
        self._starts += 1
        used, unit = float(labor_us), f"{self.label}.{self._starts}"
        self._look(unit, used, labor_us)
        for upkeep_us in upkeeps_us:
            self.now_s += self.every_s
            used += upkeep_us * self.every_s
            self._look(unit, used, labor_us)

    def pass_time(self, seconds: float) -> None:
        """Nothing runs for so long."""
        self.now_s += seconds
        self.estimator.observe([], self.now_s)

    def _look(self, unit: str, used_us: float, labor_us: int) -> None:
        seen = observation(unit, used_us, transformation=self.label, labor_us=labor_us, host=self.host)
        self.estimator.observe([seen], self.now_s)
