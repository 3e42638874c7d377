"""A short soak; the long one is `python experiments/runtime/soak.py --faults 1000`."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

SOAK = Path(__file__).parents[2] / "experiments" / "runtime" / "soak.py"


def test_random_faults_and_swaps_cost_no_element_without_cause() -> None:
    done = subprocess.run([sys.executable, str(SOAK), "--faults", "60", "--seed", "3"], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "'kill_unit'" in done.stdout
