"""Time to proof with quality, hosts and spares: writes `results.md` beside this file.

`python experiments/fleet/benchmark.py`; `--limit` is the time for each plan in seconds. Times are CPU seconds of the
planning process; each plan is made in a process of its own.
"""

from __future__ import annotations

import argparse
import multiprocessing
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

sys.path.append(str(Path(__file__).parents[2]))

from cfgplan.planners.cpsat import plan
from cfgplan.planning import Problem
from cfgplan.validity import plan_violations
from experiments.fleet import instances

HERE = Path(__file__).parent
SEEDS = (0, 1, 2)

FAMILIES: dict[str, Callable[[int], Problem]] = {
    "plain, 415": instances.plain,
    "bounded latency, 415": instances.bounded,
    "weighted latency, 415": instances.weighted,
    "bounded latency and weighted error, 415": instances.both,
    "3 hosts, 415": instances.hosted,
    "3 hosts without limits, 415": lambda seed: instances.hosted(seed, tight=False),
    "3 hosts, 100": lambda seed: instances.hosted(seed, 100, 3),
    "one failure, 60": instances.surviving,
}


def rows(limit_s: float, chosen: list[str]) -> Iterator[str]:
    yield "| family | seed | status | CPU s | cost | bound | gap |"
    yield "|---|---|---|---|---|---|---|"
    for family in FAMILIES:
        if not chosen or any(text in family for text in chosen):
            for seed in SEEDS:
                with multiprocessing.get_context("fork").Pool(1) as pool:
                    yield f"| {family} | {seed} | {pool.apply(measured, (family, seed, limit_s))} |"


def measured(family: str, seed: int, limit_s: float) -> str:
    import ortools.sat.python.cp_model  # noqa: F401 (its import is not what is measured)

    problem = FAMILIES[family](seed)
    began = time.process_time()
    found = plan(problem, time_limit_s=limit_s)
    cpu_s = time.process_time() - began
    assert plan_violations(problem, found) == []
    cost = "-" if found.cost_us is None else f"{found.cost_us / 1e6:.1f}"
    gap = "-" if found.gap is None else f"{found.gap:.1%}"
    return f"{found.status} | {cpu_s:.2f} | {cost} | {found.bound_us / 1e6:.1f} | {gap}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("families", nargs="*", help="only families with one of these texts in their names (all)")
    parser.add_argument("--limit", type=float, default=20.0, help="seconds for each plan (20)")
    arguments = parser.parse_args()
    lines = []
    for row in rows(arguments.limit, arguments.families):
        print(row, flush=True)
        lines.append(row)
    if not arguments.families:
        (HERE / "results.md").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
