"""Plans of instances of all families as they were proven once: `python tests/planners/golden.py` writes them.

A planner that is built anew has to find the same costs, and the same numbers of rewired and started units.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping
from pathlib import Path

sys.path.append(str(Path(__file__).parents[2]))

from cfgplan.planning import Plan, Problem, Status
from experiments.fleet import instances
from experiments.study.instances import Instance, generated

FILE = Path(__file__).with_suffix(".json")
LIMIT_S = 60.0
SEEDS = (50, 51, 52)


def _libraries() -> Mapping[str, Instance]:
    shapes: Mapping[str, Mapping[str, float]] = {
        "plain": {"transformations": 40},
        "one target": {"transformations": 150, "targets": 1},
        "two outputs": {"transformations": 40, "outputs": 2},
        "deep": {"transformations": 40, "depth": 12},
        "narrow": {"transformations": 40, "branching": 2},
        "wide": {"transformations": 60, "branching": 16},
        "three inputs": {"transformations": 25, "arity": 3, "back": 0.3},
        "cycles": {"transformations": 30, "back": 0.5},
        "shared": {"transformations": 40, "sharing": 0.9},
        "distinct": {"transformations": 30, "distinct": 0.7},
        "running": {"transformations": 40, "running": 0.5},
        "all running": {"transformations": 40, "running": 1.0},
        "distinct running": {"transformations": 25, "distinct": 0.5, "running": 0.5},
        "many targets": {"transformations": 40, "targets": 10},
        "no horizon": {"transformations": 40, "horizon_s": 0},
    }
    found = {
        f"{name} {seed}": generated("random_library", seed, **shape) for name, shape in shapes.items() for seed in SEEDS
    }
    for failures in (1, 4):
        for seed in SEEDS:
            name = f"replanning {failures} {seed}"
            found[name] = generated("replanning", seed, transformations=80, targets=5, failures=failures)
    for robots in (1, 2, 5):
        found[f"nao {robots}"] = generated("nao", robots=robots)
        found[f"nao {robots} lost"] = generated("nao", robots=robots, event="lost")
    for robots in (2, 3, 4):
        found[f"nao {robots} fusion"] = generated("nao", robots=robots, fusion=2)
    for kind, sizes in {"dedicated": (4, 16), "tower": (4, 10), "blow-up": (4, 6), "ring": (3, 16)}.items():
        for size in sizes:
            found[f"{kind} {size}"] = generated("adversarial", kind=kind, size=size)
    return found


FLEETS: Mapping[str, Callable[[int], Problem]] = {
    "latency weighed": lambda seed: instances.weighted(seed, 30, 3),
    "latency weighed, more": lambda seed: instances.weighted(seed, 60, 3),
    "latency bounded": lambda seed: instances.bounded(seed, 40, 3),
    "latency and error": lambda seed: instances.both(seed, 20, 2),
    "three hosts": lambda seed: instances.hosted(seed, 25, 2),
    "two hosts": lambda seed: instances.hosted(seed, 25, 2, hosts=2),
    "roomy hosts": lambda seed: instances.hosted(seed, 25, 3, tight=False),
    "survival": lambda seed: instances.surviving(seed, 15, 2),
    "survival, more": lambda seed: instances.surviving(seed, 25, 1),
}
FLEET_SEEDS = (*SEEDS, 53, 54)


def problems() -> dict[str, Callable[[], Problem]]:
    """Every instance by name."""
    found: dict[str, Callable[[], Problem]] = {
        name: lambda one=one: one.problem
        for name, one in _libraries().items()  # type: ignore[misc]
    }
    for name, make in FLEETS.items():
        for seed in FLEET_SEEDS:
            found[f"{name} {seed}"] = lambda make=make, seed=seed: make(seed)  # type: ignore[misc]
    return found


def row(plan: Plan) -> list[object]:
    """What is kept of a plan: status, cost, rewired and started units, unused required transformations."""
    changes = plan.change_set
    counts = (len(changes.rewired), len(changes.started)) if changes is not None else (None, None)
    return [str(plan.status), plan.cost_us, *counts, list(plan.unused_required)]


def main() -> None:
    from cfgplan.planners import PLANNERS

    rows = {}
    for name, problem in problems().items():
        plan = PLANNERS["cpsat"](problem(), time_limit_s=LIMIT_S)
        if plan.status in (Status.FEASIBLE, Status.UNKNOWN):
            sys.exit(f"{name} is not proven within {LIMIT_S:g} s")
        rows[name] = row(plan)
    lines = ",\n".join(f"  {json.dumps(name)}: {json.dumps(value)}" for name, value in rows.items())
    FILE.write_text(f"{{\n{lines}\n}}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
