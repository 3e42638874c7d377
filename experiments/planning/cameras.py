"""Robots that share cameras, by cfgplan and by HiGHS: `python experiments/planning/cameras.py --seeds 9301 9302 9303`.

Each planner has a process of its own and plans each problem three times, in turn with the other one; its least CPU time
counts. Prints a row for each family, with the median CPU milliseconds of each planner and the median of their ratio,
then a row with the median ratio of all problems. Ends with 1 if two plans differ in cost.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Iterator
from itertools import product
from pathlib import Path
from statistics import median

sys.path.append(str(Path(__file__).parents[2]))

from experiments.families.nao import nao

PLANNERS = ("cpsat", "highs")
SIZES = {5: (2, 4), 10: (2, 5, 8), 20: (4, 10, 16), 40: (8, 20, 32)}
"""Numbers of robots, and how many of them are fused."""
FAMILIES = tuple(
    {"robots": robots, "fusion": fusion, "sharing": sharing, "cameras": cameras}
    for robots, numbers in SIZES.items()
    for fusion, (sharing, cameras) in product(numbers, ((2, 1), (4, 1), (1, 2), (2, 2), (1, 4)))
)
TIMES = 3


def serve(planner: str) -> None:
    """Answer each line, a seed and parameters, with the least CPU seconds of a plan, its status and its cost."""
    if planner == "cpsat":
        from cfgplan.planners.cpsat import plan
    else:
        from experiments.peers.milp import plan
    for parameters in FAMILIES[:5]:
        plan(nao(1, **parameters), time_limit_s=20)  # so that no import is measured
    for line in sys.stdin:
        seed, parameters = json.loads(line)
        took_s = []
        for _ in range(TIMES):
            problem = nao(seed, **parameters)
            began = time.process_time()
            found = plan(problem, time_limit_s=20)
            took_s.append(time.process_time() - began)
        print(json.dumps([min(took_s), str(found.status), found.cost_us]), flush=True)


def rows(seeds: list[int]) -> Iterator[str]:
    """Yield the rows; raises SystemExit if two plans differ."""
    command = [sys.executable, __file__, "--serve"]
    servers = [
        subprocess.Popen([*command, name], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        for name in PLANNERS
    ]
    ratios = []
    for parameters in FAMILIES:
        times = []
        for seed in seeds:
            answers = [_answer(server, [seed, parameters]) for server in servers]
            if answers[0][1:] != answers[1][1:]:
                sys.exit(f"{parameters}, seed {seed}: {answers}")
            times.append([answer[0] for answer in answers])
        here = [own / other for own, other in times]
        ratios += here
        cells = [f"{1000 * median(column):.1f}" for column in zip(*times, strict=True)]
        yield f"| {parameters} | {' | '.join(cells)} | {median(here):.2f} |"
    yield f"| all | | | {median(ratios):.2f} (from {min(ratios):.2f} to {max(ratios):.2f}) |"
    for server in servers:
        server.communicate()


def _answer(server: subprocess.Popen[str], question: object) -> list[float]:
    assert server.stdin is not None
    assert server.stdout is not None
    print(json.dumps(question), file=server.stdin, flush=True)
    line = server.stdout.readline()
    while not line.startswith("["):  # HiGHS prints its name first
        line = server.stdout.readline()
    found: list[float] = json.loads(line)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", nargs="+", type=int, default=[9301, 9302, 9303], help="default: 9301 9302 9303")
    parser.add_argument("--serve", choices=PLANNERS, help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.serve:
        serve(chosen.serve)
        return
    for row in rows(chosen.seeds):
        print(row, flush=True)


if __name__ == "__main__":
    main()
