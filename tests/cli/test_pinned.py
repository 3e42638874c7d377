"""A pinned unit that can't be fed is stopped, and every command says why."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from command import Run

import cfgplan
from cfgplan.errors import InputError

SIM = """
transformations:
  - {label: sim, labor: 1, upkeep: 0.01, pinned: true, inputs: {cmd: CmdVel and Sim}, outputs: {clock: Clock and Sim}}
  - {label: source, labor: 1, outputs: {o: Wanted}}
units:
  - {id: sim.1, transformation: sim, inputs: {cmd: null}}
targets: [{label: t, topic: /t, tag: Wanted}]
"""
HOSTED = SIM.replace("inputs: {cmd: null}", "inputs: {cmd: null}, host: h") + "hosts: [{name: h}]\n"
WHY = "pinned unit sim.1 can't be fed: its input cmd wants CmdVel and Sim, but no output matches"


@pytest.mark.parametrize(
    ("text", "options"),
    [
        (SIM, ("--planner", "cpsat")),
        (SIM, ("--planner", "branch-and-bound")),
        (SIM, ("--planner", "exhaustive")),
        (SIM, ("--best-effort",)),
        (HOSTED, ("--planner", "cpsat")),
        (HOSTED, ("--planner", "exhaustive")),
    ],
)
def test_every_planner_says_why_a_pinned_unit_is_stopped_and_what_comes_nearest(
    run: Run, write: Callable[[str], Path], text: str, options: tuple[str, ...]
) -> None:
    result = run("solve", write(text), *options)
    assert result.code in (0, 20)
    assert f"Stopped, though pinned: {WHY}." in result.out
    assert "Given up" not in result.out
    assert "warning: pinned unit sim.1 is stopped, since it can't be fed" in result.err
    assert "input cmd wants CmdVel" in result.err
    assert "nearest: sim/clock gives Clock and Sim: lacks CmdVel" in result.err
    assert run("solve", write(text), *options, "--json").document["reasons"] == {"sim.1": WHY}


def test_explain_tells_why_a_pinned_unit_can_not_be_fed(run: Run, write: Callable[[str], Path]) -> None:
    result = run("explain", write(SIM), "--unit", "sim.1")
    assert "pinned unit sim.1 is stopped, since it can't be fed" in result.out
    assert "nearest: sim/clock gives Clock and Sim: lacks CmdVel" in result.out
    named = run("explain", write(SIM), "--unit", "sim.1", "--json").document["unfed"]["sim.1"]
    assert named["blocked"][0]["inputs"][0]["port"] == "cmd"


def test_a_pinned_unit_that_can_be_fed_goes_on_without_a_word(run: Run, write: Callable[[str], Path]) -> None:
    fed = SIM.replace("outputs: {o: Wanted}", "outputs: {o: Wanted, c: CmdVel and Sim}")
    result = run("solve", write(fed))
    assert "~ rewire  sim.1" in result.out
    assert "pinned" not in result.out + result.err


def test_a_plan_file_that_stops_a_pinned_unit_without_a_word_is_refused(
    run: Run, write: Callable[[str], Path], tmp_path: Path
) -> None:
    env, out = write(SIM), tmp_path / "plan.json"
    assert run("solve", env, "--out", out).code == 0
    world = cfgplan.load(env)
    problem = cfgplan.problem(world, cfgplan.match(world).similarity)
    assert cfgplan.load_plan(world, problem, out).reasons == {"sim.1": WHY}
    data = json.loads(out.read_text())
    out.write_text(json.dumps({**data, "reasons": {}}))
    with pytest.raises(InputError, match=r"sim\.1 is pinned, and it is not said why"):
        cfgplan.load_plan(world, problem, out)


def test_a_pinned_unit_and_a_target_of_one_name_have_their_own_reasons(run: Run, write: Callable[[str], Path]) -> None:
    text = SIM.replace("]\n", ", {label: sim.1, topic: /u, tag: Nothing}]\n")
    result = run("solve", write(text), "--best-effort")
    assert result.code == 12
    assert f"Stopped, though pinned: {WHY}." in result.out
    assert "Given up: 1 of 2 targets." in result.out
    unmet = "target sim.1 wants Nothing, but no output matches"
    assert f"  {unmet}\n" in result.out
    reasons = run("solve", write(text), "--best-effort", "--json").document["reasons"]
    assert reasons == {"sim.1": unmet, "unit sim.1": WHY}
