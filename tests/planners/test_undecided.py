"""Problems in which it is not decided of some pairs of tags whether they match."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from fleets import KNOWN_TO_BOUNDS, fleets
from hypothesis import given
from kinds import of_open_pairs
from undecided import Truthful, differences, undecided
from worlds import examples, problems

from cfgplan.domain import (
    ALL,
    ComputationUnit,
    Environment,
    InputPort,
    OutputPort,
    Publication,
    Similarity,
    Stream,
    Subscription,
    Target,
    Transformation,
)
from cfgplan.planners import PLANNERS
from cfgplan.planners.cpsat import PlannerSession
from cfgplan.planners.undecided import Deciding
from cfgplan.planning import Plan, Problem, Status
from cfgplan.validity import plan_violations

many = examples(50)

DEAR = Transformation("dear", (), (OutputPort("o", "W"),), 100_000_000, 1_000_000)
CHEAP = Transformation("cheap", (), (OutputPort("o", "C"),), 1_000_000, 100_000)
TARGET = Target("t", "W", "/t")
OPEN = Similarity({"W": frozenset("W")}, {"W": frozenset("C")})
PROBLEM = Problem(Environment((), (DEAR, CHEAP), (TARGET,)), OPEN, 60)
NEVER = replace(PROBLEM, environment=Environment((), (CHEAP,), (TARGET,)))


@many
@given(undecided(problems(most=3)))
def test_what_is_asked_ends_in_the_truth_and_what_is_not_claims_nothing(case: tuple[Problem, Similarity]) -> None:
    assert differences(*case) == []


@examples(50, part=5)
@given(undecided(fleets(KNOWN_TO_BOUNDS, most=2)))
def test_so_it_is_with_hosts_quality_instances_and_spares(case: tuple[Problem, Similarity]) -> None:
    assert of_open_pairs(case) == []


@pytest.mark.parametrize("planner", PLANNERS)
def test_no_planner_claims_what_hangs_on_an_open_pair(planner: str) -> None:
    plan = PLANNERS[planner](PROBLEM)
    assert plan_violations(PROBLEM, plan) == []
    assert (plan.status, plan.cost_us, plan.undecided) == (Status.FEASIBLE, 160_000_000, (("C", "W"),))
    assert plan.bound_us == (0 if planner == "branch-and-bound" else 7_000_000)
    assert not plan.ties_proven


@pytest.mark.parametrize("planner", PLANNERS)
def test_no_planner_calls_a_target_out_of_reach_that_an_open_pair_may_meet(planner: str) -> None:
    plan = PLANNERS[planner](NEVER)
    assert plan_violations(NEVER, plan) == []
    assert (plan.status, plan.undecided) == (Status.UNKNOWN, (("C", "W"),))


@pytest.mark.parametrize("planner", PLANNERS)
def test_an_open_pair_that_is_never_used_is_never_asked(planner: str) -> None:
    similarity = Similarity({"W": frozenset("C")}, {"W": frozenset("W")})
    decider = Truthful(similarity, similarity)
    plan = Deciding(PLANNERS[planner], decider)(replace(PROBLEM, similarity=similarity))
    assert (plan.cost_us, plan.undecided, decider.asked) == (7_000_000, (), 0)
    assert plan.status is (Status.FEASIBLE if planner == "branch-and-bound" else Status.OPTIMAL)


@pytest.mark.parametrize(("truth", "cost_us"), [("CW", 7_000_000), ("W", 160_000_000)])
def test_what_matters_is_asked_once_and_then_the_answer_is_proven(truth: str, cost_us: int) -> None:
    decider = Truthful(OPEN, Similarity({"W": frozenset(truth)}))
    deciding = Deciding(PLANNERS["cpsat"], decider)
    plan = deciding(PROBLEM)
    assert (plan.status, plan.cost_us, plan.bound_us, plan.undecided) == (Status.OPTIMAL, cost_us, cost_us, ())
    assert (decider.asked, plan.counts["pairs asked"]) == (1, 1)
    assert plan_violations(deciding.known(PROBLEM), plan) == []


def test_who_does_not_ask_early_asks_only_where_there_is_no_plan_else() -> None:
    decider = Truthful(OPEN, Similarity({"W": frozenset("CW")}))
    deciding = Deciding(PLANNERS["cpsat"], decider)
    deciding.asks_early = False
    assert (deciding(PROBLEM).status, decider.asked) == (Status.FEASIBLE, 0)
    assert (deciding(NEVER).status, decider.asked) == (Status.OPTIMAL, 1)


@pytest.mark.parametrize("said", [{"optional": True}, {"count": ALL}], ids=str)
def test_an_input_that_no_plan_can_have_asks_for_no_pair(said: dict[str, Any]) -> None:
    inputs = (InputPort("gap", "Nothing"), InputPort("more", "X", **said))
    unusable = Transformation("unusable", inputs, (OutputPort("o", "U"),))
    similarity = Similarity({"W": frozenset("W")}, {"X": frozenset("W")})
    decider = Truthful(similarity, Similarity({"W": frozenset("W"), "X": frozenset()}))
    problem = replace(PROBLEM, similarity=similarity).with_parts(library=(DEAR, unusable))
    plan = Deciding(PLANNERS["cpsat"], decider)(problem)
    assert (plan.status, plan.cost_us, plan.undecided, decider.asked) == (Status.OPTIMAL, 160_000_000, (), 0)


def test_an_interrupted_question_leaves_the_best_plan_of_what_is_known() -> None:
    class Interrupted(Truthful):
        def decide(self, _pairs: object) -> int:
            raise KeyboardInterrupt

    plan = Deciding(PLANNERS["cpsat"], Interrupted(OPEN, OPEN))(PROBLEM)
    assert (plan.status, plan.cost_us, plan.bound_us) == (Status.FEASIBLE, 160_000_000, 7_000_000)


def test_dearer_offers_of_a_demand_are_asked_in_the_same_round() -> None:
    labels = [f"c{number:02}" for number in range(40)]
    library = tuple(Transformation(x, (), (OutputPort("o", x),), number) for number, x in enumerate(labels))
    similarity = Similarity({"W": frozenset()}, {"W": frozenset(labels)})
    decider = Truthful(similarity, Similarity({"W": frozenset({"c39"})}), most=1000)
    plan = Deciding(PLANNERS["cpsat"], decider)(Problem(Environment((), library, (TARGET,)), similarity, 0))
    assert (plan.status, plan.cost_us, decider.asked) == (Status.OPTIMAL, 39, 16 + 24)


def test_a_kept_subscription_counts_as_use() -> None:
    """The pair that feeds what runs is open: it can't be called well, nor needless to rewire."""
    reader = Transformation("reader", (InputPort("i", "W"),), (OutputPort("o", "R"),), 5)
    units = (
        ComputationUnit("cheap.1", "cheap"),
        ComputationUnit("reader.1", "reader", (Subscription("i", Stream("cheap.1", "o")),), (Publication("o", "/t"),)),
    )
    similarity = Similarity({**OPEN.offers, "R": frozenset("R")}, OPEN.open)
    environment = Environment(units, (DEAR, CHEAP, reader), (Target("t", "R", "/t"),))
    plan = PlannerSession().plan(Problem(environment, similarity, 60))
    assert plan.change_set is not None
    assert ([unit.id for unit in plan.change_set.rewired], plan.change_set.stopped) == (["reader.1"], ("cheap.1",))
    assert (plan.status, plan.bound_us, plan.undecided) == (Status.FEASIBLE, 6_000_000, (("C", "W"),))


