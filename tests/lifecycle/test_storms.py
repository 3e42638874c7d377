"""Short storms; long ones are `python experiments/lifecycle/storm.py`, with `--real` on processes."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

STORM = Path(__file__).parents[2] / "experiments" / "lifecycle" / "storm.py"


HOW = {
    "in thought": ["--perturbations", "200"],
    "on hosts": ["--perturbations", "60", "--hosts"],
    "on processes": ["--perturbations", "30", "--real"],
}


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("how", HOW)
def test_after_a_storm_what_runs_is_exactly_as_good_as_a_fresh_optimal_plan(how: str, seed: int) -> None:
    one = [*HOW[how], "--seeds", "1", "--seed", str(seed)]
    done = subprocess.run([sys.executable, str(STORM), *one], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "'applied'" in done.stdout
