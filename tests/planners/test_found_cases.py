"""The smallest files in which a planner once answered wrongly, late or not at all, each with its right answer."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from cfgplan import api
from cfgplan.domain import (
    ComputationUnit,
    Environment,
    Host,
    InputPort,
    OutputPort,
    Similarity,
    Stream,
    Subscription,
    Target,
    Transformation,
)
from cfgplan.planners import PLANNERS
from cfgplan.planning import Failures, Problem, Status
from cfgplan.validity import plan_violations

CASES = Path(__file__).parents[3] / "shared" / "cases" / "3" / "planner"
ANSWERS = {
    "1": (Status.INFEASIBLE, None),
    "1-pinned-variant": (Status.OPTIMAL, 100_005_000_000),
    "2": (Status.INFEASIBLE, None),
    "3": (Status.OPTIMAL, 3_000_000),
    "3b": (Status.OPTIMAL, 3_000_000),
    "bnb-110236": (Status.TOO_EXPENSIVE, 120_000_000),
    "false-700049": (Status.OPTIMAL, 5_666_665),
    "false-infeasible-600088": (Status.OPTIMAL, 99_999_100_000),
    "slow-10279": (Status.OPTIMAL, 1_000_000),
    "slow-30011": (Status.INFEASIBLE, None),
    "timeout-75192": (Status.OPTIMAL, 0),
    "zero": (Status.OPTIMAL, 0),
}


def case(name: str) -> api.World:
    path = CASES / f"{name}.yaml"
    if not path.is_file():
        pytest.skip(f"{path.name} is not there: the cases of wrong answers are no part of the project")
    return api.load(path)


@pytest.mark.parametrize("name", ANSWERS)
def test_a_case_that_was_answered_wrongly_has_its_right_answer_now(name: str) -> None:
    world = case(name)
    problem = api.match(world)
    found = api.plan(problem)
    assert plan_violations(problem, found) == []
    assert (found.status, found.cost_us) == ANSWERS[name]


UNFEDABLE = """
format: cfgplan/1
qualities: [{name: e, better: lower, rule: add, worst: 9}]
hosts: [{name: h, labels: [a]}]
transformations:
  - {label: t0, on: not a, outputs: {x: {tag: D, quality: {e: 0}, serves: 1}}}
  - {label: t1, inputs: {a: D}, outputs: {x: A, y: {tag: A, quality: {e: 0}}}}
targets: [{label: q, topic: /q, tag: A, quality: {e: {weight: 0.2}}}]
"""


def test_an_output_that_no_quality_can_come_to_is_no_error(tmp_path: Path) -> None:
    path = tmp_path / "env.yaml"
    path.write_text(UNFEDABLE, encoding="utf-8")
    assert api.plan(api.match(api.load(path))).status is Status.INFEASIBLE


NEW_PINNED = """
format: cfgplan/1
horizon: 0
qualities: [{name: e, better: lower, rule: add, worst: 9}]
transformations:
  - {label: t0, pinned: true, labor: 0, outputs: {x: {tag: B, quality: {e: 0}}}}
  - {label: t1, labor: 0, inputs: {a: {tag: B, optional: true}}, outputs: {x: A}}
  - {label: t2, labor: 0, outputs: {x: {tag: A, quality: {e: 0.000001}}}}
