"""Deployments planned with numbers of units, and with a variable for each unit and host: CPU seconds and proofs.

`python experiments/planning/deployments.py`; `--limit` is the wall time for each plan in seconds.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

sys.path.append(str(Path(__file__).parents[2]))

from cfgplan.domain import Objective
from cfgplan.planners.exact.session import PlannerSession
from cfgplan.planners.tuning import Tuning
from cfgplan.planning import Problem
from cfgplan.validity import plan_violations
from experiments.families.deployments import deployment

SIZES = ((6, 2), (20, 6), (50, 10), (100, 20))
ORDERS = ((Objective.COST,), (Objective.HOSTS, Objective.UNITS))


def figures(problem: Problem, tuning: Tuning, limit_s: float) -> str:
    """Return CPU seconds and status of a plan as text. Raises ValueError if the judge rejects it."""
    began = time.process_time()
    found = PlannerSession(tuning).plan(problem, time_limit_s=limit_s)
    taken = time.process_time() - began
    if wrong := plan_violations(problem, found):
        raise ValueError(str(wrong[0]))
    gap = f" {100 * found.gap:.1f} %" if found.gap else ""
    return f"{taken:.2f} {found.status}{gap}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--limit", type=float, default=60.0)
    parser.add_argument("--seeds", type=int, nargs="*", default=[100, 101, 102])
    parser.add_argument("--named", type=int, default=20, help="name units and hosts too up to so many hosts")
    options = parser.parse_args()
    PlannerSession().plan(deployment(0))  # the first plan imports the solver
    print("| hosts | replicas | seed | minimised | counted | named |\n|---|---|---|---|---|---|")
    for hosts, replicas in SIZES:
        for seed in options.seeds:
            for minimise in ORDERS:
                problem = deployment(seed, hosts=hosts, replicas=replicas, minimise=minimise)
                counted = figures(problem, Tuning(), options.limit)
                is_named = hosts <= options.named
                named = figures(problem, Tuning.solver_only(), options.limit) if is_named else ""
                print(f"| {hosts} | {replicas} | {seed} | {', '.join(minimise)} | {counted} | {named} |", flush=True)


if __name__ == "__main__":
    main()
