"""Each template of `cfgplan init` plans, and its units give its targets."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from cfgplan_runtime import subscribe
from operated_world import PATIENCE_S, await_event, running

from cfgplan.cli.init import TEMPLATES
from cfgplan.cli.main import main

TOPICS = {"kitchen": "/fire", "robot": "/cmd_vel", "building": "/valve/library", "warehouse": "/map"}


def written(folder: Path, template: str) -> Path:
    assert main(["init", str(folder), "--template", template]) == 0
    return folder / "env.yaml"


@pytest.mark.parametrize("template", TEMPLATES)
def test_a_template_is_valid_and_planned(template: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    env = written(tmp_path / "new", template)
    said = capsys.readouterr().out
    assert f"cfgplan solve {env}" in said
    assert main(["check", str(env)]) == 0
    capsys.readouterr()
    assert main(["solve", str(env), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["status"] == "optimal"
    assert found["change_set"]["started"]


def test_the_commands_of_a_template_kill_units_of_its_plan(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    killed = {name: re.findall(r"ctl kill (\S+)", " ".join(each.next)) for name, each in TEMPLATES.items()}
    assert any(killed.values())
    for name, units in killed.items():
        if units:
            env = written(tmp_path / name, name)
            capsys.readouterr()
            assert main(["solve", str(env), "--json"]) == 0
            started = json.loads(capsys.readouterr().out)["change_set"]["started"]
            assert {*units} <= {unit["id"] for unit in started}


def test_each_template_but_that_of_ros_is_run_here() -> None:
    assert TEMPLATES.keys() - {"ros2"} == TOPICS.keys()


@pytest.mark.parametrize("template", TOPICS)
def test_a_template_runs(template: str, tmp_path: Path) -> None:
    env = written(tmp_path / "new", template)
    local = ["--local"] if template == "warehouse" else []
    with running(env, *local) as process:
        name = await_event(process, "Running")["run"]
        with subscribe(TOPICS[template], run=name, wait_s=PATIENCE_S, timeout_s=PATIENCE_S) as results:
            assert next(iter(results)).value is not None


def test_the_robot_of_the_template_can_do_without_its_lidar(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["solve", str(written(tmp_path, "robot")), "--without", "lidar"]) == 0
    assert "pose <- landmark_finder.1/pose" in capsys.readouterr().out


def test_a_template_that_does_not_exist_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["init", str(tmp_path), "--template", "robto"]) == 30
    assert "did you mean `robot`?" in capsys.readouterr().err
