"""Units that an earlier run has left on a fleet's hosts: a run asks before it stops them."""

from __future__ import annotations

import os
import pty
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from cfgplan_runtime.fleet.fleet_runtime import Fleet, left_units
from cfgplan_runtime.fleet.reached import ReachedFleet
from cfgplan_runtime.operating.control_client import connect
from cfgplan_runtime.streams.run_folder import base_folder, remove_dead_runs
from small_fleet import FOLDER, PATIENCE_S, SmallFleet, eventually, small_fleet
from warm import cold_command, command, warm_processes

import cfgplan

pytestmark = pytest.mark.usefixtures("warm_cfgplan")

ENVIRONMENT = """\
format: cfgplan/1
horizon: 60
hosts: [{{name: r1}}]
transformations:
  - {{label: {label}, source: "fleet_units.py:count", run: {{rate: 50}}, labor: 1, upkeep: {upkeep}, outputs: {{n: N}}}}
targets: [{{label: result, topic: /result, tag: N, host: r1}}]
"""


def environment(folder: Path, label: str = "count", upkeep: float = 0.1) -> Path:
    """A file beside the unit code, whose agent has it as its folder."""
    env = folder / "env.yaml"
    env.write_text(ENVIRONMENT.format(label=label, upkeep=upkeep))
    (folder / "fleet_units.py").write_bytes((FOLDER / "fleet_units.py").read_bytes())
    return env


def run_of(fleet: SmallFleet, env: Path, *more: str) -> list[str]:
    """The arguments of a run on the fleet."""
    return ["run", str(env), f"--connect={fleet.endpoints[0]}", "--no-estimates", "--plain", *more]


@pytest.fixture
def left(tmp_path: Path) -> Iterator[tuple[SmallFleet, Path]]:
    """A fleet on whose host a killed run has left count.1."""
    env = environment(tmp_path)
    with small_fleet("r1") as fleet:
        with warm_processes().Popen(cold_command(*run_of(fleet, env)), stdout=subprocess.PIPE) as run:
            assert run.stdout is not None
            eventually(lambda: "count.1" in fleet.units())
            with connect() as control:
                eventually(lambda: bool(control.call("state")["units"]))
            run.kill()
        remove_dead_runs(base_folder())
        yield fleet, env


def test_looking_at_what_is_left_changes_nothing(left: tuple[SmallFleet, Path]) -> None:
    fleet, env = left
    reached = Fleet((fleet.endpoints[0],))
    found = left_units(reached, cfgplan.load(env).environment, env.parent)
    assert [unit.id for unit in found.running.units] == ["count.1"] and not found.ended
    other = left_units(reached, cfgplan.load(environment(env.parent, "other")).environment, env.parent)
    assert other.ended == ("count.1",) and not other.running.units
    assert fleet.units() == ["count.1"]


def test_a_run_is_found_by_its_name_from_another_computer(tmp_path: Path) -> None:
    env = environment(tmp_path)
    with (
        small_fleet("r1") as fleet,
        subprocess.Popen(command(*run_of(fleet, env, "--name", "crew")), stdout=subprocess.PIPE) as run,
    ):
        eventually(lambda: "count.1" in fleet.units())
        with ReachedFleet(fleet.endpoints) as reached, connect("crew", reached) as control:
            assert (control.system.name, control.path) == ("crew", None)
            control.call("stop")
        assert run.wait(PATIENCE_S) == 0


def test_units_that_the_plan_keeps_are_not_asked_about(left: tuple[SmallFleet, Path]) -> None:
    fleet, env = left
    done = subprocess.run(
        command(*run_of(fleet, env, "--for", "1s")), capture_output=True, text=True, timeout=PATIENCE_S, check=True
    )
    assert "  = keep    count.1" in done.stdout
    assert "to stop, 1 kept as they are" in done.stdout


def test_without_a_terminal_a_run_stops_no_unit_that_is_left_unless_told(left: tuple[SmallFleet, Path]) -> None:
    fleet, env = left
    environment(env.parent, "other")
    refused = subprocess.run(command(*run_of(fleet, env)), capture_output=True, text=True, timeout=PATIENCE_S)
    assert refused.returncode == 30
    assert "this run would stop 1 unit of an earlier run: count.1" in refused.stderr and "--yes" in refused.stderr
    assert fleet.units() == ["count.1"]
    told = command(*run_of(fleet, env, "--yes", "--for", "1s"))
    done = subprocess.run(told, capture_output=True, text=True, timeout=PATIENCE_S)
    assert done.returncode == 0, done.stderr
    assert "+ start   other.1" in done.stdout
    assert not fleet.units()


@pytest.mark.parametrize(("answer", "code"), [("n\n", 130), ("y\n", 0)])
def test_at_a_terminal_a_run_asks(left: tuple[SmallFleet, Path], answer: str, code: int) -> None:
    fleet, env = left
    environment(env.parent, "other")
    own, other = pty.openpty()
    try:
        with subprocess.Popen(
            command(*run_of(fleet, env, "--for", "1s")), stdin=other, stdout=subprocess.PIPE, stderr=other
        ) as run:
            os.close(other)
            said = b""
            while b"[y/N]" not in said:
                said += os.read(own, 1024)
            assert b"count.1" in said and fleet.units() == ["count.1"]
            os.write(own, answer.encode())
            assert run.wait(PATIENCE_S) == code
            assert fleet.units() == (["count.1"] if code else [])
    finally:
        os.close(own)


def test_an_interrupt_at_the_question_leaves_all_as_it_is(left: tuple[SmallFleet, Path]) -> None:
    fleet, env = left
    environment(env.parent, "other")
    own, other = pty.openpty()
    try:
        with subprocess.Popen(command(*run_of(fleet, env)), stdin=other, stdout=subprocess.PIPE, stderr=other) as run:
            os.close(other)
            said = b""
            while b"[y/N]" not in said:
                said += os.read(own, 1024)
            run.send_signal(signal.SIGINT)
            assert run.wait(PATIENCE_S) == 130
    finally:
        os.close(own)
    assert fleet.units() == ["count.1"]
