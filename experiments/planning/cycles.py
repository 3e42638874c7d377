"""Networks with cycles: the CPU seconds of the planner, of the planner without answer sets, and of clingo.

`python experiments/planning/cycles.py`; `--limit` is the wall time for each plan in seconds. Prints a row for each
family: geometric means over the seeds, the number of proofs, and the mean and the worst ratio of the planner's time to
that of clingo's cores. Instances that neither proves are left out of the ratio.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from math import exp, log
from pathlib import Path
from random import Random

sys.path.append(str(Path(__file__).parents[2]))

from cfgplan.planners.exact.session import PlannerSession
from cfgplan.planners.tuning import USUAL, Cycles
from cfgplan.planning import Plan, Problem, Status
from cfgplan.validity import plan_violations
from experiments.families.adversarial import adversarial
from experiments.families.random_library import random_library
from experiments.families.transport import transport
from experiments.peers.asp import plan_by_cores

WITHOUT = replace(USUAL, cycles=Cycles(values=0))
Planned = tuple[float, bool]
"""CPU seconds, and whether the cost is proven."""


def costs_alike(seed: int, values: int, **parameters: float) -> Problem:
    """Return a random library whose transformations have one of `values` costs, in whole seconds."""
    problem = random_library(seed, **parameters)  # type: ignore[arg-type]
    random = Random(seed)
    library = tuple(
        replace(t, labor_us=random.randint(1, values) * 1_000_000, upkeep_us=0) for t in problem.environment.library
    )
    return replace(problem, environment=replace(problem.environment, library=library))


FAMILIES: dict[str, Callable[[int], Problem]] = {
    "transport, 3 places, 2 trucks, 6 crates": partial(transport, crates=6),
    "transport, 4 places, 3 trucks, 8 crates": partial(transport, places=4, trucks=3, crates=8),
    "transport, 6 places, 3 trucks, 8 crates": partial(transport, places=6, trucks=3, crates=8),
    "transport, 5 places, 3 trucks, 10 crates": partial(transport, places=5, trucks=3, crates=10),
    "transport, 5 places, 3 trucks, 12 crates": partial(transport, places=5, trucks=3, crates=12),
    "transport, 6 places, 4 trucks, 14 crates": partial(transport, places=6, trucks=4, crates=14),
    "ring, 40": lambda seed: adversarial(seed, kind="ring", size=40),
    "150, arity 3, back .4": partial(random_library, transformations=150, arity=3, back=0.4),
    "400, back .4, 8 targets": partial(random_library, transformations=400, back=0.4, targets=8),
    "150, back .4, one cost": partial(costs_alike, values=1, transformations=150, back=0.4),
    "150, back .4, three costs": partial(costs_alike, values=3, transformations=150, back=0.4),
    "300, back .1, one cost": partial(costs_alike, values=1, transformations=300, back=0.1),
    "300, back .1, ten costs": partial(costs_alike, values=10, transformations=300, back=0.1),
}


def planned(plan: Callable[..., Plan], problem: Problem, limit_s: float) -> Planned:
    """Return a plan's figures. Raises ValueError if the judge rejects it."""
    began = time.process_time()
    found = plan(problem, time_limit_s=limit_s)
    taken = time.process_time() - began
    if wrong := plan_violations(problem, found):
        raise ValueError(str(wrong[0]))
    return taken, found.status is Status.OPTIMAL


def mean(values: list[float]) -> float:
    return exp(sum(map(log, values)) / len(values))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--limit", type=float, default=10.0)
    parser.add_argument("--seeds", type=int, nargs="*", default=list(range(200, 206)))
    options = parser.parse_args()
    entrants: tuple[Callable[[], Callable[..., Plan]], ...] = (
        lambda: PlannerSession().plan,
        lambda: PlannerSession(WITHOUT).plan,
        lambda: plan_by_cores,
    )
    for make in entrants:
        for warm_up in (transport(0), random_library(0)):
            make()(warm_up)  # the first plan imports the solver
    print("| family | cfgplan | without answer sets | clingo's cores | cfgplan takes, of clingo's time | at most |")
    print("|---|---|---|---|---|---|")
    for name, family in FAMILIES.items():
        rows = [[planned(make(), family(seed), options.limit) for make in entrants] for seed in options.seeds]
        cells = [
            f"{mean([one[0] for one in column]):.3f}, {sum(one[1] for one in column)}"
            for column in zip(*rows, strict=True)
        ]
        ratios = [ours[0] / theirs[0] for ours, _, theirs in rows if ours[1] or theirs[1]] or [float("nan")]
        print(f"| {name} | {' | '.join(cells)} | {mean(ratios):.2f} | {max(ratios):.2f} |", flush=True)


if __name__ == "__main__":
    main()
