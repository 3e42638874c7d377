"""Work that takes long shows how far it is: in one line on a terminal, in a line every few seconds elsewhere."""

from __future__ import annotations

import os
import pty
import subprocess
import threading
from collections.abc import Callable
from pathlib import Path

import pytest
from command import Run
from warm import command

from cfgplan.cli import screen
from cfgplan.cli.screen import Screen, ShownWork, decided_by
from cfgplan.planning import Progress

LIBRARY = """transformations:
  - {label: camera, outputs: {image: Image}}
targets:
  - {label: seen, topic: /seen, tag: Image}
"""
PLANNER = """
import time
from pathlib import Path
from cfgplan.planners.cpsat import plan as best
from cfgplan.planning import Progress

def plan(problem, *, time_limit_s=None, report=None):
    if report is not None:
        report(Progress(0.1, 115_000_000, 94_000_000))
    while not Path("go on").exists():
        time.sleep(0.01)
    return best(problem)
"""
SHOWN = "best 115.0  bound 94.00  gap 18 %"


@pytest.fixture
def env(tmp_path: Path, write: Callable[[str], Path], monkeypatch: pytest.MonkeyPatch) -> Path:
    """An environment, with a slow planner beside it, which goes on once there is a file `go on`."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "slow_planner.py").write_text(PLANNER)
    return write(LIBRARY)


def test_without_a_terminal_there_is_a_line_every_few_seconds(
    env: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    note = Screen.note

    def noted(self: Screen, text: str, style: str = "dim") -> None:
        note(self, text, style)
        if SHOWN in text:
            Path("go on").touch()

    monkeypatch.setattr(Screen, "note", noted)
    monkeypatch.setattr(screen, "WORK_TOLD_S", 0.05)
    result = run("solve", env, "--planner", "slow_planner:plan")
    assert result.code == 0
    assert f"plan 0 s  {SHOWN}\n" in result.err
    assert SHOWN not in result.out


def test_what_is_over_soon_says_nothing_on_the_way(env: Path, run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(screen, "WORK_TOLD_S", 3600.0)
    assert [line.partition(" ")[0] for line in run("solve", env).err.splitlines()] == ["Time:"]


def test_progress_in_json_is_not_told_twice(env: Path, run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(screen, "WORK_TOLD_S", 0.001)
    Path("go on").touch()
    err = run("solve", env, "--planner", "slow_planner:plan", "--progress").err
    assert '"cost_us": 115000000' in err
    assert SHOWN not in err


@pytest.mark.usefixtures("warm_cfgplan")
@pytest.mark.parametrize("verb", [["solve"], ["explain"]])
def test_a_terminal_has_one_line_that_changes(env: Path, verb: list[str]) -> None:
    leader, follower = pty.openpty()
    call = command(*verb, env, "--planner", "slow_planner:plan")
    surroundings = {**os.environ, "TERM": "xterm", "COLUMNS": "100"}
    shown = b""
    with subprocess.Popen(call, stdout=subprocess.DEVNULL, stderr=follower, env=surroundings) as process:
        os.close(follower)
        while SHOWN.encode() not in shown:
            shown += os.read(leader, 4096)
        Path("go on").touch()
        drained = threading.Thread(target=_drain, args=(leader,), daemon=True)
        drained.start()
        assert process.wait() == 0
    drained.join()
    os.close(leader)


def _drain(leader: int) -> None:
    try:
        while os.read(leader, 4096):
            pass
    except OSError:  # the other end is closed
        pass


def test_bound_and_gap_are_told_as_far_as_they_are_known() -> None:
    work = ShownWork("plan")
    work.report(Progress(1.0, None, 2_500_000))
    assert work.best == "bound 2.500"
    work.report(Progress(1.0, 0, 0))
    assert work.best == "best 0.000  bound 0.000  gap 0 %"
    work.knows = lambda: decided_by({"pairs asked": 3, "pairs decided by el": 12, "pairs decided by HermiT": 3, "x": 1})
    assert str(work).endswith("gap 0 %  12 by el, 3 by HermiT")
    assert decided_by({"pairs decided by el": 12}) == ""
