"""Compare the planning times of two checkouts on environments that use no feature of a fleet.

`git worktree add ../before COMMIT && python experiments/fleet/plain_speed.py ../before`: both checkouts plan the same
problems in turn, in separate processes; the table has medians of CPU milliseconds and their ratio.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).parents[2]
CASES = {
    "50 transformations, 3 targets": {"transformations": 50, "targets": 3},
    "500 transformations, 1 target": {"transformations": 500, "targets": 1},
    "500 transformations, a third running, 8 targets": {"transformations": 500, "targets": 8, "running": 0.3},
    "5,000 transformations, 1 target": {"transformations": 5000, "targets": 1},
}
CODE = """
import json, sys, time
from experiments.families.random_library import random_library
from cfgplan.planners.cpsat import plan
import ortools.sat.python.cp_model
parameters, times = json.loads(sys.argv[1]), int(sys.argv[2])
problem = random_library(0, **parameters)
plan(problem)
found = []
for _ in range(times):
    fresh = random_library(0, **parameters)
    began = time.process_time()
    cost = plan(fresh).cost_us
    found.append(1000 * (time.process_time() - began))
print(json.dumps([cost, found]))
"""


def measured(checkout: Path, parameters: dict[str, float], times: int) -> tuple[int, list[float]]:
    found = subprocess.run(
        [sys.executable, "-c", CODE, json.dumps(parameters), str(times)],
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(checkout), str(HERE)])},
        cwd=checkout,
        capture_output=True,
        text=True,
        check=True,
    )
    cost, milliseconds = json.loads(found.stdout)
    return cost, milliseconds


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("before", type=Path, help="the other checkout")
    parser.add_argument("--rounds", type=int, default=5, help="how often both are measured (5)")
    arguments = parser.parse_args()
    print("| problem | before, ms | now, ms | ratio |\n|---|---|---|---|")
    for name, parameters in CASES.items():
        times = 3 if parameters["transformations"] > 1000 else 8
        found: dict[Path, list[float]] = {arguments.before.resolve(): [], HERE: []}
        costs = set()
        for _ in range(arguments.rounds):
            for checkout, so_far in found.items():
                cost, milliseconds = measured(checkout, parameters, times)
                costs.add(cost)
                so_far += milliseconds
        assert len(costs) == 1, f"{name}: the costs differ: {costs}"
        before, now = (statistics.median(milliseconds) for milliseconds in found.values())
        print(f"| {name} | {before:.1f} | {now:.1f} | {now / before:.2f} |", flush=True)


if __name__ == "__main__":
    main()
