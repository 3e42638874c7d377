"""The cost of a change of the planner: `python experiments/planning/guard.py BEFORE [AFTER]` for one or two checkouts.

Each plan is made in a process of its own, which imports the planner first; CPU seconds of that process are taken. With
two checkouts each instance is planned by one and by the other in turn. Prints a row for each instance, with the gap
between cost and bound of an unproven plan. Prints for each family the geometric mean of the ratios of time, and, if
one of the two has unproven plans, the ratio of their costs and their mean gaps. Ends with 1 if a cost, or the number of
rewired or started units, differs although both prove it, if a proof is lost, or if a family is slower by more than a
tenth.
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from random import Random
from statistics import geometric_mean, mean
from typing import NamedTuple

sys.path.append(str(Path(__file__).parents[2]))
from scale_suite import SCALE

from cfgplan.domain import ChangeSet
from cfgplan.planning import Problem, Status
from experiments.families.deployments import deployment, with_a_ring, with_one_word
from experiments.families.nao import nao
from experiments.families.random_library import random_library
from experiments.families.transport import transport
from experiments.fleet import instances

SLOWER = 1.1
"""A family that takes so many times as long is one too many."""
AGAIN_S, MOST_TIMES = 0.4, 5
"""An instance is planned again until this many CPU seconds are spent, at most so many times."""
Made = list[Problem]
"""What one session plans, one after the other."""


def _required(seed: int, transformations: int) -> Problem:
    problem = random_library(seed, transformations=transformations, targets=8)
    library = list(problem.environment.library)
    at = 3 * len(library) // 4
    library[at] = replace(library[at], required=True)
    return replace(problem, environment=replace(problem.environment, library=tuple(library)))


def _replanning(seed: int, transformations: int, targets: int) -> Made:
    """A plan, the same once it runs, and ten failures of one unit."""
    from cfgplan.planners.cpsat import plan

    problem = random_library(seed, transformations=transformations, targets=targets)
    found = plan(problem).change_set
    assert found is not None
    environment = problem.environment.update(found)
    running = replace(problem, environment=environment)
    dead = Random(seed).sample([unit.id for unit in environment.units], min(10, len(environment.units)))
    broken = [replace(problem, environment=environment.update(ChangeSet(stopped=(unit,)))) for unit in dead]
    return [problem, running, *broken]


PLAIN: dict[str, Callable[[int], Made]] = {
    name: lambda seed, parameters=parameters: [random_library(seed, **parameters)]  # type: ignore[misc]
    for name, parameters in SCALE.items()
}
OTHERS: dict[str, Callable[[int], Made]] = {
    "distinct, 500": lambda seed: [random_library(seed, transformations=500, targets=3, distinct=0.5)],
    "10 of 20 robots fused": lambda seed: [nao(seed, robots=20, fusion=10)],
    "10 of 20 robots fused, two share": lambda seed: [nao(seed, robots=20, fusion=10, sharing=2, cameras=2)],
    "distinct, 100": lambda seed: [random_library(seed, transformations=100, targets=3, distinct=0.5)],
    "required, 500": lambda seed: [_required(seed, 500)],
    "required, 5,000": lambda seed: [_required(seed, 5_000)],
    "replanning, 500": lambda seed: _replanning(seed, 500, 3),
    "replanning, 1,000, 10 targets": lambda seed: _replanning(seed, 1_000, 10),
    "transport, 6 crates": lambda seed: [transport(seed, crates=6)],
    "transport, 10 crates": lambda seed: [transport(seed, places=5, trucks=3, crates=10)],
    "latency weighed, 150": lambda seed: [instances.weighted(seed, 150)],
    "latency weighed, 415": lambda seed: [instances.weighted(seed, 415)],
    "latency bounded, 415": lambda seed: [instances.bounded(seed, 415)],
    "latency and error, 60": lambda seed: [instances.both(seed, 60, 3)],
    "3 hosts, 150": lambda seed: [instances.hosted(seed, 150)],
    "3 hosts, 300": lambda seed: [instances.hosted(seed, 300)],
    "3 roomy hosts, 415": lambda seed: [instances.hosted(seed, 415, tight=False)],
    "deployment, 6 hosts": lambda seed: [deployment(seed)],
    "deployment, 12 hosts": lambda seed: [deployment(200 + seed, hosts=12, replicas=4)],
    "deployment, 20 hosts": lambda seed: [deployment(300 + seed, hosts=20, replicas=6)],
    "deployment, one distinct": lambda seed: [with_one_word(deployment(seed), distinct="d")],
    "deployment, one optional": lambda seed: [with_one_word(deployment(seed), optional=True, worth_us=1_000)],
    "deployment, 20 hosts and a ring": lambda seed: [with_a_ring(deployment(300 + seed, hosts=20, replicas=6))],
    "one failure, 40": lambda seed: [instances.surviving(seed, 40)],
}
FAMILIES = PLAIN | OTHERS
"""The hard ones are among `SCALE`: 2,000 with 3 targets, 1,000 with 5 and 60, two outputs, three inputs and cycles."""


class Figures(NamedTuple):
    """The figures of an instance: CPU seconds for all its plans, and of the last plan the status, the cost, the numbers
    of rewired and started units, and the gap between cost and bound (0 if proven, 1 without a plan).
    """

    cpu_s: float
    is_proven: bool
    gap: float
    status: str
    cost_us: int | None
    counts: list[int] | None

    @property
    def answer(self) -> tuple[str, int | None, list[int] | None]:
        """The part of a proven plan that may not change."""
        return self.status, self.cost_us, self.counts


def measured(family: str, seed: int, limit_s: float) -> Figures:
    """Plan an instance in this process; again, made anew, while that is soon done: the least time counts."""
    from cfgplan.planners.cpsat import PlannerSession

    small = _required(0, 40), instances.weighted(0, 40, 2), instances.surviving(0, 12, 1)
    for problem in (*small, *FAMILIES["500, a third running, 8 targets"](0)):
        PlannerSession().plan(problem)  # so that no import is measured
    times_s: list[float] = []
    while sum(times_s) < AGAIN_S and len(times_s) < MOST_TIMES:
        made, session = FAMILIES[family](seed), PlannerSession()
        gc.collect()
        gc.freeze()  # so that no plan is charged for a look through all that was there before
        began = time.process_time()
        for problem in made:
            found = session.plan(problem, time_limit_s=limit_s)
        times_s.append(time.process_time() - began)
    took_s, changes = min(times_s), found.change_set
    counts = [len(changes.rewired), len(changes.started)] if changes is not None else None
    is_proven = found.status not in (Status.FEASIBLE, Status.UNKNOWN)
    gap = 0.0 if is_proven else 1 - found.bound_us / found.cost_us if found.cost_us else 1.0
    return Figures(took_s, is_proven, gap, str(found.status), found.cost_us, counts)


def in_checkout(checkout: Path, family: str, seed: int, limit_s: float) -> Figures:
    """Return the figures of an instance with the planner of a checkout."""
    setting = {**os.environ, "PYTHONPATH": os.pathsep.join([str(checkout), str(checkout / "runtime")])}
    command = [sys.executable, __file__, "--one", family, "--seeds", str(seed), "--limit", str(limit_s), str(checkout)]
    answer = subprocess.run(command, env=setting, stdout=subprocess.PIPE, text=True, check=True).stdout
    return Figures(*json.loads(answer.splitlines()[-1]))


def rows(checkouts: list[Path], families: list[str], seeds: list[int], limit_s: float) -> Iterator[str]:
    """Yield a row for each instance, then one for each family; raises SystemExit at the end if a check fails."""
    pairs: dict[str, list[tuple[Figures, Figures]]] = defaultdict(list)
    bad = []
    for family in families:
        for seed in seeds:
            found = [in_checkout(checkout, family, seed, limit_s) for checkout in checkouts]
            cells = [f"{one.cpu_s:.3f}" + ("" if one.is_proven else f", gap {one.gap:.1%}") for one in found]
            yield f"| {family} | {seed} | {' | '.join(cells)} |"
            before, after = found[0], found[-1]
            if before.is_proven and before.answer != after.answer:
                bad.append(f"{family} {seed}: {before.answer} before, {after.answer} after")
            pairs[family].append((before, after))
    for family, these in pairs.items() if len(checkouts) > 1 else ():
        took = geometric_mean([after.cpu_s / max(1e-4, before.cpu_s) for before, after in these])
        yield f"{family}: {took:.2f}{_without_proof(these)}"
        if took > SLOWER:
            bad.append(f"{family} takes {took:.2f} times as long")
    if bad:
        sys.exit("\n".join(bad))


def _without_proof(pairs: list[tuple[Figures, Figures]]) -> str:
    """Compare costs and gaps of the pairs with an unproven plan; empty without such pairs."""
    unproven = [(before, after) for before, after in pairs if not (before.is_proven and after.is_proven)]
    if not unproven:
        return ""
    costs = [after.cost_us / before.cost_us for before, after in unproven if before.cost_us and after.cost_us]
    gaps = mean(before.gap for before, _ in unproven), mean(after.gap for _, after in unproven)
    told = f"gap {gaps[0]:.1%} before and {gaps[1]:.1%} after, of {len(unproven)} with an unproven plan"
    return f", costs {geometric_mean(costs):.4f} and {told}" if costs else f", {told}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkouts", nargs="+", type=Path, help="one or two folders with the project in them")
    parser.add_argument("--families", nargs="+", choices=list(FAMILIES), default=list(FAMILIES), help="default: all")
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2], help="default: 0 1 2")
    parser.add_argument("--limit", type=float, default=30.0, help="seconds for each plan (default 30)")
    parser.add_argument("--one", choices=list(FAMILIES), help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.one:
        print(json.dumps(measured(chosen.one, chosen.seeds[0], chosen.limit)))
        return
    for row in rows(chosen.checkouts, chosen.families, chosen.seeds, chosen.limit):
        print(row, flush=True)


if __name__ == "__main__":
    main()
