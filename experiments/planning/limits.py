"""Tests whether plans keep their time limits: `python experiments/planning/limits.py` writes `limits.md` beside this
file.

With `depth` it prints the same for chains and rows of pairs, and their time without a limit.

The planner's clock measures CPU time here, because the machine may be shared; each row is measured in a new process.
A limit is kept if planning exceeds it by at most 10 % or 10 ms. A limit that leaves no plan is followed by a search for
a first one, as `Clock.for_a_first_plan` says; its time is listed separately.
"""

from __future__ import annotations

import argparse
import gc
import math
import multiprocessing
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import TypeAlias
from unittest.mock import patch

sys.path.append(str(Path(__file__).parents[2]))

import cfgplan.planners.exact.search  # noqa: F401 - the solver takes 0.2 s to import, which is not to be measured
from cfgplan.domain import Environment, Host, InputPort, OutputPort, Similarity, Target, Transformation
from cfgplan.planners.cpsat import plan
from cfgplan.planners.solving import clock
from cfgplan.planning import Problem
from cfgplan.qualities import Better, Contribution, QualityAttribute, QualityRule, Wish
from experiments.families.nao import nao
from experiments.families.random_library import random_library
from experiments.fleet import instances

HERE = Path(__file__).parent
SIZES = (50, 500, 5_000, 50_000)
LIMITS_S = (0.02, 0.05, 0.1, 0.3, 1, 3, 10)
DEPTHS = (1_000, 2_000, 5_000)
DEPTH_LIMITS_S = (0.5, 1, 2, math.inf)
Limits: TypeAlias = tuple[float, ...]


def required(transformations: int) -> Problem:
    """Return a problem in which a transformation of the last but one layer is required."""
    problem = random_library(0, transformations=transformations, targets=8)
    library = list(problem.environment.library)
    at = 3 * len(library) // 4
    library[at] = replace(library[at], required=True)
    return replace(problem, environment=replace(problem.environment, library=tuple(library)))


KINDS: dict[str, Callable[[int], Problem]] = {
    "plain": lambda size: random_library(0, transformations=size, targets=8),
    "60 targets": lambda size: random_library(0, transformations=size, targets=60),
    "a third running": lambda size: random_library(0, transformations=size, targets=8, running=0.3),
    "one required": required,
    "weighed latency": lambda size: instances.weighted(0, size),
    "bounded latency": lambda size: instances.bounded(0, size),
    "distinct inputs": lambda size: random_library(0, transformations=size, targets=8, distinct=1.0),
    "cycles": lambda size: random_library(0, transformations=size, targets=3, arity=3, back=0.4),
    "robots that share cameras": lambda size: nao(0, robots=max(2, size // 100), fusion=max(2, size // 200), sharing=4),
    "3 hosts": lambda size: instances.hosted(0, size),
    "one failure": lambda size: instances.surviving(0, size),
}


def chain(size: int, *, pairs: bool = False, hosts: tuple[Host, ...] = (), quality: bool = False) -> Problem:
    """Return a chain: each unit needs the one before; with `pairs`, each of two units needs both units before."""
    error = QualityAttribute("error", Better.LOWER, worst=2 * size)
    adds = (Contribution("error", QualityRule.ADD, 1),) if quality else ()
    width = 2 if pairs else 1
    library = tuple(
        Transformation(
            f"t{at}_{k}",
            tuple(InputPort(f"i{j}", f"T{at - 1}", "both" if pairs else None) for j in range(width if at else 0)),
            (OutputPort("o", f"T{at}", adds),),
            labor_us=5 + k,
            upkeep_us=1,
        )
        for at in range(size // width)
        for k in range(width)
    )
    last = f"T{size // width - 1}"
    wish = (Wish("error", 3 * size // 2, 1_000_000),) if quality else ()
    qualities = (error,) if quality else ()
    environment = Environment((), library, (Target("t", last, "/t", 0, wish),), hosts, qualities, 3 if hosts else 0)
    return Problem(environment, Similarity({f"T{at}": frozenset({f"T{at}"}) for at in range(size // width)}), 1)


DEEP: dict[str, Callable[[int], Problem]] = {
    "chain": chain,
    "chain, 2 hosts": partial(chain, hosts=(Host("left"), Host("right"))),
    "chain, quality": partial(chain, quality=True),
    "row of pairs": partial(chain, pairs=True),
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


def rows(kinds: Iterable[str], sizes: Limits, limits_s: Limits) -> Iterator[str]:
    yield f"| problem | size | {' | '.join(f'{s:g} s' if s < math.inf else 'no limit' for s in limits_s)} |"
    yield f"|---|---|{'---|' * len(limits_s)}"
    for kind in kinds:
        for size in map(int, sizes):
            with multiprocessing.get_context("fork").Pool(1) as pool:
                yield f"| {kind} | {size:,} | {' | '.join(pool.apply(measured, (kind, size, limits_s)))} |"


def measured(kind: str, size: int, limits_s: Limits) -> list[str]:
    """Return for each limit the CPU seconds used, in bold if too many, and whether or when a plan was found later."""
    make = (KINDS | DEEP)[kind]
    for warm in (make(30), random_library(0)):  # neither are other imports
        plan(warm, time_limit_s=5)
    problem = make(size)
    gc.collect()
    gc.freeze()
    cells = []
    for limit_s in limits_s:
        given_up_s: list[float] = []
        began = time.process_time()
        with cpu_clock(lambda began=began, given_up_s=given_up_s: given_up_s.append(time.process_time() - began)):
            found = plan(problem, time_limit_s=limit_s if limit_s < math.inf else None)
        ended_s = time.process_time() - began
        took_s, *_ = *given_up_s, ended_s
        is_kept = took_s <= limit_s + max(0.01, 0.1 * limit_s)
        took = f"{took_s:.2f}" if is_kept else f"**{took_s:.2f}**"
        if given_up_s:
            took += " no plan" if found.change_set is None else f", first plan {ended_s:.2f}"
        cells.append(took)
    return cells


@contextmanager
def cpu_clock(on_first_plan: Callable[[], None]) -> Iterator[None]:
    """Let the planner's clock measure CPU time, and call `on_first_plan` when a limit has left no plan."""
    usual = clock.Clock.for_a_first_plan

    def for_a_first_plan(self: clock.Clock, problem: Problem) -> clock.Clock:
        on_first_plan()
        return usual(self, problem)

    cpu_time = SimpleNamespace(monotonic=CpuClock().monotonic, process_time=time.process_time)
    with (
        patch.object(clock, "time", cpu_time),
        patch.object(clock.Clock, "for_a_first_plan", for_a_first_plan),
    ):
        yield


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("of", nargs="?", choices=["depth"], help="without it, all kinds of problems, for limits.md")
    if parser.parse_args().of == "depth":
        for row in rows(DEEP, DEPTHS, DEPTH_LIMITS_S):
            print(row, flush=True)
        return
    with (HERE / "limits.md").open("w", encoding="utf-8") as table:
        for row in rows(KINDS, SIZES, LIMITS_S):
            print(row, flush=True)
            print(row, file=table, flush=True)


if __name__ == "__main__":
    main()
