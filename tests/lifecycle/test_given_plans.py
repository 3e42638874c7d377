"""What a review would do is asked for, and a plan made so is carried out, or refused since it is stale; no process."""

from __future__ import annotations

from concurrent.futures import Future
from dataclasses import replace
from typing import Any

import pytest
from cfgplan_runtime.errors import RuntimeFaultError
from cfgplan_runtime.lifecycle.basis import Preview, plan_text
from cfgplan_runtime.lifecycle.changes import (
    Add,
    ApplyPlan,
    KillUnit,
    LoseHost,
    Remove,
    ReplaceWorld,
    Restore,
    ReviewNow,
    Stop,
)
from cfgplan_runtime.lifecycle.deliberation import Findings
from cfgplan_runtime.lifecycle.perturbations import PlanGiven, UnitGone
from cfgplan_runtime.lifecycle.reports import Decision, Review
from cfgplan_runtime.lifecycle.review_sentences import decision, preview_sentence
from simulated_life import HORIZON_S, RESULT, Life, source, started, worker

from cfgplan import api
from cfgplan.domain import ChangeSet, Environment, Target
from cfgplan.errors import InputError
from cfgplan.formats.plan_file import read_run_plan
from cfgplan.planners import PLANNERS
from cfgplan.planning import Plan, Problem

REPRICED = Add(transformations=(worker("cheap", labor_us=11, upkeep_us=1, host="far"),))
CHEAP = worker("cheap", labor_us=10, upkeep_us=1, host="far")


@pytest.fixture
def life() -> Life:
    """Work runs, and a cheaper way waits for the horizon."""
    life = started()
    life.ask(Add(transformations=(CHEAP,)))
    return life


def preview(life: Life) -> Preview:
    future = life.manager.preview()
    life.settle()
    return future.result(timeout=0)


def given(life: Life) -> ApplyPlan:
    """The plan that a review would make now, as it comes back from a file."""
    plan, basis = read_run_plan(plan_text(preview(life)), "plan.json")
    assert plan.change_set is not None
    return ApplyPlan(plan.change_set, basis, "plan.json")


def refusal(life: Life, change: ApplyPlan) -> str:
    future = life.manager.request(change)
    life.settle()
    with pytest.raises(InputError) as error:
        future.result(timeout=0)
    return "; ".join(str(fault) for fault in error.value.faults)


def test_a_preview_tells_what_a_review_would_do_and_changes_nothing(life: Life) -> None:
    reviews = life.reviews
    findings = preview(life).findings
    assert findings.change_set is not None
    assert [unit.id for unit in findings.change_set.started] == ["cheap.1"]
    assert findings.change_set.stopped == ("work.1",)
    assert findings.cost_us == 10 + HORIZON_S
    assert findings.cost_before_us == 100 * HORIZON_S
    assert (life.units, life.reviews) == ({"count.1", "work.1"}, reviews)


def test_a_plan_is_carried_out_as_a_review(life: Life) -> None:
    review = life.reviewed(given(life))
    assert life.units == {"count.1", "cheap.1"}
    assert (review.decision, review.perturbations) == (Decision.APPLIED, (PlanGiven("plan.json"),))
    assert review == life.reviews[-1]
    assert [each.number for each in life.reviews] == [1, 2, 3]
    assert (review.cost_us, review.bound_us, review.is_proven) == (10 + HORIZON_S, 0, False)
    assert life.met == {"result"}
    life.fail("cheap.1")
    assert life.reviews[-1].number == 4


def test_what_a_review_would_leave_as_it_is_is_a_plan_without_a_change() -> None:
    life = started()
    plan = given(life)
    assert not plan.change_set
    assert life.reviewed(plan).change_set == plan.change_set
    assert life.units == {"count.1", "work.1"}


def test_a_preview_that_is_asked_for_before_the_first_review_waits_for_it() -> None:
    life = Life()
    future = life.manager.preview()
    life.settle()
    assert future.result(timeout=0).findings.decision is Decision.KEPT
    assert len(life.reviews) == 1


def test_a_preview_that_something_breaks_into_is_made_anew() -> None:
    kills: list[Future[Review | None]] = []

    def planner(problem: Problem, **more: Any) -> Plan:
        if life.reviews and not kills:
            kills.append(life.manager.request(KillUnit("work.1")))
        return PLANNERS["cpsat"](problem, **more)

    life = Life(planner=planner)
    life.settle()
    future = life.manager.preview()
    life.settle()
    assert kills[0].result(timeout=0) == life.reviews[-1]
    assert future.result(timeout=0).findings.running is life.runtime.environment


