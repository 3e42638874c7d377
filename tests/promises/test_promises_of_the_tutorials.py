"""What `manual/tutorial.md` and `manual/ros_tutorial.md` promise, beyond that their commands run.

That the commands run and print what stands beside them is asked by `tests/test_manual.py` and
`tests/ros1/test_tutorial.py`; that `ctl restore` waits, and external nodes are adopted, by
`tests/lifecycle/test_given_plans.py`; the demo's positions by `tests/nao`. Steps 9 to 11 of the tutorial are run here.
"""

from __future__ import annotations

import os
import re
import shlex
import signal
import subprocess
import sys
from doctest import ELLIPSIS, NORMALIZE_WHITESPACE, OutputChecker
from pathlib import Path

import pytest
from promised import solved

import cfgplan
from cfgplan.answers import alternatives, sensitivity
from cfgplan.cli import main

ROOT = Path(__file__).parents[2]
OFFICE = ROOT / "models" / "building" / "office.yaml"
FIRST, UNITS = re.findall(r"```yaml\n(.*?)```", (ROOT / "cfgplan/manual/tutorial.md").read_text(), re.DOTALL)[:2]
FIRST = FIRST.partition("format: cfgplan/1\n")[2]


def test_nothing_runs_yet_so_all_three_are_started_and_the_alarm_is_published(tmp_path: Path) -> None:
    found = solved(tmp_path, FIRST)
    assert found.runs == ["camera", "fire_alarm", "thermometer"]
    (published,) = found.unit("fire_alarm.1").publications
    assert (published.port, published.topic) == ("alarm", "/fire")


def test_only_the_difference_is_planned(tmp_path: Path) -> None:
    changes = solved(tmp_path, FIRST + UNITS).plan.change_set
    assert changes is not None
    assert [unit.id for unit in changes.started] == ["thermometer.1"]
    assert [unit.id for unit in changes.rewired] == ["fire_alarm.1"]
    assert changes.stopped == ()


def test_check_names_the_violated_rule_with_file_and_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    solved(tmp_path, FIRST + UNITS)
    text = (env := tmp_path / "env.yaml").read_text()
    assert main(["check", str(env)]) == 1
    line = 1 + next(n for n, each in enumerate(text.splitlines()) if "heat: null" in each)
    assert f"{env}:{line}:" in (out := capsys.readouterr().out.replace("\n", ""))
    assert "fed: input heat of unit fire_alarm.1" in out


@pytest.mark.parametrize(("horizon_s", "has_camera"), [(None, False), (30, True)])
def test_a_camera_is_replaced_by_an_estimate_which_pays_over_an_hour_and_not_over_half_a_minute(
    horizon_s: int | None, has_camera: bool
) -> None:
    world = cfgplan.load(OFFICE)
    assert world.horizon_s == 3600
    problem = cfgplan.match(world, horizon_s=horizon_s)
    before = {unit.transformation for unit in problem.environment.units}
    after = {unit.transformation for unit in problem.after(cfgplan.plan(problem)).units}
    cameras = {label for label in before if "camera" in label}
    assert cameras
    assert bool(cameras & after) is has_camera


def test_the_papers_three_ways_to_get_the_balls_position_are_listed() -> None:
    problem = cfgplan.match(cfgplan.load(ROOT / "models/nao/4-fusion-available.yaml"))
    found = alternatives(problem, 3)
    ways = [{unit.transformation for unit in problem.after(plan).units} for plan in found.plans]
    assert len(ways) == 3
    assert len({frozenset(way) for way in ways}) == 3
    assert sum("fuse_ball_pos" in way for way in ways) == 1


def test_sensitivity_tells_from_which_horizon_on_which_plan_is_the_cheapest() -> None:
    assert len(sensitivity(cfgplan.match(cfgplan.load(OFFICE))).spans) > 1


def test_run_says_that_the_office_has_no_unit_code(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", str(OFFICE)]) == 30
    assert "no transformation names its unit code" in capsys.readouterr().err.replace("\n", " ")


def test_the_warehouse_has_three_hosts_of_which_each_is_an_agent_of_its_own() -> None:
    assert len(cfgplan.load(ROOT / "models/fleet/1-start.yaml").environment.hosts) == 3


CFGPLAN = (sys.executable, "-m", "cfgplan")
PATIENCE_S = 300.0
"""Far longer than anything takes on the slowest machine."""


@pytest.fixture
def runs(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    """Folders of runs of this test's own, and the root of the clone, where the tutorial is read."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path_factory.mktemp("r")))
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
    monkeypatch.chdir(ROOT)


def step(number: int) -> list[tuple[list[list[str]], str]]:
    """The blocks of a step of the tutorial: the arguments of the commands, and what they print."""
    page = (ROOT / "cfgplan/manual/tutorial.md").read_text(encoding="utf-8")
    (text,) = re.findall(rf"^## {number}\. .*?(?=^## |\Z)", page, re.DOTALL | re.MULTILINE)
    shown = re.findall(r"```sh\n(.*?)```.*?```text\n(.*?)```", text, re.DOTALL)
    return [([shlex.split(line)[1:] for line in lines.splitlines()], said) for lines, said in shown]


def said_by(arguments: list[str], *more: str) -> str:
    """What a command prints. It has to end well."""
    command = [*CFGPLAN, *arguments, *more]
    told = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    done = subprocess.run(command, **told, timeout=PATIENCE_S, check=False)
    assert done.returncode == 0, done.stdout
    return done.stdout


def check_shown(shown: str, said: str) -> None:
    assert OutputChecker().check_output(f"...{shown.strip()}...", said, ELLIPSIS | NORMALIZE_WHITESPACE), said


@pytest.mark.usefixtures("runs")
def test_a_question_about_time_is_answered_as_step_9_shows() -> None:
    (((query,), shown),) = step(9)
    check_shown(shown, said_by(query))


@pytest.mark.usefixtures("runs")
def test_the_map_goes_on_without_a_robot_as_step_10_shows() -> None:
    (((run,), planned), (others, shown)) = step(10)
    command = [*CFGPLAN, *run, "--plain", "--no-estimates"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        try:
            assert process.stdout is not None
            lines = []
            for line in process.stdout:
                lines.append(line)
                if line.startswith("Running "):
                    break
            check_shown(planned, "".join(lines))
            waits = {"listen": ("--wait", "60s")}
            check_shown(shown, "".join(said_by(each, *waits.get(each[0], ())) for each in others))
            said_by(["ctl", "stop"])
        finally:
            os.kill(process.pid, signal.SIGTERM)
            process.communicate(timeout=PATIENCE_S)


@pytest.mark.usefixtures("runs")
def test_the_demo_tells_what_step_11_shows(tmp_path: Path) -> None:
    (((demo,), shown),) = step(11)
    page = tmp_path / "nao.html"
    said = said_by(demo, "--step", "1s", "--report", str(page))
    check_shown(shown.replace("nao.html", str(page)), said)
