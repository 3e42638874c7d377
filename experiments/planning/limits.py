"""How well time limits are kept: `python experiments/planning/limits.py` writes `limits.md` beside this file.

The planner's clock is one of CPU time here, because the machine may be shared; each row is made in a process of its
own. A limit is kept if the plan takes no more than a tenth, or 10 ms, longer.
"""

from __future__ import annotations

import gc
import multiprocessing
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import patch

sys.path.insert(0, str(Path(__file__).parents[1] / "fleet"))

import instances

import cfgplan.planners.fleet.search  # noqa: F401 - the solver takes 0.2 s to import, which is not to be measured
from cfgplan.comparing.families.random_library import random_library
from cfgplan.planners.cpsat import plan
from cfgplan.planners.solving import clock
from cfgplan.planning import Problem

HERE = Path(__file__).parent
SIZES = (50, 500, 5_000, 50_000)
LIMITS_S = (0.02, 0.05, 0.1, 0.3, 1, 3)


def required(transformations: int) -> Problem:
    """One of the last but one layer has to be used."""
    problem = random_library(0, transformations=transformations, targets=8)
    library = list(problem.environment.library)
    at = 3 * len(library) // 4
    library[at] = replace(library[at], required=True)
    return replace(problem, environment=replace(problem.environment, library=tuple(library)))


KINDS: dict[str, Callable[[int], Problem]] = {
    "plain": lambda size: random_library(0, transformations=size, targets=8),
    "a third running": lambda size: random_library(0, transformations=size, targets=8, running=0.3),
    "one required": required,
    "weighed latency": lambda size: instances.weighted(0, size),
    "bounded latency": lambda size: instances.bounded(0, size),
    "3 hosts": lambda size: instances.hosted(0, size),
    "one failure": lambda size: instances.surviving(0, size),
}


class CpuClock:
    """CPU time of the process, read at most once in a millisecond of wall time, since reading it takes long."""

    def __init__(self) -> None:
        self._read, self._cpu_s = 0.0, 0.0

    def monotonic(self) -> float:
        now = time.monotonic()
        if now - self._read > 1e-3:
            self._read, self._cpu_s = now, time.process_time()
        return self._cpu_s


def rows() -> Iterator[str]:
    yield f"| problem | size | {' | '.join(f'{limit_s:g} s' for limit_s in LIMITS_S)} |"
    yield f"|---|---|{'---|' * len(LIMITS_S)}"
    for kind in KINDS:
        for size in SIZES:
            with multiprocessing.get_context("fork").Pool(1) as pool:
                yield f"| {kind} | {size:,} | {' | '.join(pool.apply(measured, (kind, size)))} |"


def measured(kind: str, size: int) -> list[str]:
    """For each limit the CPU seconds it took, in bold if that is too long, and whether there is a plan."""
    for warm in (KINDS[kind](30), random_library(0)):  # neither are other imports
        plan(warm, time_limit_s=5)
    problem = KINDS[kind](size)
    gc.collect()
    gc.freeze()
    cells = []
    with patch.object(clock, "time", SimpleNamespace(monotonic=CpuClock().monotonic)):
        for limit_s in LIMITS_S:
            began = time.process_time()
            found = plan(problem, time_limit_s=limit_s)
            took_s = time.process_time() - began
            is_kept = took_s <= limit_s + max(0.01, 0.1 * limit_s)
            took = f"{took_s:.2f}" if is_kept else f"**{took_s:.2f}**"
            cells.append(took if found.change_set is not None else f"{took} no plan")
    return cells


def main() -> None:
    with (HERE / "limits.md").open("w", encoding="utf-8") as table:
        for row in rows():
            print(row, flush=True)
            print(row, file=table, flush=True)


if __name__ == "__main__":
    main()
