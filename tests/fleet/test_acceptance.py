"""What a fleet on three computers has to stand, in short; `experiments/fleet/acceptance.py` plays it at length."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import acceptance
import pytest
from network import SKIPPED

SHORT = (
    *("swaps", "cut", "swap in a cut", "source ends in a cut", "old term", "manager killed", "unit killed"),
    *("slow links", "crowded link", "lossy links", "measured rate", "clocks"),
    *("agent killed", "partition", "storm", "host returns", "cut for good"),
)
PARTS = 4
"""The number of parts, each with cases of every kind. A push plays one of them, the night plays all."""


@pytest.mark.parametrize("seed", range(PARTS))
def test_a_fleet_on_three_computers_stands_cuts_swaps_and_deaths(seed: int, tmp_path: Path) -> None:
    cases = SHORT[seed::PARTS]
    named = [f"--case={case}" for case in cases]
    command = [sys.executable, acceptance.__file__, "--short", *named]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path)
    if done.returncode == SKIPPED:
        pytest.skip(done.stdout.strip())
    assert done.returncode == 0, done.stdout + done.stderr
    assert len(done.stdout.splitlines()) == len(cases)
