"""Transformations that keep failing become dear and are left alone for longer and longer; no process."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import inf
from typing import Any, TypeVar

import pytest
from cfgplan_runtime import Patience, Policy, SimulatedRuntime
from cfgplan_runtime.errors import RuntimeFaultError
from cfgplan_runtime.lifecycle.back_off import BackOffRules, BackOffs, Place
from cfgplan_runtime.lifecycle.changes import Add, ReviewNow, Stop
from cfgplan_runtime.lifecycle.deliberation import without_stopping
from cfgplan_runtime.lifecycle.perturbations import MayStartAgain, UnitGone, UpdateFailed
from cfgplan_runtime.lifecycle.reports import BackedOff, Decision, Phase
from cfgplan_runtime.lifecycle.seams import DeclaredCosts
from cfgplan_runtime.supervision.events import UnitReady
from cfgplan_runtime.supervision.simulated_backend import Behaviour
from simulated_life import Life, source, started, worker

from cfgplan.domain import (
    ChangeSet,
    ComputationUnit,
    Environment,
    Host,
    Publication,
    Stream,
    Subscription,
    Target,
    Transformation,
)
from cfgplan.planners import PLANNERS
from cfgplan.planning import Plan, Problem

T = TypeVar("T")

WORK = Place("work")
CRASHING = {"work": Behaviour(dies_s=0.5)}
DYING = {"work": Behaviour(dies_at_start="no camera")}
PATIENT = Policy(back_off=BackOffRules(alone_s=300))
SPARE = worker("spare", upkeep_us=101)


def test_the_first_failure_costs_no_time_and_each_further_one_twice_as_much() -> None:
    rules = BackOffRules(first_s=1, most_s=10)
    assert [rules.delay_s(failures) for failures in range(1, 8)] == [0, 1, 2, 4, 8, 10, 10]


def test_a_unit_that_had_lived_well_fails_as_if_for_the_first_time() -> None:
    back_offs = BackOffs(BackOffRules(good_life_s=60))
    for _ in range(3):
        back_offs = back_offs.after_failure(WORK, 1.0, 0.0, "crash")
    assert back_offs.avoided == back_offs.at(1.9).avoided == {WORK}
    assert back_offs.at(100.0).after_failure(WORK, 61.0, 161.0, "crash").avoided == frozenset()


def test_what_became_cheaper_while_it_was_left_alone_is_used_when_it_may_start_again() -> None:
    life = started(source(), worker(), SPARE, estimator=DeclaredCosts(failure_us=0), horizon_s=600)
    for _ in range(2):
        life.fail("work.1")
    life.ask(Add(transformations=(worker(upkeep_us=1),)))
    assert life.units == {"count.1", "spare.1"}
    life.pass_time(1.1)
    assert life.units == {"count.1", "work.1"}
    assert life.reviews[-1].perturbations == (MayStartAgain(("work",)),)


def test_what_can_not_start_waits_from_the_first_time_on_and_is_counted_once_each_time() -> None:
    life = started(behaviours=DYING, policy=PATIENT)
    life.pass_time(100)
    waits = [report.backing_off for report in life.reports if isinstance(report, BackedOff)]
    assert [(each.failures, round(each.left_s)) for each in waits[:5]] == [(1, 1), (2, 2), (3, 4), (4, 8), (5, 16)]


def test_a_transformation_that_keeps_crashing_is_not_restarted_for_ever() -> None:
    life = started(behaviours=CRASHING, policy=PATIENT)
    life.pass_time(600)
    assert 8 <= life.starts("work") <= 12
    waits = [round(report.backing_off.left_s) for report in life.reports if isinstance(report, BackedOff)]
    assert waits[:8] == [1, 2, 4, 8, 16, 32, 64, 128]
    assert life.perturbations(MayStartAgain)


def test_where_nothing_can_take_its_place_what_keeps_crashing_waits_no_longer_than_allowed() -> None:
    life = started(behaviours=CRASHING, policy=Policy(back_off=BackOffRules(alone_s=4)))
    life.pass_time(100)
    assert 20 <= life.starts("work") <= 27
    waits = [report.backing_off for report in life.reports if isinstance(report, BackedOff)]
    assert len({one.failures for one in waits}) == len(waits), "a wait is told once, not again when it is shortened"
    assert {round(one.left_s) for one in waits} == {1, 2, 4}
    assert life.starts("count") == 1


def test_units_that_only_wait_for_what_may_start_again_stay() -> None:
    life = Life(behaviours={"work": Behaviour(start_s=5.0)})
    life.settle(10)
    for _ in range(2):
        life.fail("count.1")
    assert (life.units, life.met) == ({"work.1"}, set())
    assert life.reviews[-1].decision is Decision.KEPT
    assert "result" in life.reviews[-1].unmet
    life.pass_time(1.2)
    assert life.met == {"result"}
    assert life.starts("work") == 1


def test_what_loads_while_another_can_not_start_is_loaded_once() -> None:
    behaviours = {"work": Behaviour(start_s=5.0), "count": Behaviour(dies_at_start="no camera")}
    life = Life(behaviours=behaviours)
    life.pass_time(2.0)
    assert (life.units, life.met, life.starts("count") > 1) == ({"work.1"}, set(), True)
    life.runtime.backend.behaviours.pop("count")
    life.pass_time(3.2)
    assert life.met == {"result"}
    assert life.starts("work") == 1


def test_what_was_loaded_is_stopped_where_another_takes_the_place_of_what_can_not_start() -> None:
    other = source("other", tag="Y", upkeep_us=10_000)
    behaviours = {"work": Behaviour(start_s=5.0), "count": Behaviour(dies_at_start="no camera")}
    life = started(source(), worker(), other, behaviours=behaviours)
    assert (life.units, life.met) == ({"other.1"}, {"result"})
    assert life.now < 1


def test_what_waits_gives_topics_and_feeders_up_to_others() -> None:
    feeds, topic = (Subscription("x", Stream("a.1", "n")),), (Publication("y", "/1"),)
    running = Environment((ComputationUnit("a.1", "a"), ComputationUnit("w.1", "w", feeds, topic)))
    plan = ChangeSet(started=(ComputationUnit("b.1", "b", (), topic),), stopped=("a.1", "w.1"))
    spared = without_stopping(plan, running, {"w.1"})
    assert (spared.stopped, spared.rewired) == (("a.1",), (ComputationUnit("w.1", "w"),))


def test_what_keeps_crashing_is_replaced_by_what_is_dearer() -> None:
    life = started(source(), worker(), SPARE, behaviours=CRASHING)
    life.pass_time(30)
    assert life.units == {"count.1", "spare.1"}
    assert life.starts("work") == 2


def test_a_unit_that_cannot_start_fails_the_update_and_another_is_found() -> None:
    life = started(source(), worker(), SPARE, behaviours=DYING)
    assert [review.decision for review in life.reviews] == [Decision.FAILED, Decision.APPLIED]
    assert "no camera" in life.reviews[0].cause
    assert {failed.transformations for failed in life.perturbations(UpdateFailed)} == {("work",)}
    assert life.units == {"count.1", "spare.1"}


def test_the_rest_is_started_where_one_unit_cannot() -> None:
    life = started(source(), worker(), targets=(Target("n", "N", "/n"), Target("y", "Y", "/y")), behaviours=DYING)
    assert life.met == {"n"}
    assert list(life.reviews[-1].avoided) == ["work"]
    assert life.reviews[-1].unmet["y"] == (
        "target y wants Y, but needs transformations that are left out for now: work (after failures)"
    )


def test_a_pinned_unit_that_an_undone_update_has_kept_begins_though_no_further_update_connects_it() -> None:
    life = started(replace(source(), pinned=True), worker(), behaviours=DYING)
    life.runtime.backend.fail("count.1")
    tries = life.starts("work")
    life.pass_time(60)
    assert life.starts("work") > tries
    assert life.units == life.runtime.supervisor.alive != set()
    assert life.runtime.supervisor.inactive == set()


def test_a_unit_that_is_never_ready_is_to_blame() -> None:
    life = Life(source(), worker(), SPARE, behaviours={"work": Behaviour(start_s=1000)})
    life.settle(Patience().start_s + 10)
    assert life.units == {"count.1", "spare.1"}
    assert life.starts("work") == 1


def test_without_unit_code_a_transformation_is_left_alone_until_it_changes() -> None:
    life = started(source(), worker(source=None), SPARE)
    assert life.units == {"count.1", "spare.1"}
    (waiting,) = life.manager.snapshot().backing_off
    assert (waiting.transformation, waiting.left_s) == ("work", inf)
    only = started(source(), worker(source=None))
    assert (
        only.reviews[-1]
        .unmet["result"]
        .partition("left out for now: ")[2]
        .startswith("work (it has no unit code: add `source:")
    )
    life.ask(ReviewNow())
    assert life.units == {"count.1", "spare.1"}
    life.ask(Add(transformations=(worker(),)))
    life.ask(ReviewNow())
    assert life.manager.snapshot().backing_off == ()
    assert life.units == {"count.1", "spare.1"}  # starting the cheaper one does not pay


def test_a_requested_review_forgives() -> None:
    life = started(behaviours=DYING)
    assert life.met == set()
    life.runtime.backend.behaviours.clear()
    life.ask(ReviewNow())
    assert life.met == {"result"}


def test_other_code_is_a_new_chance() -> None:
    life = started(behaviours=DYING)
    life.pass_time(10)
    life.runtime.backend.behaviours.clear()
    life.ask(Add(transformations=(worker(params={"fixed": True}),)))
    assert life.met == {"result"}


def test_failures_reach_the_estimator() -> None:
    failed: list[str] = []

    class Watched:
        def observe(self, *_: object) -> None: ...
        def failed(self, transformation: str, now_s: float) -> None:  # noqa: ARG002
            failed.append(transformation)

        def labor_us(self, transformation: object, horizon_s: int) -> int:  # noqa: ARG002
            return 1

        upkeep_us = labor_us

    life: Life = started(estimator=Watched())
    life.fail("work.1")
    assert failed == ["work"]


def test_a_slow_start_does_not_hold_up_a_repair() -> None:
    other, slow = Target("other", "S", "/other"), worker("slow", gives="S")
    life = Life(source(), worker(), behaviours={"slow": Behaviour(start_s=20.0), "work": Behaviour(dies_s=5.0)})
    life.settle()
    life.runtime.backend.behaviours.pop("work")
    life.manager.request(Add(transformations=(slow,)))
    life.manager.request(Add(targets=(other,)))
    life.manager.step()
    repair, failed = next(review for review in life.reviews if review.decision is Decision.FAILED), life.now
    assert "it was given up while slow.1 was starting" in repair.cause
    assert 5 < failed < 5.1
    life.manager.step()
    assert (life.met, life.now < 5.2) == ({"result"}, True)
    life.pass_time(30)
    assert (life.met, life.manager.snapshot().backing_off) == ({"result", "other"}, ())
    assert life.starts("slow") == 2


def test_the_end_does_not_wait_for_a_slow_start() -> None:
    life = Life(behaviours={"work": Behaviour(start_s=20.0), "count": Behaviour(start_s=1.0)})
    life.runtime.listen(lambda event: life.manager.request(Stop()) if isinstance(event, UnitReady) else None)
    life.manager.run(10)
    assert life.manager.snapshot().phase is Phase.STOPPED
    assert life.now < 2


def test_the_end_does_not_wait_for_a_slow_start_that_is_about_to_be_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    life = Life(behaviours={"work": Behaviour(start_s=20.0)})
    execute, clock = life.runtime.clock.call, life.runtime.clock

    def call(work: Callable[[], T]) -> T:
        life.manager.request(Stop())
        return execute(work)

    monkeypatch.setattr(clock, "call", call)
    life.manager.run(10)
    assert life.manager.snapshot().phase is Phase.STOPPED
    assert life.now < 2


def test_the_end_does_not_wait_for_a_slow_start_that_was_just_decided() -> None:
    class Watched(SimulatedRuntime):
        """What runs is asked for once more when a plan was made, to decide about it."""

        @property
        def environment(self) -> Environment:
            if planned and not asked:
                asked.append(life.manager.request(Stop()))
            return super().environment

    planned, asked = list[Plan](), list[object]()

    def planner(problem: Problem, **limits: Any) -> Plan:
        planned.append(PLANNERS["cpsat"](problem, **limits))
        return planned[-1]

    life = Life(planner=planner, runtime=Watched(behaviours={"work": Behaviour(start_s=20.0)}))
    life.manager.run(10)
    assert asked
    assert life.manager.snapshot().phase is Phase.STOPPED
    assert life.now < 2


def test_failures_make_declared_costs_dearer_on_their_host_only() -> None:
    estimator, (near, far) = DeclaredCosts(failure_us=1_000), (Host("near"), Host("far"))
    work = Transformation("work", labor_us=10)
    for _ in range(2):
        estimator.failed("work", 1.0, "far")
    assert [estimator.labor_us(work, 60, host) for host in (None, near, far)] == [10, 10, 1_010]
    for _ in range(2):
        estimator.failed("work", 1.0)
    assert [estimator.labor_us(work, 60, host) for host in (None, near, far)] == [1_010, 1_010, 3_010]


def test_an_estimator_that_raises_ends_nothing_and_is_told_in_reviews() -> None:
    class Bad(DeclaredCosts):
        def observe(self, *_: object) -> None:
            raise ZeroDivisionError("a bug of the estimator")

    life: Life = started(estimator=Bad())
    life.pass_time(3.0)
    life.fail("work.1")
    assert life.met == {"result"}
    assert any("the estimator has failed (ZeroDivisionError" in line for line in life.reviews[-1].warnings)


def test_a_report_that_raises_ends_nothing() -> None:
    life: Life = started()
    life.manager.listen(lambda _: 1 // 0)
    life.fail("work.1")
    assert life.met == {"result"}


def test_a_death_is_told_though_the_runtime_is_closed_and_remembers_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    life = started(source(), worker())
    asked = []

    def remember(*failures: object) -> None:
        asked.append(failures)
        raise RuntimeFaultError("the runtime is closed")

    monkeypatch.setattr(life.runtime, "remember", remember)
    life.fail("work.1")
    assert len(asked) == 1
    assert [one.unit for one in life.perturbations(UnitGone)] == ["work.1"]
