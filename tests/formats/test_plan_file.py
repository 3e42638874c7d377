"""Plans written as JSON and read again."""

from __future__ import annotations

import json
import tempfile
from dataclasses import replace
from pathlib import Path

import pytest
from environments import NAMES, environments
from hypothesis import given, settings
from hypothesis import strategies as st

from cfgplan.domain import (
    ChangeSet,
    ComputationUnit,
    Environment,
    Objective,
    Publication,
    Similarity,
    Target,
    Transformation,
)
from cfgplan.errors import InputError, InvalidValueError
from cfgplan.formats.environment_file import EnvironmentFile
from cfgplan.formats.plan_file import PlanPart, dump_plan, load_plan, read_run_plan
from cfgplan.planning import Measured, Plan, Problem, Status

LIBRARY = (Transformation("a", labor_us=7, upkeep_us=3),)
PROBLEM = Problem(Environment(library=LIBRARY), Similarity({}), horizon_s=60, max_cost_us=5)
PLAN = Plan(
    "cpsat",
    Status.OPTIMAL,
    ChangeSet(started=(ComputationUnit("a.1", "a", (), (Publication("o", "/t"),)),), stopped=("b.1",)),
    cost_us=1_500_187,
    bound_us=1_500_187,
    unused_required=("a",),
    seconds={"solve": 0.25},
    counts={"nodes": 3},
)


def written(folder: Path, text: str) -> Path:
    path = folder / "plan.json"
    path.write_text(text, encoding="utf-8")
    return path


@given(environments(), st.sampled_from(Status), st.data())
@settings(max_examples=100, deadline=None)
def test_what_is_written_loads_back(environment: Environment, status: Status, data: st.DataObject) -> None:
    units = list(environment.units)
    first = data.draw(st.integers(0, len(units)))
    plan = Plan(
        data.draw(NAMES),
        status,
        data.draw(st.none() | st.just(ChangeSet(tuple(units[:first]), tuple(units[first:]), ("\0gone",)))),
        data.draw(st.none() | st.integers(0, 2**53 - 1)),
        data.draw(st.integers(0, 2**53 - 1)),
        data.draw(st.dictionaries(NAMES, NAMES)),
        tuple(data.draw(st.lists(NAMES))),
    )
    with tempfile.TemporaryDirectory() as folder:
        text = dump_plan(plan, Problem(environment, Similarity({}), 0), "digest")
        assert load_plan(written(Path(folder), text), "digest") == plan


def test_what_is_minimised_before_the_cost_loads_back(tmp_path: Path) -> None:
    hosts, cost = Measured(Objective.HOSTS, 2, 1), Measured(Objective.COST, 1_500_187, 0)
    plan = replace(PLAN, status=Status.FEASIBLE, change_set=ChangeSet(), bound_us=0, objectives=(hosts, cost))
    problem = replace(PROBLEM, environment=replace(PROBLEM.environment, minimise=(Objective.HOSTS,)))
    text = dump_plan(plan, problem, "digest")
    assert json.loads(text)["gap"] == 0.5
    assert load_plan(written(tmp_path, text), "digest") == plan


def test_a_plan_says_its_costs_twice_in_microseconds_and_in_seconds() -> None:
    data = json.loads(dump_plan(PLAN, PROBLEM, "digest"))
    assert (data["format_version"], data["environment"], data["status"]) == (1, "digest", "optimal")
    assert (data["cost_us"], data["cost_s"], data["gap"]) == (1_500_187, 1.500187, 0.0)
    assert (data["horizon_s"], data["max_cost_us"]) == (60, 5)
    (started,) = data["change_set"]["started"]
    assert (started["labor_us"], started["upkeep_us"], started["topics"]) == (7, 3, {"o": ["/t"]})


def test_times_and_counts_survive(tmp_path: Path) -> None:
    plan = load_plan(written(tmp_path, dump_plan(PLAN, PROBLEM, "digest")))
    assert (plan.seconds, plan.counts) == (PLAN.seconds, PLAN.counts)


def test_a_plan_for_another_environment_is_refused_as_stale(tmp_path: Path) -> None:
    before = PROBLEM.environment
    path = written(tmp_path, dump_plan(PLAN, PROBLEM, EnvironmentFile(Path(), before, 60).digest))
    assert load_plan(path, EnvironmentFile(Path(), before, 60).digest) == PLAN
    after = Environment(library=LIBRARY, targets=(Target("t", "T", "/t"),))
    with pytest.raises(InputError, match=r"plan\.json:3:18: environment: the plan is stale.*solve again"):
        load_plan(path, EnvironmentFile(Path(), after, 60).digest)


def test_changes_of_the_library_are_no_plan() -> None:
    plan = Plan("mine", Status.OPTIMAL, ChangeSet(removed_transformations=("a",)))
    with pytest.raises(InvalidValueError):
        dump_plan(plan, PROBLEM, "digest")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"format_version": 1', '"format_version": 2', "2:21: format_version: `format_version` is the number 2"),
        (
            '"status": "optimal"',
            '"status": "fine"',
            "infeasible, too expensive or unknown, but is the text 'fine'",
        ),
        ('"stopped": [', '"stoped": [', "did you mean `stopped`?"),
        ('"upkeep_us": 3', '"upkep_us": 3', "did you mean `upkeep_us`?"),
        ('"bound_us": 1500187', '"bound_us": 1.5', "a whole number"),
        ('"b.1"', '"a.1"', "'a.1' is named again"),
        ('"inputs": {}', '"inputs": {"i": "nowhere"}', "'nowhere' is not a stream"),
        ('"planner": "cpsat",', "", "the key `planner` is missing"),
        ("{", "", "this is not JSON"),
    ],
)
def test_a_broken_plan_file_has_its_fault(tmp_path: Path, old: str, new: str, message: str) -> None:
    text = dump_plan(PLAN, PROBLEM, "digest").replace('"topics"', '"inputs": {},\n          "topics"')
    assert old in text
    with pytest.raises(InputError) as caught:
        load_plan(written(tmp_path, text.replace(old, new, 1)))
    assert message in str(caught.value)


def test_what_is_no_plan_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="must be a mapping"):
        load_plan(written(tmp_path, "[]"))


@pytest.mark.parametrize("text", ["# a world\nformat: cfgplan/1\n", "  targets: []", "<environment/>"])
def test_a_file_of_another_format_is_told_how_a_plan_is_written(tmp_path: Path, text: str) -> None:
    with pytest.raises(InputError, match=r"this is not JSON.*a file that `cfgplan solve --out` or"):
        load_plan(written(tmp_path, text))
    with pytest.raises(InputError, match="put a comma between two values"):
        load_plan(written(tmp_path, '{"format_version": 1 "status": 2}'))


def test_the_schema_of_plans_names_every_key() -> None:
    data = json.loads(dump_plan(PLAN, PROBLEM, "digest"))
    now_and_then = {"survive", "figures", "objectives", "facts", "qualities", "basis"}
    assert set(data) | now_and_then == set(PlanPart.model_fields)
    assert now_and_then.isdisjoint(data)


def test_the_plan_of_a_run_names_what_it_was_made_for() -> None:
    basis = {"unit": {"camera.1": "1234"}, "target": {}}
    assert read_run_plan(dump_plan(PLAN, PROBLEM, "digest", basis), "plan.json") == (PLAN, basis)
    assert read_run_plan(dump_plan(PLAN, PROBLEM, "digest"), "plan.json") == (PLAN, {})
