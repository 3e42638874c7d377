"""Short storms; long ones are `python experiments/lifecycle/storm.py`, with `--real` on processes."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

STORM = Path(__file__).parents[2] / "experiments" / "lifecycle" / "storm.py"


@pytest.mark.parametrize(
    "how",
    [
        ["--perturbations", "200", "--seeds", "3"],
        ["--perturbations", "60", "--seeds", "2", "--hosts"],
        ["--perturbations", "30", "--seeds", "1", "--seed", "1", "--real"],
    ],
    ids=["in thought", "on hosts", "on processes"],
)
def test_after_a_storm_what_runs_is_exactly_as_good_as_a_fresh_optimal_plan(how: list[str]) -> None:
    done = subprocess.run([sys.executable, str(STORM), *how], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "'applied'" in done.stdout