def test_a_pinned_unit_that_an_open_pair_may_feed_is_let_go_but_that_is_not_called_optimal() -> None:
    pinned = Transformation("pinned", (InputPort("i", "X"),), (OutputPort("o", "P"),), pinned=True)
    similarity = Similarity({"W": frozenset("W"), "X": frozenset()}, {"X": frozenset("C")})
    environment = Environment((ComputationUnit("pinned.1", "pinned"),), (DEAR, CHEAP, pinned), (TARGET,))
    problem = Problem(environment, similarity, 60)
    plan = PLANNERS["cpsat"](problem)
    assert plan_violations(problem, plan) == []
    assert (plan.status, plan.cost_us, plan.bound_us) == (Status.FEASIBLE, 160_000_000, 160_000_000)
    assert plan.undecided == (("C", "X"),)
    (violation,) = plan_violations(problem, replace(plan, status=Status.OPTIMAL, undecided=()))
    assert violation.rule.name == "PINNED"


def test_the_judge_accepts_no_optimal_plan_that_hangs_on_an_open_pair() -> None:
    plan = replace(PLANNERS["cpsat"](replace(PROBLEM, similarity=OPEN.decided)), undecided=(("C", "W"),))
    assert [violation.rule.name for violation in plan_violations(PROBLEM, plan)] == ["BOUND"]


def test_the_judge_accepts_no_refusal_that_hangs_on_an_open_pair() -> None:
    refusal = Plan("cpsat", Status.INFEASIBLE, reasons={"t": "no output matches"})
    assert [violation.rule.name for violation in plan_violations(NEVER, refusal)] == ["MET", "MET"]
