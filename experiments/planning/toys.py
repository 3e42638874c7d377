"""The CPU time to prove each toy problem under `tests/planners/toys`: `python experiments/planning/toys.py`.

The exit code is 1 if the planner does not prove a toy, answers it differently or takes 0.3 s of CPU or more. With
files as arguments, these are planned instead, and only their times and answers are printed.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import yaml

ROOT = Path(__file__).parents[2]
sys.path.append(str(ROOT))

from cfgplan import api  # noqa: E402
from cfgplan.planners.cpsat import plan  # noqa: E402

TOYS = ROOT / "tests" / "planners" / "toys"
LONGEST_S = 0.3


def planned(file: Path) -> tuple[float, str, str | None]:
    """Return the CPU seconds of a plan, its status, and its cost in seconds as text, None without a plan."""
    problem = api.match(api.load(file))
    began = time.process_time()
    found = plan(problem, time_limit_s=20)
    took = time.process_time() - began
    return took, found.status, None if found.cost_us is None else f"{found.cost_us / 1e6:.6f}"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", type=Path, nargs="*", help="default: all toys")
    chosen = parser.parse_args()
    answers = yaml.safe_load((TOYS / "answers.yaml").read_text(encoding="utf-8"))
    planned(TOYS / f"{min(answers)}.yaml")  # loads what is loaded once
    bad = 0
    for file in chosen.files or [TOYS / f"{name}.yaml" for name in answers]:
        took, status, cost = planned(file)
        print(f"{file.stem}: {took:.3f} s of CPU, {status}{'' if cost is None else f', {cost} s'}")
        if not chosen.files:
            answer = answers[file.stem]
            is_right = status == answer["status"] and (cost is None or float(cost) == answer["cost"])
            bad += took >= LONGEST_S or not is_right
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
