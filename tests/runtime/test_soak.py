"""Short soaks; long ones are `python experiments/operating/soak.py` and `experiments/runtime/soak.py --faults 1000`."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

EXPERIMENTS = Path(__file__).parents[2] / "experiments"


def soak(room: str, *arguments: str) -> str:
    line = [sys.executable, str(EXPERIMENTS / room / "soak.py"), *arguments]
    done = subprocess.run(line, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_random_faults_and_swaps_cost_no_element_without_cause() -> None:
    assert "'kill_unit'" in soak("runtime", "--faults", "60", "--seed", "3")


def test_a_run_in_operation_survives_everything_and_costs_what_a_fresh_plan_costs_in_the_end() -> None:
    told = soak("operating", "--minutes", "0", "--seed", "3")
    assert "'stop_nursery': 1" in told
    assert "as a fresh plan" in told
