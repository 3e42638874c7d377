"""What `run --dry-run` says is what the first review of a run does, and what `ctl plan` says next is: nothing."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import yaml
from cfgplan_runtime import Manager, Policy, SimulatedRuntime
from cfgplan_runtime.lifecycle.basis import previewed
from cfgplan_runtime.operating.operation import Settings

import cfgplan
from cfgplan.api import FEW_PAIRS, matches
from cfgplan.cli import main
from cfgplan.cli.first_plan import first_review
from cfgplan.formats.plan_file import load_plan

MODELS = Path(__file__).parents[2] / "models"
WORLDS = sorted(
    path
    for path in MODELS.rglob("*.yaml")
    if ".expected" not in path.name and {"format", "targets"} <= yaml.load(path.read_text(), yaml.CSafeLoader).keys()
)
PATIENT = Policy(time_limit_s=None)
UNITS = """\
class Cam:
    def __call__(self):
        return 1
"""
SURVIVING = """\
format: cfgplan/1
horizon: 10
survive: units
transformations:
  - {label: cam, source: "units.py:Cam", max_instances: 1, labor: 1, upkeep: 0.01, outputs: {a: A}}
targets:
  - {label: t, topic: /t, tag: A}
"""


def begun(world: cfgplan.World) -> Manager:
    """A manager of simulated units whose first review is over."""
    runtime = SimulatedRuntime()
    manager = Manager(world, runtime, clock=runtime.clock, policy=PATIENT)
    for _ in range(1000):
        if manager.snapshot().reviews:
            break
        manager.step(0.01)
    return manager


def startable(path: Path) -> cfgplan.World:
    """A world of `models/` where nothing runs and all transformations name unit code."""
    world = cfgplan.load(path)
    library = tuple(replace(one, source=one.source or "units.py:Unit") for one in world.environment.library)
    return replace(world, environment=replace(world.environment, units=(), library=library))


def test_worlds_are_there_to_compare() -> None:
    assert len(WORLDS) > 30


@pytest.mark.parametrize("path", WORLDS, ids=[str(path.relative_to(MODELS)) for path in WORLDS])
def test_a_dry_run_answers_what_the_first_review_does(path: Path) -> None:
    world = startable(path)
    settings = Settings(policy=PATIENT, check=None)
    said = first_review(world, settings, matches(world, most=FEW_PAIRS)).findings
    manager = begun(world)
    (review,) = manager.snapshot().reviews
    assert said.change_set == review.change_set
    assert (said.decision, said.cost_us, said.bound_us) == (review.decision, review.cost_us, review.bound_us)
    assert (said.met, said.unmet, said.warnings) == (review.met, review.unmet, review.warnings)

    if review.is_proven:
        again = manager.preview()
        while not again.done():
            manager.step(0.01)
        assert not previewed(again.result()).change_set


@pytest.mark.parametrize("name", ["nao/1-piff-registered", "building/alarms-4-any-may-fail", "fleet/1-start"])
def test_the_command_prints_that_answer(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    path = MODELS / f"{name}.yaml"
    main(["run", str(path), "--dry-run", "--json", "--no-estimates", "--timeout", "300"])
    (tmp_path / "plan.json").write_text(capsys.readouterr().out)
    (review,) = begun(startable(path)).snapshot().reviews
    plan = load_plan(tmp_path / "plan.json")
    assert (plan.change_set, plan.cost_us) == (review.change_set, review.cost_us)


def test_what_can_not_survive_every_failure_is_started_anyway_and_the_dry_run_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "units.py").write_text(UNITS)
    env = tmp_path / "env.yaml"
    env.write_text(SURVIVING)
    assert main(["run", str(env), "--dry-run", "--no-estimates"]) == 0
    said = capsys.readouterr()
    assert "+ start   cam.1" in said.out
    assert "the configuration does not survive every failure" in said.err
    (review,) = begun(cfgplan.load(env)).snapshot().reviews
    assert [unit.id for unit in review.change_set.started] == ["cam.1"]


def test_a_dry_run_tells_of_units_that_it_would_start_without_code(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    env = tmp_path / "env.yaml"
    (tmp_path / "units.py").write_text("def T(a):\n    return a\n")
    env.write_text(
        "format: cfgplan/1\nhorizon: 10\ntransformations:\n  - {label: s, outputs: {a: A}}\n"
        "  - {label: t, source: 'units.py:T', inputs: {a: A}, outputs: {b: B}}\n"
        "targets: [{label: q, topic: /q, tag: B}]\n"
    )
    main(["run", str(env), "--dry-run", "--no-estimates"])
    assert "s: no unit code (`source:`) is named" in capsys.readouterr().err


def test_a_planner_that_fails_in_a_dry_run_is_told_as_such(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "planner_that_fails.py").write_text(
        "def plan(problem, **more):\n    raise ZeroDivisionError('too many')\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    env = tmp_path / "env.yaml"
    env.write_text(SURVIVING)
    assert main(["run", str(env), "--dry-run", "--no-estimates", "--planner", "planner_that_fails:plan"]) == 30
    assert "ZeroDivisionError: too many" in capsys.readouterr().err
