"""A short soak of a fleet; `experiments/fleet/soak.py` is the long one."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import network
import pytest

SOAK = Path(network.__file__).with_name("soak.py")


@pytest.mark.soak
def test_whatever_happens_to_a_fleet_no_element_is_lost_uncounted_and_no_unit_is_left(tmp_path: Path) -> None:
    line = [sys.executable, str(SOAK), "--minutes", "0", "--seed", "3"]
    done = subprocess.run(line, capture_output=True, text=True, check=False, cwd=tmp_path)
    if done.returncode == network.SKIPPED:
        pytest.skip(done.stdout.strip())
    assert done.returncode == 0, done.stdout + done.stderr
    assert "'certificate_ends': 1" in done.stdout and "'lossy_links': 1" in done.stdout