@pytest.mark.parametrize(
    ("happens", "why"),
    [
        (lambda life: life.fail("work.1"), "unit work.1 does not run any more"),
        (lambda life: life.ask(REPRICED), "transformation cheap has been changed"),
        (lambda life: life.ask(Remove(transformations=("cheap",))), "transformation cheap does not exist any more"),
        (lambda life: life.ask(Add(targets=(Target("n", "N", "/n"),))), "target n is wanted now"),
        (lambda life: life.ask(Add(targets=(replace(RESULT, priority=3),))), "target result has been changed"),
        (
            lambda life: life.ask(ReplaceWorld(api.world(life.manager.world.environment, horizon_s=90), "file")),
            "setting horizon has been changed",
        ),
    ],
)  # fmt: skip
def test_a_stale_plan_is_refused_with_what_has_changed(life: Life, happens: object, why: str) -> None:
    plan = given(life)
    happens(life)  # type: ignore[operator]
    units, reviews = life.units, len(life.reviews)
    said = refusal(life, plan)
    assert f"the plan is stale: {why}" in said
    assert "cfgplan ctl plan --out" in said
    assert (life.units, len(life.reviews)) == (units, reviews)


def test_a_plan_that_waited_for_a_review_is_refused_if_that_changed_what_runs(life: Life) -> None:
    plan = given(life)
    life.manager.request(KillUnit("work.1"))
    assert "unit work.1 does not run any more" in refusal(life, plan)
    assert life.perturbations(UnitGone)


def test_of_two_plans_for_the_same_the_second_is_stale(life: Life) -> None:
    plan = given(life)
    first = life.manager.request(plan)
    assert "unit cheap.1 runs now" in refusal(life, plan)
    assert first.result(timeout=0) == life.reviews[-1]


def test_a_plan_for_a_host_that_is_gone_since_is_not_carried_out(life: Life) -> None:
    plan = given(life)
    life.ask(LoseHost("far"))
    assert "the plan can't be carried out: " in refusal(life, plan)
    assert life.units == {"count.1", "work.1"}


def test_a_plan_that_was_edited_into_nonsense_is_not_carried_out(life: Life) -> None:
    plan = given(life)
    unfed = replace(
        plan, change_set=replace(plan.change_set, started=(replace(plan.change_set.started[0], subscriptions=()),))
    )
    said = refusal(life, unfed)
    assert "the plan can't be carried out: " in said
    assert "cheap.1" in said
    unknown = replace(plan, change_set=replace(plan.change_set, stopped=("nobody.1",)))
    assert "nobody.1" in refusal(life, unknown)
    assert life.units == {"count.1", "work.1"}
    assert life.reviewed(plan).decision is Decision.APPLIED


def test_a_plan_may_meet_less_than_a_review_would() -> None:
    life = started(source(), worker(), targets=(RESULT, Target("n", "N", "/n")))
    plan = given(life)
    less = replace(plan, change_set=life.runtime.environment.change_to(()))
    review = life.reviewed(less)
    assert review.unmet == dict.fromkeys(("result", "n"), "the plan that was given does not meet it")
    assert life.met == set()


def test_who_waits_for_a_plan_is_told_of_the_end(life: Life) -> None:
    plan = given(life)
    life.manager.request(Stop())
    waiting = life.manager.preview(), life.manager.request(plan)
    life.manager.step()
    for each in (*waiting, life.manager.preview(), life.manager.request(plan)):
        with pytest.raises(RuntimeFaultError):
            each.result(timeout=0)


NODES = (source("lidar", source="external:/lidar"), worker("guard", source="node:./robot.py guard"))


def test_a_node_that_others_have_started_is_adopted_and_not_started() -> None:
    life = Life(*NODES)
    life.settle()
    (review,) = life.reviews
    assert review.external == ("lidar.1",)
    assert decision(review) == "adopted lidar.1, started guard.1"


def test_a_preview_says_adopt_of_such_a_node() -> None:
    life = Life(*NODES)
    findings = Findings(Environment(), life.manager.world.environment, change_set=started_both())
    assert "adopt lidar.1, start guard.1" in preview_sentence(findings)


def started_both() -> ChangeSet:
    life = Life(*NODES)
    life.settle()
    (review,) = life.reviews
    assert review.change_set is not None
    return review.change_set


def test_a_restored_transformation_that_only_saves_cost_waits_for_a_review_that_optimises() -> None:
    life = started(source("lidar", upkeep_us=20), source("sonar", upkeep_us=200), worker("guard"))
    life.ask(Remove(transformations=("lidar",)))
    assert life.units == {"sonar.1", "guard.1"}
    assert life.reviewed(Restore(("lidar",))).decision is Decision.DEFERRED
    assert life.units == {"sonar.1", "guard.1"}
    assert life.reviewed(ReviewNow("test")).decision is Decision.APPLIED
    assert life.units == {"lidar.1", "guard.1"}
