"""Which perturbation leads to which review, with units that run only in thought."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from cfgplan_runtime import Policy, SimulatedRuntime
from cfgplan_runtime.lifecycle.changes import (
    Add,
    FaultyCode,
    KillUnit,
    LoseHost,
    RegainHost,
    Remove,
    ReplaceWorld,
    ReviewNow,
)
from cfgplan_runtime.lifecycle.kinds import review_sentence
from cfgplan_runtime.lifecycle.perturbations import (
    HorizonReached,
    SubscriptionLost,
    UnitGone,
    UnitKeepsFailing,
    WorldChanged,
)
from cfgplan_runtime.lifecycle.reports import PHASES, Decision
from cfgplan_runtime.lifecycle.views import target_views
from cfgplan_runtime.operating.records import review_record
from cfgplan_runtime.supervision.simulated_backend import Behaviour
from simulated_life import HORIZON_S, RESULT, Life, source, started, worker

from cfgplan import api
from cfgplan.domain import (
    ALL,
    ChangeSet,
    ComputationUnit,
    Environment,
    InputPort,
    OutputPort,
    RunOptions,
    Target,
    Transformation,
)
from cfgplan.planners import PLANNERS
from cfgplan.planning import Plan, Problem, Status

CHEAP = worker("cheap", labor_us=10, upkeep_us=1)
DEAR = worker("dear", upkeep_us=500)
MODELS = Path(__file__).parents[2] / "models"
WITH_UNIT_CODE = [path for path in sorted(MODELS.glob("*/[0-9]-*.yaml")) if "expected" not in path.name]
IMPOSSIBLE = Target("impossible", "Z", "/impossible", priority=9)


@pytest.mark.parametrize("path", WITH_UNIT_CODE, ids=lambda path: f"{path.parent.name}/{path.stem}")
def test_a_run_meets_what_a_plan_from_nothing_meets(path: Path) -> None:
    loaded = api.load(path)
    world = replace(loaded, environment=replace(loaded.environment, units=()))
    plan = api.plan(api.match(world))
    life = Life(world=world)
    life.settle()
    assert life.met == world.environment.target.keys() - plan.reasons.keys()
    number = len(plan.change_set.started) if plan.change_set else 0
    assert len(life.runtime.environment.units) == number
    assert bool(number) == bool(life.met)


def test_the_first_review_starts_what_meets_the_targets() -> None:
    life = started()
    (review,) = life.reviews
    assert (review.decision, review.met, review.is_proven) == (Decision.APPLIED, ("result",), True)
    assert review.cost_us == 1000 + 1000 + 100 * HORIZON_S
    assert life.units == {"count.1", "work.1"}


def test_a_review_says_how_long_each_phase_took() -> None:
    life = started()
    assert set(life.reviews[0].seconds) == set(PHASES)
    assert life.reviews[0].seconds["detect"] >= 0


LOGGER = Transformation("logger", (InputPort("x", "N", count=ALL),), labor_us=1000, source="units.py:logger")
LOGGED = Target("logged", run="logger")


def test_a_unit_that_a_target_wants_to_run_is_kept_running_and_takes_what_comes_and_goes() -> None:
    more = Transformation("more", outputs=(OutputPort("m", "M"), OutputPort("n", "N")), source="units.py:more")
    life = started(source(pinned=True), LOGGER, targets=(LOGGED,))
    assert life.units == {"count.1", "logger.1"}
    (view,) = life.manager.snapshot().targets
    assert (view.is_met, view.unit, view.stream) == (True, "logger.1", None)
    life.fail("logger.1")
    assert (life.met, life.starts("logger")) == ({"logged"}, 2)
    (logger,) = (unit for unit in life.runtime.environment.units if unit.transformation == "logger")
    life.reviewed(Add(targets=(Target("other", "M", "/other"),), transformations=(more,)))
    streams = [str(stream) for stream in life.runtime.environment.unit[logger.id].feeds["x"]]
    assert streams == ["count.1/n", "more.1/n"]
    life.reviewed(Remove(targets=("other",)))
    assert len(life.runtime.environment.unit[logger.id].feeds["x"]) == 1
    assert life.starts("logger") == 2
    assert life.reviewed(Remove(targets=("logged",))).decision is Decision.APPLIED
    assert life.units == {"count.1"}


def test_a_unit_that_a_target_wants_to_run_does_not_meet_it_without_its_inputs() -> None:
    running = Environment((ComputationUnit("logger.1", "logger"),), (source(), LOGGER), (LOGGED,))
    (view,) = target_views(running, running, (), (), 0.0)
    assert (view.is_met, view.unit, view.reason) == (False, None, "it waits for a review")


@pytest.mark.parametrize("unit", ["count.1", "work.1"])
def test_a_dead_unit_is_replaced(unit: str) -> None:
    life = started()
    life.fail(unit)
    assert life.met == {"result"}
    assert [gone.unit for gone in life.perturbations(UnitGone)] == [unit]
    assert life.reviews[-1].decision is Decision.APPLIED


def test_several_deaths_at_once_make_one_review() -> None:
    life = started()
    life.fail("count.1", "work.1")
    assert len(life.reviews) == 2
    assert {p.unit for p in life.reviews[-1].perturbations if isinstance(p, UnitGone)} == {"count.1", "work.1"}
    assert life.met == {"result"}


def test_a_hung_unit_is_a_perturbation_of_its_own_kind() -> None:
    life = started(source(), worker(run=RunOptions(hang_us=3_000_000)), behaviours={"work": Behaviour(hung=True)})
    life.runtime.backend.behaviours.clear()
    life.pass_time(5)
    assert [gone.how for gone in life.perturbations(UnitGone)] == ["hung"]
    assert life.met == {"result"}


def test_a_unit_that_keeps_failing_is_given_up() -> None:
    life = started(source(), worker(), DEAR, behaviours={"work": Behaviour(failing=True)})
    life.pass_time(20)
    assert life.perturbations(UnitKeepsFailing)[0].transformation == "work"
    assert (life.met, life.units) == ({"result"}, {"count.1", "dear.1"})


def test_a_lost_subscription_is_made_anew() -> None:
    life = started()
    life.runtime.cut("work.1", "x")
    life.pass_time(0.1)
    assert life.perturbations(SubscriptionLost) == [SubscriptionLost("work.1", "x")]
    assert life.runtime.environment.unit["work.1"].feeds["x"][0].unit == "count.1"
    life.runtime.cut(None, "/result")
    life.pass_time(0.1)
    assert life.met == {"result"}


def test_a_cheaper_transformation_is_used_at_the_horizon_and_not_before() -> None:
    life = started()
    review = life.reviewed(Add(transformations=(CHEAP,)))
    assert review.decision is Decision.DEFERRED
    assert life.manager.snapshot().saving_us == 99 * HORIZON_S - 10
    life.pass_time(HORIZON_S - 1)
    assert life.units == {"count.1", "work.1"}
    life.pass_time(1.5)
    assert life.units == {"count.1", "cheap.1"}
    assert life.perturbations(HorizonReached) == [HorizonReached(HORIZON_S)]
    assert life.reviews[-1].cost_us < life.reviews[-1].cost_before_us  # type: ignore[operator]


def test_a_requested_review_does_not_wait_for_the_horizon() -> None:
    life = started()
    life.ask(Add(transformations=(CHEAP,)))
    assert life.reviewed(ReviewNow()).decision is Decision.APPLIED
    assert "cheap.1" in life.units


def test_a_repair_uses_what_is_cheapest_by_then() -> None:
    life = started()
    life.ask(Add(transformations=(CHEAP,)))
    life.fail("work.1")
    assert life.units == {"count.1", "cheap.1"}


def test_a_new_horizon_begins_with_each_update() -> None:
    life = started()
    life.pass_time(HORIZON_S / 2)
    life.fail("work.1")
    assert life.manager.snapshot().horizon_left_s == pytest.approx(HORIZON_S, abs=1)


def test_a_shorter_horizon_in_the_file_counts_at_once() -> None:
    life = started()
    life.pass_time(10)
    environment = life.manager.world.environment
    life.ask(ReplaceWorld(api.world(environment, horizon_s=20), "file"))
    assert life.manager.snapshot().horizon_left_s == pytest.approx(10, abs=1)


def test_without_a_horizon_nothing_is_reviewed_for_its_sake() -> None:
    life = started(horizon_s=0)
    life.pass_time(1000)
    assert len(life.reviews) == 1


def test_an_impossible_target_leaves_the_others_alone() -> None:
    life = started()
    calls = list(life.runtime.backend.calls)
    review = life.reviewed(Add(targets=(IMPOSSIBLE,)))
    assert review.unmet == {"impossible": "target impossible wants Z, but no output matches"}
    assert life.met == {"result"}
    assert [call for call in life.runtime.backend.calls[len(calls) :] if call[0] != "open"] == []


def test_a_review_tells_once_why_several_targets_are_not_met() -> None:
    """Faulty code that several targets need was told for each of them, and also where it does no harm."""
    life = started(source(), worker(), worker("other", gives="W"), targets=(IMPOSSIBLE,))
    why = "units.py:1:8: it imports night, which is not there"
    life.reviewed(FaultyCode({"work": why, "other": why}))
    others = Target("also", "W", "/also"), Target("more", "Y", "/more")
    told = review_sentence(life.reviewed(Add(targets=(RESULT, *others))))
    assert told.count(why) == 1
    assert (
        "; not met: target also wants W, targets more, result want Y, "
        f"but need transformations that are left out for now: other, work ({why}); " in told
    )
    assert "; not met: target impossible wants Z, but no output matches; " in told


def test_a_target_is_met_as_soon_as_it_can_be() -> None:
    life = started(targets=(RESULT, IMPOSSIBLE))
    assert life.reviewed(Add(transformations=(worker("late", gives="Z"),))).decision is Decision.APPLIED
    assert life.met == {"result", "impossible"}


def test_what_only_a_removed_target_needed_is_stopped() -> None:
    other = Target("other", "N", "/other")
    life = started(targets=(RESULT, other))
    life.ask(Remove(targets=("result",)))
    assert life.units == {"count.1"}
    assert life.runtime.backend.topics.keys() == {"/other"}


def test_a_removed_transformation_is_replaced_where_it_was_used() -> None:
    life = started(source(), worker(), DEAR)
    life.ask(Remove(transformations=("work",)))
    assert life.units == {"count.1", "dear.1"}


def test_where_nothing_can_replace_it_the_target_waits_with_a_reason() -> None:
    life = started()
    review = life.reviewed(Remove(transformations=("work",)))
    assert (life.units, life.met) == (set(), set())
    (view,) = life.manager.snapshot().targets
    assert view.reason == review.unmet["result"] == "target result wants Y, but no output matches"


def test_units_of_a_transformation_with_other_params_are_replaced() -> None:
    life = started()
    review = life.reviewed(Add(transformations=(worker(params={"threshold": 3}),)))
    assert isinstance(review.perturbations[0], WorldChanged)
    assert review.perturbations[0].difference.replaced_transformations == ("work",)
    assert life.units == {"count.1", "work.2"}
    assert life.runtime.backend.units["work.2"].transformation.params == {"threshold": 3}


def test_units_go_on_where_only_costs_and_flags_change() -> None:
    life = started()
    review = life.reviewed(Add(transformations=(worker(upkeep_us=5, pinned=True),)))
    assert review.decision is Decision.KEPT
    assert life.units == {"count.1", "work.1"}


def test_a_new_version_that_cannot_start_leaves_the_old_one_running() -> None:
    life = started()
    life.runtime.backend.behaviours["work"] = Behaviour(dies_at_start="no such parameter")
    life.ask(Add(transformations=(worker(params={"threshold": 3}),)))
    life.pass_time(30)
    assert (life.met, life.units) == ({"result"}, {"count.1", "work.1"})
    assert life.manager.snapshot().backing_off[0].transformation == "work"
    life.runtime.backend.behaviours.clear()
    life.pass_time(60)
    assert life.runtime.backend.units["work.2"].transformation.params == {"threshold": 3}
    assert life.units == {"count.1", "work.2"}


def test_what_runs_on_a_lost_host_moves_and_may_return() -> None:
    life = started(source(), worker(host="far"), worker("near", host="here", upkeep_us=500))
    assert life.units == {"count.1", "work.1"}
    review = life.reviewed(LoseHost("far", "no answer"))
    assert (life.units, list(review.avoided)) == ({"count.1", "near.1"}, ["work"])
    assert life.manager.snapshot().lost_hosts == ("far",)
    assert life.reviewed(RegainHost("far")).decision is Decision.DEFERRED
    life.pass_time(HORIZON_S + 1)
    assert "work.1" in life.units


def test_the_most_important_targets_are_met_where_the_cost_is_limited() -> None:
    other = Target("other", "Y2", "/other", priority=1)
    life = started(source(), worker(), worker("work2", gives="Y2"), targets=(RESULT, other), max_cost_us=9000)
    assert life.met == {"other"}


def test_a_requested_kill_blames_nobody() -> None:
    life = started()
    for _ in range(3):
        review = life.reviewed(KillUnit(next(unit for unit in life.units if unit.startswith("work"))))
        assert [p.how for p in review.perturbations if isinstance(p, UnitGone)] == ["killed"]
    assert life.met == {"result"}
    assert life.manager.snapshot().backing_off == ()


def test_a_perturbation_during_planning_is_part_of_the_same_review() -> None:
    planner = Meddling()
    life = started(planner=planner)

    def kill() -> None:
        life.runtime.backend.fail("work.1")
        life.runtime.supervisor.pump(0.01)

    planner.deed, planner.plans = kill, 0
    review = life.reviewed(Add(targets=(Target("other", "N", "/other"),)))
    assert [type(p) for p in review.perturbations] == [WorldChanged, UnitGone]
    assert (planner.plans, life.met) == (2, {"result", "other"})


def test_a_bad_request_during_planning_does_not_cost_the_plan() -> None:
    planner = Meddling()
    life = started(planner=planner)

    def ask() -> None:
        life.manager.request(Remove(targets=("nothing",)))

    planner.deed, planner.plans = ask, 0
    assert life.reviewed(Add(targets=(Target("other", "N", "/other"),))).met == ("other", "result")
    assert planner.plans == 2  # the first may have been stopped for it


def test_what_happens_during_every_plan_does_not_keep_a_review_from_its_end() -> None:
    planner = Meddling()
    life = started(planner=planner)

    def ask() -> None:
        life.manager.request(Add(targets=(Target(f"more{planner.plans}", "N", f"/more{planner.plans}"),)))
        if planner.plans < 10:
            planner.deed = ask

    planner.deed, planner.plans = ask, 0
    life.ask(Add(targets=(Target("other", "N", "/other"),)))
    assert life.met == {"result", "other", *(f"more{number}" for number in range(1, 11))}
    assert [len(review.perturbations) for review in life.reviews] == [1, 4, 4, 3]


def test_a_unit_that_dies_during_an_update_leads_to_another_review() -> None:
    life = Life(source(), worker(), behaviours={"count": Behaviour(dies_s=0.01), "work": Behaviour(start_s=1.0)})
    life.manager.step(0.1)
    life.runtime.backend.behaviours.clear()
    life.pass_time(2)
    assert life.met == {"result"}
    assert [review.decision for review in life.reviews] == [Decision.FAILED, Decision.KEPT, Decision.APPLIED]


def test_a_planner_without_an_answer_is_asked_again_later_and_later() -> None:
    def at_a_loss(problem: Problem, **_: object) -> Plan:  # noqa: ARG001
        return Plan("none", Status.UNKNOWN)

    life = Life(planner=at_a_loss, policy=Policy(retry_s=1.0, most_retry_s=8.0))
    life.pass_time(40)
    assert {review.decision for review in life.reviews} == {Decision.UNDECIDED}
    waits = [round(b.at_s - a.at_s) for a, b in zip(life.reviews, life.reviews[1:], strict=False)]
    assert waits[:5] == [1, 2, 4, 8, 8]


def test_a_plan_that_is_not_proven_gives_up_no_required_transformation_and_no_target_that_is_met() -> None:
    hurry = {"is_on": False, "gives_up": False}

    def hurried(problem: Problem, **_: object) -> Plan:
        if not hurry["is_on"]:
            return PLANNERS["cpsat"](problem)
        if hurry["gives_up"]:
            return Plan("hurried", Status.UNKNOWN)
        library = tuple(replace(t, required=False) for t in problem.environment.library)
        plan = PLANNERS["cpsat"](replace(problem, environment=replace(problem.environment, library=library)))
        unproven = replace(plan, status=Status.FEASIBLE, bound_us=0, ties_proven=False, required_proven=False)
        return replace(unproven, unused_required=("dear",))

    dear = worker("dear", upkeep_us=9_000, required=True)
    life = started(source(), dear, worker(labor_us=0), planner=hurried)
    assert life.units == {"count.1", "dear.1"}
    hurry["is_on"] = True
    kept = life.reviewed(ReviewNow())
    assert (kept.decision, kept.unmet, kept.met) == (Decision.KEPT, {}, ("result",))
    assert life.units == {"count.1", "dear.1"}
    hurry["gives_up"] = True
    life.manager.request(ReviewNow())
    life.manager.step(1.0)
    assert (life.reviews[-1].decision, life.reviews[-1].unmet) == (Decision.UNDECIDED, {})
    assert life.met == {"result"}


def test_a_planner_with_a_fault_of_its_own_does_not_end_the_life_cycle() -> None:
    planner = Meddling()
    life = Life(planner=planner)

    def stumble() -> None:
        raise ZeroDivisionError("a bug")

    planner.deed = stumble
    life.settle()
    assert [review.decision for review in life.reviews] == [Decision.UNDECIDED, Decision.APPLIED]
    assert life.reviews[0].cause == "ZeroDivisionError: a bug"


def test_a_wrong_answer_of_a_planner_is_not_carried_out() -> None:
    def lying(problem: Problem, **_: object) -> Plan:  # noqa: ARG001
        return Plan("liar", Status.OPTIMAL, ChangeSet(), 0)

    life = Life(planner=lying)
    life.pass_time(1)
    assert life.units == set()
    assert "the answer of planner liar is wrong" in life.reviews[0].cause


def test_running_units_of_a_middleware_are_taken_over() -> None:
    before = started()
    environment, change_set = before.manager.world.environment, before.reviews[0].change_set
    assert change_set is not None
    runtime = SimulatedRuntime(environment.library, environment.targets)
    runtime.apply(change_set)
    life = started(runtime=runtime)
    assert [(review.decision, review.cost_before_us) for review in life.reviews] == [(Decision.KEPT, 6000)]
    life.fail("work.1")
    assert life.met == {"result"}


class Meddling:
    """A planner during whose next plan something happens."""

    def __init__(self) -> None:
        self.plans = 0
        self.deed: Callable[[], None] | None = None

    def __call__(self, problem: Problem, **more: Any) -> Plan:
        self.plans += 1
        deed, self.deed = self.deed, None
        if deed is not None:
            deed()
        return PLANNERS["cpsat"](problem, **more)


def test_a_review_says_why_a_pinned_unit_was_stopped() -> None:
    other = Target("other", "W", "/other")
    life = started(source(), worker("sim", pinned=True), source("give", tag="W"), targets=(RESULT, other))
    review = life.reviewed(Remove(transformations=("count",)))
    assert life.units == {"give.1"}
    assert review.warnings == ("pinned unit sim.1 can't be fed: its input x wants N, but no output matches",)
    assert review_record(review)["warnings"] == [*review.warnings]