targets: [{label: q, topic: /q, tag: A, quality: {e: {weight: 0.2}}}]
"""


def test_a_new_unit_of_a_pinned_transformation_has_to_be_needed(tmp_path: Path) -> None:
    path = tmp_path / "env.yaml"
    path.write_text(NEW_PINNED, encoding="utf-8")
    agree(api.match(api.load(path)))


def test_units_in_a_ring_of_inputs_that_lack_a_stream_are_no_error() -> None:
    feeds = [(Subscription("b", Stream(f"t.{other}", "x")),) for other in (2, 1)]
    cycle = [ComputationUnit(f"t.{number}", "t", fed, host="h") for number, fed in enumerate(feeds, 1)]
    inputs = InputPort("a", "A", optional=True), InputPort("b", "A", optional=True, count=2)
    library = (
        Transformation("t", inputs, (OutputPort("x", "A"),), labor_us=0),
        Transformation("u", (InputPort("a", "A"), InputPort("c", "A", count=2)), (OutputPort("x", "A"),), labor_us=0),
    )
    targets = Target("p", "A", "/p"), Target("q", "A", "/q")
    environment = Environment(tuple(cycle), library, targets, (Host("h", cpu_us=9),))
    agree(Problem(environment, Similarity({"A": frozenset({"A"})}), 0))


def agree(problem: Problem) -> None:
    """Planner and oracle have answers of one cost that the judge accepts."""
    found, oracle = api.plan(problem), api.plan(problem, planner="exhaustive")
    assert plan_violations(problem, found) == plan_violations(problem, oracle) == []
    assert (found.status, found.cost_us) == (oracle.status, oracle.cost_us)


@pytest.mark.parametrize(
    "inputs",
    ["{a: {tag: A, optional: true}, b: {tag: A, optional: true}}", "{a: {tag: A, count: all, optional: true}}"],
)
@pytest.mark.parametrize("of", ["mean", "sum", "best", "worst"])
def test_a_unit_whose_optional_inputs_only_it_could_feed_runs_without_them(
    of: str, inputs: str, tmp_path: Path
) -> None:
    path = tmp_path / "env.yaml"
    text = """
format: cfgplan/1
qualities: [{name: e, better: lower, rule: add, worst: 9}]
transformations: [{label: t0, inputs: INPUTS, outputs: {x: {tag: A, quality: {e: {add: 0, of: OF}}}}}]
targets: [{label: q0, tag: A, topic: /0, quality: {e: {weight: 0.2}}}]
"""
    path.write_text(text.replace("INPUTS", inputs).replace("OF", of), encoding="utf-8")
    found = api.plan(api.match(api.load(path)))
    assert (found.status, found.cost_us) == (Status.OPTIMAL, 1_000_000)


def test_branch_and_bound_claims_nothing_where_required_ones_are_left_out() -> None:
    world = case("bnb-110236")
    problem = api.match(world)
    assert api.plan(problem, planner="branch-and-bound").status is Status.UNKNOWN


GREEDY = """
from cfgplan.domain import ComputationUnit
from cfgplan.planning import Plan, Status

def plan(problem, *, time_limit_s=None, report=None):
    return Plan("greedy", Status.FEASIBLE, problem.environment.change_to(list(problem.environment.units)), 0)
"""


def test_a_planner_of_ones_own_may_call_a_plan_of_cost_0_feasible(tmp_path: Path) -> None:
    case("zero")
    (tmp_path / "greedy.py").write_text(GREEDY, encoding="utf-8")
    code = "import sys; from cfgplan.cli import main; sys.exit(main())"
    command = [sys.executable, "-c", code, "solve", str(CASES / "zero.yaml"), "--planner", "greedy:plan"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, check=False)
    assert done.returncode == 20, done.stderr
    assert "has not proven it optimal" in done.stdout


def test_a_running_spare_of_a_transformation_that_has_none_refutes_no_bound() -> None:
    """No plan may keep it, so that a plan may cost more than what runs."""
    a = Transformation("a", (), (OutputPort("x", "X"),), labor_us=1, upkeep_us=2)
    units = (ComputationUnit("a.1", "a", standby=True), ComputationUnit("a.2", "a"))
    environment = Environment(units, (a,), (Target("an a", run="a"),))
    problem = Problem(environment, Similarity({}), horizon_s=1, survive=Failures.UNITS)
    for planner in ("cpsat", "exhaustive"):
        plan = PLANNERS[planner](problem)
        assert plan.change_set is not None
        assert plan.change_set.stopped == ("a.1",)
        assert plan_violations(problem, plan) == []
