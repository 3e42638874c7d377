"""Short soaks; each experiment does long ones: `python experiments/ROOM/soak.py`."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

EXPERIMENTS = Path(__file__).parents[2] / "experiments"


@pytest.mark.soak
def test_random_faults_and_swaps_cost_no_element_without_cause() -> None:
    assert "'kill_unit'" in soaked("runtime", "--faults", "60", "--seed", "3")


@pytest.mark.soak
def test_whatever_real_machines_do_a_run_ends_up_at_the_cost_of_a_fresh_plan() -> None:
    pytest.importorskip("mcap", reason="the soak records: it needs cfgplan[record]")
    told = soaked("operating", "--minutes", "0", "--seed", "3")
    assert "'stop_nursery': 1" in told
    assert "'guest_forks': 1" in told
    assert "as a fresh plan" in told


def soaked(room: str, *arguments: str) -> str:
    """What a soak tells, which must come to its end."""
    line = [sys.executable, str(EXPERIMENTS / room / "soak.py"), *arguments]
    done = subprocess.run(line, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout
