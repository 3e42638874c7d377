"""What The manual on control and operation show is what happens."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

import pytest
from cfgplan_runtime.operating.methods import Methods
from cfgplan_runtime.operating.operation import Operation, Settings
from fake_manager import FakeManager
from operated_world import ENVIRONMENT, PATIENCE_S, await_event, running, write_world

from cfgplan import api
from cfgplan.errors import InputError

MANUAL = Path(__file__).parents[2] / "cfgplan" / "manual"
CONTROL = (MANUAL / "control.md").read_text(encoding="utf-8")
OPERATION = (MANUAL / "operation.md").read_text(encoding="utf-8")
ODOMETER = """
def odometer():
    while True:
        yield 1.0
"""


def blocks(text: str, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", text, re.DOTALL)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    write_world(tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PATH", str(Path(sys.executable).parent), prepend=":")
    return tmp_path


def test_a_program_registers_a_robot_as_shown(folder: Path) -> None:
    (folder / "units.py").write_text((folder / "units.py").read_text() + ODOMETER)
    (folder / "paff.yaml").write_text(blocks(CONTROL, "yaml")[0])
    with running("env.yaml") as process:
        run = await_event(process, "Running")["run"]
        names: dict[str, Any] = {}
        exec(blocks(CONTROL, "python")[0], names)
    assert names["greeting"]["run"] == run
    assert names["reply"]["id"] == 1
    review = names["reply"]["result"]["review"]
    assert "odometer(paff).1" in [unit["id"] for unit in review["change_set"]["started"]]
    assert review["unmet"] == {}


def test_every_method_and_every_part_of_the_state_is_documented() -> None:
    methods = Methods(FakeManager()).by_name()
    said = set(re.findall(r"`(\w+)`", CONTROL))
    assert {*methods, "subscribe"} <= said
    state = methods["state"]({})
    assert {*state, *state["targets"][0], *state["units"][0]} <= said


def test_a_run_is_embedded_as_shown(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    exec(blocks(OPERATION, "python")[0], {})
    assert "TargetView(label='ball'" in capsys.readouterr().out
    assert (folder / "run.mcap").stat().st_size > 0


def test_an_operation_leaves_nothing_behind_where_it_can_not_begin(folder: Path, runs: Path) -> None:
    world = api.load("env.yaml")
    with pytest.raises(InputError, match="can't be written"):
        Operation(world, Path("env.yaml"), Settings(record=folder / "a.mcap", log=folder / "nowhere" / "log"))
    assert not (folder / "a.mcap").exists()
    with pytest.raises(InputError, match="exists already"):
        Operation(world, Path("env.yaml"), Settings(record=folder / "env.yaml"))
    assert (folder / "env.yaml").read_text() == ENVIRONMENT
    assert not list(runs.rglob("control"))


def test_a_run_of_no_transformations_waits_for_what_registers(folder: Path) -> None:
    (folder / "env.yaml").write_text("format: cfgplan/1\ntargets: [{label: ball, topic: /result, tag: Ball}]\n")
    world = api.load("env.yaml")
    with Operation(world, Path("env.yaml")) as operation:
        assert operation.begun.wait(PATIENCE_S)
        assert not operation.all_met
        assert operation.manager.settle(PATIENCE_S)
