"""Replanning: `python experiments/planning/benchmark.py replan` and `... changes` write the tables beside this file.

`replan` plans as a manager does after each failure, `changes` after every kind of change of a running configuration.
`--limit` is the time for each plan in seconds. Times are CPU seconds of the planning process, all threads together,
because the machine may be shared.
"""

from __future__ import annotations

import argparse
import multiprocessing
import random
import statistics
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import TypeVar

sys.path.append(str(Path(__file__).parents[2]))

from cfgplan.planners.cpsat import PlannerSession
from cfgplan.planning import Plan, Problem
from experiments.families.random_library import random_library
from experiments.planning.changes import CHANGES

Found = TypeVar("Found")
HERE = Path(__file__).parent
SEEDS = (0, 1)
SAMPLES = 15
"""So many changes of each kind are tried from each configuration."""

FAMILIES: dict[str, dict[str, float]] = {
    "50, 3 targets": {"transformations": 50, "targets": 3},
    "500, 8 targets": {"transformations": 500, "targets": 8},
    "1,000, 60 targets": {"transformations": 1000, "targets": 60},
    "5,000, 10 targets": {"transformations": 5000, "targets": 10},
}


def in_own_process(work: Callable[..., Found], *arguments: object) -> Found:
    with multiprocessing.get_context("fork").Pool(1) as pool:
        return pool.apply(work, arguments)


def replan(limit_s: float) -> Iterator[str]:
    """Yield rows: every running unit dies once, in random order, each time from the same optimal configuration."""
    yield "| family | seed | units | first plan, CPU s | median ms | p99 ms | not proven | solver not called |"
    yield "|---|---|---|---|---|---|---|---|"
    for family, parameters in FAMILIES.items():
        for seed in SEEDS:
            yield f"| {family} | {seed} | {in_own_process(replanned, seed, parameters, limit_s)} |"


def replanned(seed: int, parameters: dict[str, float], limit_s: float) -> str:
    session = PlannerSession()
    problem, first_s = at_rest(session, seed, parameters, limit_s)
    times_ms, plans = [], []
    for environment in CHANGES["a unit dies"](problem, random.Random(seed)):
        found, took_ms = timed(session, replace(problem, environment=environment), limit_s)
        plans.append(found)
        times_ms.append(took_ms)
    unproven = sum(found.status != "optimal" for found in plans)
    shortcut = sum("rounds" not in found.counts for found in plans)
    median, p99 = statistics.median(times_ms), p99_of(times_ms)
    return f"{len(plans)} | {first_s:.2f} | {median:.1f} | {p99:.1f} | {unproven} | {shortcut} of {len(plans)}"


def changes(limit_s: float) -> Iterator[str]:
    """Yield rows with median and p99 in ms for each kind of change; between changes the session plans the old
    configuration.
    """
    yield f"| median / p99 ms | {' | '.join(FAMILIES)} |"
    yield f"|---|{'---|' * len(FAMILIES)}"
    times_ms = {
        family: [in_own_process(changed, seed, parameters, limit_s) for seed in SEEDS]
        for family, parameters in FAMILIES.items()
    }
    for kind in CHANGES:
        both = ([ms for one in times_ms[family] for ms in one[kind]] for family in FAMILIES)
        yield f"| {kind} | {' | '.join(f'{statistics.median(ms):.1f} / {p99_of(ms):.1f}' for ms in both)} |"


def changed(seed: int, parameters: dict[str, float], limit_s: float) -> dict[str, list[float]]:
    import cfgplan.planners.exact.search  # noqa: F401 - the solver's import is not to be measured

    session = PlannerSession()
    problem, _ = at_rest(session, seed, parameters, limit_s)
    times_ms: dict[str, list[float]] = {kind: [] for kind in CHANGES}
    for kind, change in CHANGES.items():
        for environment in islice(change(problem, random.Random(seed)), SAMPLES):
            times_ms[kind].append(timed(session, replace(problem, environment=environment), limit_s)[1])
            session.plan(problem, time_limit_s=limit_s)
    return times_ms


def at_rest(session: PlannerSession, seed: int, parameters: dict[str, float], limit_s: float) -> tuple[Problem, float]:
    """Return a problem whose optimal configuration runs, and the CPU seconds of the first plan.

    As with a manager, the session replans after each update until nothing changes.
    """
    problem = random_library(seed, **parameters)  # type: ignore[arg-type]
    found, first_ms = timed(session, problem, 10 * limit_s)
    while found.change_set:
        problem = replace(problem, environment=problem.environment.update(found.change_set))
        found = session.plan(problem, time_limit_s=limit_s)
    return problem, first_ms / 1000


def timed(session: PlannerSession, problem: Problem, limit_s: float) -> tuple[Plan, float]:
    """Return a plan and its CPU milliseconds, including the preparation of the next plan if the update is empty."""
    began = time.process_time()
    found = session.plan(problem, time_limit_s=limit_s)
    return found, 1000 * (time.process_time() - began)


def p99_of(times_ms: list[float]) -> float:
    return sorted(times_ms)[min(len(times_ms) - 1, int(0.99 * len(times_ms)))]


TABLES: dict[str, Callable[[float], Iterator[str]]] = {"replan": replan, "changes": changes}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("table", choices=TABLES)
    parser.add_argument("--limit", type=float, default=10.0, help="seconds for each plan (default 10)")
    arguments = parser.parse_args()
    with (HERE / f"{arguments.table}.md").open("w", encoding="utf-8") as table:
        for row in TABLES[arguments.table](arguments.limit):
            print(row, flush=True)
            print(row, file=table, flush=True)


if __name__ == "__main__":
    main()
