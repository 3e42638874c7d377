"""Fleets of 415 transformations: minimum and weighted quality, three hosts; writes `fleets.md` beside this file.

`python experiments/planning/fleets.py`; `--limit` is the wall time for each plan in seconds. Times are CPU
seconds of all threads, since the machine may be shared; each plan is made in a process of its own.
"""

from __future__ import annotations

import argparse
import multiprocessing
import random
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

sys.path.append(str(Path(__file__).parents[2]))

from cfgplan.domain import Environment, Host
from cfgplan.planners.cpsat import plan
from cfgplan.planners.exact.best_case import least_badness
from cfgplan.planners.exact.candidates import Candidates
from cfgplan.planning import Problem
from cfgplan.qualities import MICRO, Better, Contribution, QualityAttribute, QualityRule, Wish
from experiments.families.random_library import random_library

HERE = Path(__file__).parent
TRANSFORMATIONS, TARGETS, HOSTS = 415, 5, 3
LATENCY = QualityAttribute("latency", Better.LOWER, unit="ms", worst=2000 * MICRO, best=0)


def base(seed: int) -> Problem:
    return random_library(seed, transformations=TRANSFORMATIONS, targets=TARGETS)


def with_latency(seed: int, slack: float | None = None, weight_us: int = 0) -> Problem:
    """Return a problem with latency: outputs add 1 to 100 ms; targets allow `slack` times the least latency, or pay per
    ms.
    """
    problem, draw = base(seed), random.Random(seed)
    library = tuple(
        replace(t, outputs=tuple(replace(o, quality=(_adds(draw.randint(1, 100)),)) for o in t.outputs))
        for t in problem.environment.library
    )
    environment = replace(problem.environment, library=library, qualities=(LATENCY,))
    candidates = Candidates(replace(problem, environment=environment))
    best = least_badness(candidates, LATENCY)  # the best latency is 0
    targets = []
    for target in environment.targets:
        least = min(best[stream] for stream in candidates.streams(target.tag))
        bound = None if slack is None else int(slack * least) // MICRO * MICRO
        targets.append(replace(target, quality=(Wish("latency", bound, weight_us),)))
    return replace(problem, environment=replace(environment, targets=tuple(targets)))


def _adds(ms: int) -> Contribution:
    return Contribution("latency", QualityRule.ADD, ms * MICRO)


def with_hosts(seed: int, room: float, transfer_us: int) -> Problem:
    """Return a problem with three hosts: a fifth of the transformations has a fixed host.

    The hosts have `room` times the CPU time that the plan without hosts takes.
    """
    problem, draw = base(seed), random.Random(seed)
    change_set = plan(problem).change_set
    assert change_set is not None
    used_us = sum(problem.environment.transformation[u.transformation].upkeep_us for u in change_set.started)
    names = [f"h{i}" for i in range(HOSTS)]
    library = tuple(
        replace(
            t,
            host=draw.choice(names) if draw.random() < 0.2 else None,
            outputs=tuple(
                replace(o, rate_uhz=30_000_000, size_bytes=draw.choice([100, 1000, 10_000, 100_000])) for o in t.outputs
            ),
        )
        for t in problem.environment.library
    )
    environment = Environment(
        (),
        library,
        tuple(replace(target, host=draw.choice(names)) for target in problem.environment.targets),
        tuple(Host(name, cpu_us=int(room * used_us / HOSTS)) for name in names),
        transfer_us=transfer_us,
    )
    return replace(problem, environment=environment)


FAMILIES: dict[str, Callable[[int], Problem]] = {
    "no feature": base,
    "latency at most 1.2 times the least": lambda seed: with_latency(seed, slack=1.2),
    "latency weighed, 5 ms of CPU time for 1 ms": lambda seed: with_latency(seed, weight_us=5_000),
    "latency weighed, 20 ms for 1 ms": lambda seed: with_latency(seed, weight_us=20_000),
    "3 hosts with 1.5 times the room, transfers cheap": lambda seed: with_hosts(seed, 1.5, 5_000),
    "3 hosts with 1.5 times the room, transfers dear": lambda seed: with_hosts(seed, 1.5, 100_000),
}


def measured(family: str, seed: int, limit_s: float) -> str:
    import cfgplan.planners.exact.search  # noqa: F401 - the solver's import is not to be measured

    problem = FAMILIES[family](seed)
    began = time.process_time()
    found = plan(problem, time_limit_s=limit_s)
    cpu_s = time.process_time() - began
    gap = "-" if found.gap is None else f"{found.gap:.1%}"
    cost_us = "-" if found.cost_us is None else f"{found.cost_us / 1e6:.2f}"
    return f"| {family} | {seed} | {found.status} | {cost_us} | {found.bound_us / 1e6:.2f} | {gap} | {cpu_s:.2f} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--limit", type=float, default=20.0, help="seconds for each plan (default 20)")
    limit_s = parser.parse_args().limit
    with (HERE / "fleets.md").open("w", encoding="utf-8") as table:
        head = ["| family | seed | status | plan, s | bound, s | gap | CPU s |", "|---|---|---|---|---|---|---|"]
        for row in head:
            print(row, file=table)
        for family in FAMILIES:
            for seed in (0, 1, 2):
                with multiprocessing.get_context("spawn").Pool(1) as pool:
                    row = pool.apply(measured, (family, seed, limit_s))
                print(row, flush=True)
                print(row, file=table, flush=True)


if __name__ == "__main__":
    main()
