"""The CPU time of learning: of one observation of running units, and of estimating a large library at a review.

python experiments/estimating/speed.py
"""

from __future__ import annotations

import time
from collections.abc import Callable
from statistics import median

from cfgplan_runtime.estimating.estimator import LearningEstimator, make_estimator
from cfgplan_runtime.supervision.observation import Observation

from cfgplan.domain import Transformation

HORIZON_S = 600


def units(number: int, now_s: int) -> list[Observation]:
    return [
        Observation(f"work_{n}.1", f"work_{n}", 100_000, None, 100_000 + (10_000 + 37 * (n % 97)) * now_s)
        for n in range(number)
    ]


def learned(number: int) -> LearningEstimator:
    estimator = make_estimator()
    for now_s in range(320):
        estimator.observe(units(number, now_s), now_s)
    return estimator


def milliseconds(work: Callable[[], object]) -> float:
    start = time.process_time()
    work()
    return (time.process_time() - start) * 1e3


def row(number: int) -> str:
    estimator = learned(number)
    library = [Transformation(f"work_{n}", labor_us=1, upkeep_us=1, source=f"units.py:Work{n}") for n in range(number)]

    def estimate() -> object:
        return estimator.estimated(library, HORIZON_S)

    look = median(milliseconds(lambda t=t: estimator.observe(units(number, t), t)) for t in range(320, 330))
    new, again = milliseconds(estimate), median(milliseconds(estimate) for _ in range(5))
    estimator.observe(units(10, 331), 331)
    some = milliseconds(estimate)
    return f"| {number} | {look:.2f} ms | {new:.1f} ms | {again:.2f} ms | {some:.1f} ms |"


def family_row(number: int) -> str:
    """Return the table row for a template with `number` transformations, three of them running."""
    estimator = make_estimator()
    library = [Transformation(f"work(n{n})", labor_us=1, upkeep_us=1, source="units.py:Work") for n in range(number)]
    estimator.estimated(library, HORIZON_S)
    for t in range(320):
        estimator.observe([Observation(f"work.{n}", f"work(n{n})", 5, None, 5 + 9000 * t) for n in range(3)], t)
    return (
        f"| {number}, three of them observed | {milliseconds(lambda: estimator.estimated(library, HORIZON_S)):.1f} ms |"
    )


def main() -> None:
    print(
        "| transformations, all observed for 5 min | one look | estimates, all new | again | after a look at 10 units |"
    )
    print("|---|---|---|---|---|")
    for number in (10, 100, 1000):
        print(row(number))
    print("\n| transformations of one template | estimates, all new |\n|---|---|")
    for number in (10, 100, 1000):
        print(family_row(number))


if __name__ == "__main__":
    main()
