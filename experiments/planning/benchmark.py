"""Replanning after failures: `python experiments/planning/benchmark.py` writes `replan.md` beside this file.

`--limit` is the time for each plan in seconds. Times are CPU seconds of the planning process, all threads together,
because the machine may be shared.
"""

from __future__ import annotations

import argparse
import multiprocessing
import random
import statistics
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

from cfgplan.comparing.families.random_library import random_library
from cfgplan.domain import ChangeSet
from cfgplan.planners.cpsat import PlannerSession
from cfgplan.planning import Plan, Problem

HERE = Path(__file__).parent
SEEDS = (0, 1)

REPLAN: dict[str, dict[str, float]] = {
    "50, 3 targets": {"transformations": 50, "targets": 3},
    "500, 8 targets": {"transformations": 500, "targets": 8},
    "1,000, 60 targets": {"transformations": 1000, "targets": 60},
    "5,000, 10 targets": {"transformations": 5000, "targets": 10},
}


def in_own_process(work: Callable[..., str], *arguments: object) -> str:
    with multiprocessing.get_context("fork").Pool(1) as pool:
        return pool.apply(work, arguments)


def replan(limit_s: float) -> Iterator[str]:
    """Every running unit dies once, in random order, each time from the same optimal configuration."""
    yield "| family | seed | units | first plan, CPU s | median ms | p99 ms | not proven | solver not called |"
    yield "|---|---|---|---|---|---|---|---|"
    for family, parameters in REPLAN.items():
        for seed in SEEDS:
            yield f"| {family} | {seed} | {in_own_process(replanned, seed, parameters, limit_s)} |"


def replanned(seed: int, parameters: dict[str, float], limit_s: float) -> str:
    session = PlannerSession()
    problem = random_library(seed, **parameters)  # type: ignore[arg-type]
    began = time.process_time()
    problem = after(problem, session.plan(problem, time_limit_s=10 * limit_s))
    first_s = time.process_time() - began
    while True:  # a manager plans once more when an update is done, until nothing changes
        found = session.plan(problem, time_limit_s=limit_s)
        if not found.change_set:
            break
        problem = after(problem, found)
    units = [unit.id for unit in problem.environment.units]
    random.Random(seed).shuffle(units)
    times_ms, plans = [], []
    for unit in units:
        broken = replace(problem, environment=problem.environment.update(ChangeSet(stopped=(unit,))))
        began = time.process_time()
        plans.append(session.plan(broken, time_limit_s=limit_s))
        times_ms.append(1000 * (time.process_time() - began))
    unproven = sum(found.status != "optimal" for found in plans)
    shortcut = sum("rounds" not in found.counts for found in plans)
    p99_ms = sorted(times_ms)[min(len(times_ms) - 1, int(0.99 * len(times_ms)))]
    median_ms = statistics.median(times_ms)
    return f"{len(units)} | {first_s:.2f} | {median_ms:.1f} | {p99_ms:.1f} | {unproven} | {shortcut} of {len(plans)}"


def after(problem: Problem, found: Plan) -> Problem:
    assert found.change_set is not None
    return replace(problem, environment=problem.environment.update(found.change_set))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--limit", type=float, default=10.0, help="seconds for each plan (default 10)")
    arguments = parser.parse_args()
    with (HERE / "replan.md").open("w", encoding="utf-8") as table:
        for row in replan(arguments.limit):
            print(row, flush=True)
            print(row, file=table, flush=True)


if __name__ == "__main__":
    main()
