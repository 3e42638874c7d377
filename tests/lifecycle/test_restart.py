"""A run survives the death of its supervisor: its units die with it, and the next run plans from the file."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import psutil
import pytest
from cfgplan_runtime import subscribe
from living import living
from real_run import PATIENCE_S, RealRun, eventually, source, worker

RUN = [sys.executable, "-c", "from cfgplan.cli import main; main()", "run", "--json", "--no-estimates"]


def test_nothing_outlives_a_killed_supervisor_and_another_goes_on_from_the_file(
    tmp_path: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path_factory.mktemp("r")))
    files = RealRun(tmp_path)
    files.write(source(), worker())
    first = subprocess.Popen([*RUN, str(files.file)], stdout=subprocess.DEVNULL)
    assert _next_giver() == "work"
    units = psutil.Process(first.pid).children(recursive=True)
    assert len(units) >= 3
    first.kill()
    first.wait()
    eventually(lambda: not living(units))
    files.write(source(), worker(), worker("cheap", upkeep=0.0))
    second = subprocess.Popen([*RUN, str(files.file)], stdout=subprocess.DEVNULL)
    try:
        assert _next_giver() == "cheap"
    finally:
        second.send_signal(signal.SIGINT)
        assert second.wait(PATIENCE_S) == 0


def _next_giver() -> str:
    for received in subscribe("/result", wait_s=PATIENCE_S):
        return str(received.value[0])
    raise AssertionError("the run has ended")
