"""The solver's rounds: what is not grounded is forbidden, and when."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any
from unittest import mock

import pytest
from alone import search_alone
from fixed import kind, unit, world
from ortools.sat.python.cp_model import (
    FEASIBLE,
    INFEASIBLE,
    MODEL_INVALID,
    OPTIMAL,
    CpModel,
    CpSolver,
    LinearExprT,
)

import cfgplan
from cfgplan.domain import (
    ComputationUnit,
    Environment,
    InputPort,
    OutputPort,
    Similarity,
    Stream,
    Subscription,
    Target,
    Transformation,
)
from cfgplan.planners.cpsat import PlannerSession
from cfgplan.planners.exact import rounds, search
from cfgplan.planners.exact.candidates import Candidates
from cfgplan.planners.exact.model import Model
from cfgplan.planners.exact.solve_state import SolveState
from cfgplan.planners.exact.survival import Missed, Survival
from cfgplan.planners.solving.clock import Clock, ContradictionError
from cfgplan.planners.tuning import USUAL
from cfgplan.planning import Failures, PlannerFaultError, Problem, Status
from cfgplan.validity import plan_violations
from experiments.families.random_library import random_library
from experiments.fleet import instances


@pytest.mark.parametrize("seed", [0, 2, 6])
def test_a_solution_that_is_not_grounded_is_forbidden_before_anything_is_proven_of_it(seed: int) -> None:
    problem = random_library(seed, transformations=30, targets=3, back=0.4)
    solve, statuses = rounds.solve, []

    def watched(*of: Any) -> Any:
        statuses.append(solve(*of))
        return statuses[-1]

    with mock.patch.object(rounds, "solve", watched):
        alone = search_alone(problem)
        alone.run()
    assert statuses[0] == FEASIBLE
    assert statuses[-1] == OPTIMAL
    found, other = alone.state.plan(), PlannerSession().plan(problem)
    assert found.status is other.status is Status.OPTIMAL
    assert found.cost_us == other.cost_us


@pytest.mark.parametrize(
    ("room", "problem", "status"),
    [
        (rounds, random_library(0, transformations=60), INFEASIBLE),
        (rounds, random_library(0, transformations=60), MODEL_INVALID),
        (rounds, instances.weighted(0, 40, 2), INFEASIBLE),
        (rounds, replace(random_library(0, transformations=12, targets=1), survive=Failures.UNITS), INFEASIBLE),
    ],
    ids=["plain", "plain, invalid", "quality", "failures"],
)
def test_an_engine_that_denies_the_plan_in_hand_is_an_error_that_carries_it(
    room: ModuleType, problem: Problem, status: int
) -> None:
    def denies(engine: CpSolver, *_: object) -> int:
        engine.solve(CpModel())
        return status

    with mock.patch.object(room, "solve", denies), pytest.raises(PlannerFaultError) as raised:
        PlannerSession(USUAL.without_search()).plan(problem)
    assert (raised.value.plan.status, raised.value.plan.bound_us) == (Status.FEASIBLE, 0)
    assert plan_violations(problem, raised.value.plan) == []
    elsewhere = pickle.loads(pickle.dumps(raised.value))  # as a pool of processes does
    assert (str(elsewhere), elsewhere.plan) == (str(raised.value), raised.value.plan)


@pytest.mark.parametrize("problem", [instances.hosted(0, 30), instances.weighted(0, 30, 3)], ids=["hosts", "quality"])
def test_a_model_that_reckons_a_plan_too_cheap_is_an_error_that_carries_it(problem: Problem) -> None:
    def reckons(_: Model) -> LinearExprT:
        return 0

    with mock.patch.object(Model, "cost", reckons), pytest.raises(PlannerFaultError, match="than the model says"):
        PlannerSession().plan(problem)


def test_a_solution_that_is_no_plan_for_no_reason_is_an_error() -> None:
    alone = search_alone(random_library(0, transformations=12, targets=1))
    with mock.patch.object(search, "decode", lambda *_: None), pytest.raises(ContradictionError):
        alone.run()


def test_a_failure_that_is_not_survived_although_enough_is_demanded_is_an_error() -> None:
    problem = replace(random_library(0, transformations=12, targets=1), survive=Failures.UNITS)
    always = [Missed(frozenset({((problem.environment.library[0].label, None), 0)}))]
    alone = search_alone(problem)
    with mock.patch.object(Survival, "missed", lambda *_: always), pytest.raises(ContradictionError):
        alone.run()


def test_inputs_that_need_not_be_fed_close_no_ring_that_has_to_be_cut() -> None:
    loose = {"optional": True, "worth_us": 8}
    library = (
        kind("t0", "B", "CB"),
        kind("t1", "AB", "DC", 5, first=loose, upkeep_us=8),
        kind("t2", "A", "B", first={"optional": True}),
    )
    units = (
        unit("t1", "t1.2/x1", "t1.1/x1"),
        unit("t1", "t1.1/x1", "t2.3/x0", number=2),
        *(unit("t2", number=number) for number in (3, 4)),
    )
    targets = tuple(Target(f"q{n}", tag, f"/{n}") for n, tag in enumerate("CCB"))
    offers = {"A": frozenset("AC"), "B": frozenset("DB"), "C": frozenset("C")}
    problem = replace(world(targets, *library, units=units, horizon_s=10), similarity=Similarity(offers))
    found = PlannerSession().plan(problem)
    assert (found.status, found.counts["cuts"]) == (Status.OPTIMAL, 0)


def test_whether_a_unit_is_a_spare_costs_a_round_only_where_it_matters() -> None:
    world = cfgplan.load(Path(__file__).parents[2] / "models" / "building" / "alarms-4-any-may-fail.yaml")
    problem = cfgplan.match(world)
    running = problem.after(cfgplan.plan(problem)).units
    lost = next(u for u in running if u.transformation == "fire_alarm(room101)" and not u.standby)
    again = PlannerSession().plan(problem.with_parts(units=tuple(unit for unit in running if unit != lost)))
    assert again.status is Status.OPTIMAL
    assert again.counts["rounds"] < 9


def test_what_breaks_a_rule_never_becomes_the_incumbent() -> None:
    """Of a proven plan each unit, wire, topic, host or pin is taken in turn, and what is left is refused."""
    drawn = (instances.hosted(0, 30, 2, hosts=2), random_library(1, transformations=60, running=0.3))
    for problem in drawn:
        after = problem.after(PlannerSession().plan(problem))
        candidates, units = Candidates(problem), list(after.units)
        assert SolveState(problem, Clock(), None).offer(candidates, units) is not None
        broken = [[other for other in units if other is not one] for one in units]
        for number, one in enumerate(units):
            others = units[:number] + units[number + 1 :]
            broken += [[*others, replace(one, subscriptions=())]] * bool(one.subscriptions)
            broken += [[*others, replace(one, publications=())]] * bool(one.publications)
            broken += [[*others, replace(one, host="nowhere")]] * bool(problem.environment.hosts)
        for configuration in broken:
            state = SolveState(problem, Clock(), None)
            assert state.offer(candidates, configuration) is None
            assert (state.best, state.counts["refused configurations"]) == (None, 1)


@pytest.mark.parametrize("problem", [instances.hosted(0, 30), instances.weighted(0, 30, 3)], ids=["hosts", "quality"])
def test_a_search_that_fails_is_made_again_in_the_whole_library_and_the_log_says_so(
    problem: Problem, caplog: pytest.LogCaptureFixture
) -> None:
    proven = PlannerSession().plan(problem)
    rights = iter([lambda _: 0])  # the first model reckons every plan too cheap

    def cost(model: Model) -> LinearExprT:
        return next(rights, reckons)(model)

    reckons = Model.cost
    with mock.patch.object(Model, "cost", cost), caplog.at_level("WARNING", logger="cfgplan"):
        found = PlannerSession().plan(problem)
    assert (found.status, found.cost_us) == (Status.OPTIMAL, proven.cost_us)
    assert found.counts["failed searches"] == 1
    assert "more than the model says" in caplog.text
    assert plan_violations(problem, found) == []


@pytest.mark.parametrize("upkeep_us", [5, 10**9, 10**12])
def test_a_plan_that_costs_far_more_than_is_allowed_is_found_to_be_too_expensive(upkeep_us: int) -> None:
    """The engine called the model infeasible with the larger numbers, as long as it did no probing."""
    library = (
        Transformation("t0", outputs=(OutputPort("x", "A"),), required=True),
        Transformation("t1", (InputPort("a", "A"),), (OutputPort("x", "A"),), required=True),
        Transformation(
            "t2",
            (InputPort("a", "A", distinct="g"), InputPort("b", "D")),
            (OutputPort("x", "A"),),
            upkeep_us=1,
            required=True,
        ),
        Transformation("t3", outputs=(OutputPort("x", "D"),), upkeep_us=upkeep_us, required=True),
    )
    library = tuple(replace(one, labor_us=0) for one in library)
    fed = (Subscription("a", Stream("t2.1", "x")), Subscription("b", Stream("t3.2", "x")))
    units = (ComputationUnit("t2.1", "t2", fed), ComputationUnit("t3.2", "t3"), ComputationUnit("t3.3", "t3"))
    environment = Environment(units=units, library=library, targets=(Target("q0", "A", "/0"),))
    same = Similarity({tag: frozenset({tag}) for tag in "AD"})
    found = PlannerSession().plan(Problem(environment, same, horizon_s=1, max_cost_us=0))
    assert (found.status, found.cost_us) == (Status.TOO_EXPENSIVE, upkeep_us + 1)


def test_every_search_among_a_part_has_what_runs_in_every_plan() -> None:
    pinned, numbered, wanted = kind("p", pinned=True), kind("n", min_instances=1), kind("w")
    targets = (Target("A", "A", "/A"), Target("w", run="w"))
    problem = world(targets, kind("s", "", "A"), pinned, numbered, wanted, kind("o"), units=(unit("p"),))
    assert Candidates(problem).among(["s"]).kinds.keys() == {"s", "p", "n", "w"}
