"""A warm session answers as well as a cold planner, whatever changes in between."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path
from threading import Event
from unittest.mock import patch

import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_against_the_oracle import quality
from worlds import changed, examples, problems

from cfgplan import api
from cfgplan.domain import (
    ChangeSet,
    ComputationUnit,
    Environment,
    Host,
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
from cfgplan.planners.cpsat import PlannerSession, plan
from cfgplan.planners.exact.first_plans import FirstPlans
from cfgplan.planners.exact.memory import Structure
from cfgplan.planners.exact.solve_run import SolveRun
from cfgplan.planners.tuning import Decide, Replan, Tuning
from cfgplan.planning import Problem, Progress, Status
from cfgplan.validity import plan_violations
from experiments.families.random_library import random_library
from experiments.fleet import instances


@pytest.mark.parametrize("planner", ["cpsat", "exhaustive"])
def test_a_unit_that_costs_nothing_is_stopped_rather_than_rewired(planner: str) -> None:
    """What runs is the first plan and costs as little as any, but one of its units can be done without."""
    library = (
        Transformation("t0", (), (OutputPort("x", "A"), OutputPort("y", "B")), labor_us=1),
        Transformation(
            "t1", (InputPort("a", "A"), InputPort("b", "B", feedback=True)), (OutputPort("x", "A"),), labor_us=1
        ),
    )
    feeds = (Subscription("a", Stream("t1.1", "x")), Subscription("b", Stream("t0.2", "y")))
    units = (
        ComputationUnit("t0.2", "t0", (), (Publication("x", "/stale"),)),
        ComputationUnit("t1.1", "t1", feeds, (Publication("x", "/0"),)),
    )
    similarity = Similarity({tag: frozenset({tag}) for tag in "AB"})
    problem = Problem(Environment(units, library, (Target("q0", "A", "/0"),)), similarity, 0)
    found = PLANNERS[planner](problem)
    assert found.change_set is not None
    assert ([u.id for u in found.change_set.rewired], found.change_set.stopped) == (["t0.2"], ("t1.1",))
    assert (found.status, found.ties_proven) == (Status.OPTIMAL, True)


def test_a_unit_that_became_free_to_start_is_replaced_rather_than_rewired() -> None:
    def library(labor_us: int) -> tuple[Transformation, ...]:
        return (
            Transformation("source", (), (OutputPort("x", "A"),), 0, 8),
            Transformation("filter", (InputPort("a", "A"),), (OutputPort("x", "B"),), labor_us, 1),
        )

    filtering = ComputationUnit(
        "filter.1", "filter", (Subscription("a", Stream("source.1", "x")),), (Publication("x", "/t"),)
    )
    environment = Environment((ComputationUnit("source.1", "source"), filtering), library(1), (Target("t", "B", "/t"),))
    problem = Problem(environment, Similarity({tag: frozenset(tag) for tag in "AB"}), 1)
    session = PlannerSession()
    assert not session.plan(problem).change_set
    broken = replace(problem, environment=replace(environment, units=(filtering,), library=library(0)))
    assert quality(session.plan(broken)) == quality(plan(broken)) == quality(PLANNERS["exhaustive"](broken))


@examples(400, part=4)
@given(st.data())
def test_a_warm_session_is_as_good_as_a_cold_planner_through_any_changes(data: st.DataObject) -> None:
    session = PlannerSession()
    problem = data.draw(problems(most=7, special=data.draw(st.booleans())))
    for _ in range(data.draw(st.integers(1, 6))):
        warm = session.plan(problem)
        assert plan_violations(problem, warm) == []
        assert quality(warm) == quality(plan(problem))
        if warm.change_set is not None and data.draw(st.booleans()):
            problem = replace(problem, environment=problem.environment.update(warm.change_set))
        problem = data.draw(changed(problem))


@examples(400, part=4)
@given(st.data())
def test_after_rest_failures_and_moved_costs_are_answered_as_well_as_a_cold_planner_does(data: st.DataObject) -> None:
    session = PlannerSession()
    drawn = data.draw(problems(most=8, special=data.draw(st.booleans())))
    none_required = tuple(replace(t, required=False) for t in drawn.environment.library)
    problem = replace(drawn, environment=replace(drawn.environment, library=none_required), max_cost_us=None)
    first = session.plan(problem)
    if first.change_set is None:
        return
    running = replace(problem, environment=problem.environment.update(first.change_set))
    session.plan(running)
    for _ in range(4):
        dead = data.draw(st.sets(st.sampled_from([unit.id for unit in running.environment.units] or [""])))
        broken = replace(running, environment=running.environment.update(ChangeSet(stopped=tuple(dead - {""}))))
        library = list(broken.environment.library)
        for i in data.draw(st.sets(st.integers(0, len(library) - 1), max_size=data.draw(st.sampled_from([1, 8])))):
            labor_us = max(0, library[i].labor_us + data.draw(st.integers(-2, 2)))
            upkeep_us = max(0, library[i].upkeep_us + data.draw(st.integers(-3, 3)))
            library[i] = replace(library[i], labor_us=labor_us, upkeep_us=upkeep_us)
        broken = replace(broken, environment=replace(broken.environment, library=tuple(library)))
        warm = session.plan(broken)
        assert plan_violations(broken, warm) == []
        assert quality(warm) == quality(plan(broken))
        if data.draw(st.booleans()):
            assert warm.change_set is not None
            running = replace(broken, environment=broken.environment.update(warm.change_set))
            session.plan(running)


@examples(60, part=4)
@given(
    st.integers(0, 10**6),
    st.integers(20, 80),
    st.integers(1, 8),
    st.sampled_from([1, 3, 10, 30, 1500]),
    st.sampled_from([0, 100]),
)
def test_a_replan_in_a_library_that_is_not_small_is_as_good_as_a_cold_plan(
    seed: int, size: int, targets: int, steps: int, many: int
) -> None:
    problem, draw = random_library(seed, transformations=size, targets=targets), random.Random(seed)
    session = PlannerSession(Tuning(decide=Decide(steps=steps), replan=Replan(many=many)))
    first = session.plan(problem)
    assert first.change_set is not None
    running = problem.environment.update(first.change_set)
    session.plan(replace(problem, environment=running))
    for _ in range(3):
        broken = running.without_unit(draw.choice(running.units).id)
        moves_us = {t.label: draw.choice((0, 0, 0, 0, 0, 0, -2000, 2000)) for t in broken.library}
        library = [replace(t, upkeep_us=max(0, t.upkeep_us + moves_us[t.label])) for t in broken.library]
        moved = replace(problem, environment=replace(broken, library=tuple(library)))
        warm = session.plan(moved)
        assert plan_violations(moved, warm) == []
        assert quality(warm) == quality(plan(moved))


def test_landmarks_that_a_linear_program_charges_leave_a_replan_nothing_to_search() -> None:
    problem = random_library(11, transformations=150, targets=8)
    for many, is_searched in ((0, False), (10**6, True)):
        session = PlannerSession(Tuning(replan=Replan(many=many)))
        first = session.plan(problem)
        assert first.change_set is not None
        running = problem.environment.update(first.change_set)
        session.plan(replace(problem, environment=running))
        failed = [replace(problem, environment=running.without_unit(unit.id)) for unit in running.units]
        assert any(session.plan(one).counts.get("nodes") for one in failed) == is_searched


def hard_problem(demands: int = 150) -> Problem:
    """A covering problem whose proof takes minutes: many overlapping choices at nearly the same cost."""
    draw = random.Random(7)
    tags = [f"T{i}" for i in range(demands)]
    library = [
        Transformation(
            f"t{i}",
            (),
            tuple(OutputPort(f"o{tag}", tag) for tag in draw.sample(tags, 6)),
            labor_us=draw.randint(1000, 1100),
        )
        for i in range(3 * demands)
    ]
    join = Transformation("join", tuple(InputPort(tag, tag) for tag in tags), (OutputPort("out", "Z"),))
    similarity = Similarity({tag: frozenset({tag}) for tag in [*tags, "Z"]})
    return Problem(Environment((), (*library, join), (Target("q", "Z", "/q"),)), similarity, 1)


def test_a_stop_event_ends_with_the_best_plan_so_far_and_an_honest_bound() -> None:
    problem, stop = hard_problem(), Event()
    stop.set()
    found = plan(problem, stop=stop)
    assert found.status is Status.FEASIBLE
    assert found.gap is not None
    assert found.gap > 0
    assert plan_violations(problem, found) == []


@pytest.mark.skipif(os.name != "posix", reason="sends itself an interrupt as Ctrl-C does")
def test_ctrl_c_during_the_solving_ends_with_the_best_plan_so_far() -> None:
    """In a process of its own, since the signal is one for the whole process."""
    code = "import test_session; test_session.interrupted_while_it_solves()"
    done = subprocess.run([sys.executable, "-c", code], cwd=Path(__file__).parent, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def interrupted_while_it_solves() -> None:
    problem, stop = hard_problem(), Event()
    bounds: list[int] = []

    def interrupt(progress: Progress) -> None:
        bounds.append(progress.bound_us)
        if threading.current_thread() is not threading.main_thread() and bounds.count(-1) == 0:
            bounds.append(-1)
            os.kill(os.getpid(), signal.SIGINT)

    found = plan(problem, time_limit_s=60, report=interrupt, stop=stop)
    assert -1 in bounds
    assert stop.is_set(), "the caller learns of it"
    assert found.status is Status.FEASIBLE
    assert plan_violations(problem, found) == []


def test_the_bound_rises_and_the_cost_falls_while_it_works() -> None:
    seen: list[Progress] = []
    enough = Event()

    def look(progress: Progress) -> None:
        seen.append(progress)
        if progress.cost_us is not None and len({earlier.bound_us for earlier in seen}) > 2:
            enough.set()

    problem = random_library(2, transformations=300, targets=3, arity=3, back=0.4)
    plan(problem, time_limit_s=60, report=look, stop=enough)
    bounds = [progress.bound_us for progress in seen]
    costs = [progress.cost_us for progress in seen if progress.cost_us is not None]
    assert bounds == sorted(bounds)
    assert costs == sorted(costs, reverse=True)
    assert len(set(bounds)) > 1
    assert bounds[-1] < costs[-1]


def test_a_session_plans_again_after_each_failure_without_a_change_where_none_is_needed() -> None:
    library = [Transformation(f"s{i}", (), (OutputPort("o", "A"),), labor_us=5 + i) for i in range(3)]
    library.append(Transformation("f", (InputPort("i", "A"),), (OutputPort("o", "B"),), labor_us=2))
    environment = Environment((), tuple(library), (Target("q", "B", "/q"),))
    problem = Problem(environment, Similarity({"A": frozenset("A"), "B": frozenset("B")}), 1)
    session = PlannerSession()
    first = session.plan(problem)
    assert first.change_set is not None
    running = replace(problem, environment=environment.update(first.change_set))
    assert not session.plan(running).change_set
    failed = replace(running, environment=running.environment.update(ChangeSet(stopped=("s0.1",))))
    again = session.plan(failed)
    assert again.change_set is not None
    assert [unit.id for unit in again.change_set.started] == ["s0.2"]
    assert [unit.id for unit in again.change_set.rewired] == ["f.1"]


def test_the_last_plan_is_wired_as_it_was_after_each_failure_and_neither_grounded_nor_given_to_the_solver() -> None:
    problem = random_library(3, transformations=60, targets=4)
    session = PlannerSession()
    first = session.plan(problem)
    assert first.change_set is not None
    running = replace(problem, environment=problem.environment.update(first.change_set))
    assert not session.plan(running).change_set
    with (
        patch("cfgplan.planners.exact.solve_run.wire", side_effect=AssertionError),
        patch.object(SolveRun, "search", side_effect=AssertionError),
    ):
        for unit in running.environment.units:
            failed = replace(running, environment=running.environment.without_unit(unit.id))
            again = session.plan(failed)
            assert (again.status, again.ties_proven) == (Status.OPTIMAL, True)
            assert not plan_violations(failed, again)
            assert again.change_set is not None
            assert [started.transformation for started in again.change_set.started] == [unit.transformation]
            readers = {other.id for other in running.environment.units if unit.id in _feeders(other)}
            assert {rewired.id for rewired in again.change_set.rewired} == readers


def _feeders(unit: ComputationUnit) -> set[str]:
    return {subscription.stream.unit for subscription in unit.subscriptions}


@pytest.mark.parametrize(
    "problem",
    [instances.hosted(1, 25, 2), instances.weighted(0, 30, 3), instances.surviving(0, 12, 1)],
    ids=["hosts", "quality", "failures"],
)
def test_a_session_plans_a_fleet_again_after_each_failure_from_its_last_plan(problem: Problem) -> None:
    session = PlannerSession()
    found = session.plan(problem).change_set
    assert found is not None
    running = problem.environment.update(found)
    for dead in [unit.id for unit in running.units[:4]]:
        broken = replace(problem, environment=running.update(ChangeSet(stopped=(dead,))))
        with patch.object(FirstPlans, "look", autospec=True, side_effect=FirstPlans.look) as look:
            warm = session.plan(broken)
        assert plan_violations(broken, warm) == []
        assert quality(warm) == quality(plan(broken))
        assert look.call_args_list[0].args[1] == 0


def test_a_session_plans_a_fleet_again_when_transformations_of_its_last_plan_have_left() -> None:
    session, whole = PlannerSession(), fleet_model("1-start")
    first = session.plan(whole)
    assert first.change_set is not None
    left = tuple(t for t in whole.environment.library if not t.label.startswith("camera(r2)"))
    again = session.plan(replace(whole, environment=replace(whole.environment, library=left)))
    assert again.status is Status.OPTIMAL
    assert not plan_violations(replace(whole, environment=replace(whole.environment, library=left)), again)


def test_a_session_notices_that_a_unit_is_asked_for_that_no_target_needs() -> None:
    source, idle = (Transformation(label, (), (OutputPort("o", tag),), labor_us=1) for label, tag in ("sA", "tB"))
    environment = Environment((), (source, idle), (Target("q", "A", "/q"),))
    problem = Problem(environment, Similarity({"A": frozenset("A")}), 1)
    session = PlannerSession()
    assert session.plan(problem).cost_us == 1
    asking = replace(environment, library=(source, replace(idle, min_instances=1)))
    assert session.plan(replace(problem, environment=asking)).cost_us == 2


def test_a_session_notices_that_a_transformation_runs_beside_one_that_no_target_needs() -> None:
    source, idle = (Transformation(label, (), (OutputPort("o", tag),), labor_us=1) for label, tag in ("sA", "tB"))
    environment = Environment((), (source, idle), (Target("q", "A", "/q"),), (Host("h"),))
    problem = Problem(environment, Similarity({"A": frozenset("A")}), 1)
    session = PlannerSession()
    assert session.plan(problem).cost_us == 1
    asking = replace(environment, library=(replace(source, beside=("t",)), idle))
    assert session.plan(replace(problem, environment=asking)).cost_us == 2


def fleet_model(stage: str) -> Problem:
    asked = api.load(Path(__file__).parents[2] / "models" / "fleet" / f"{stage}.yaml")
    return api.problem(asked, api.match(asked).similarity)


def test_what_is_known_without_open_pairs_and_with_all_of_them_stays_known() -> None:
    library = tuple(
        Transformation(label, (), (OutputPort("x", tag),), labor_us=labor_us)
        for label, tag, labor_us in (("dear", "A", 9), ("cheap", "B", 1))
    )
    similarity = Similarity({"A": frozenset("A")}, {"A": frozenset("B")})
    problem = Problem(Environment((), library, (Target("q0", "A", "/0"),)), similarity, 1)
    session = PlannerSession()
    first = session.plan(problem)
    assert (first.status, first.cost_us, first.bound_us) == (Status.FEASIBLE, 9, 1)
    with patch.object(Structure, "of", wraps=Structure.of) as made:
        assert session.plan(problem) == first
        assert made.call_count == 0
        decided = session.plan(replace(problem, similarity=Similarity({"A": frozenset("AB")})))
        assert (decided.status, decided.cost_us) == (Status.OPTIMAL, 1)
