"""The life-cycle on real processes, judged by what comes out on the topics."""

from __future__ import annotations

import errno
import os
import signal
from pathlib import Path
from typing import Any

import psutil
import pytest
from cfgplan_runtime import Policy
from cfgplan_runtime.lifecycle.back_off import BackOffRules
from cfgplan_runtime.lifecycle.changes import RestartUnits
from cfgplan_runtime.lifecycle.perturbations import (
    HorizonReached,
    SubscriptionLost,
    UnitGone,
    UnitKeepsFailing,
    WorldChanged,
)
from cfgplan_runtime.lifecycle.reports import Decision, Review, UnitEvent
from cfgplan_runtime.processes import process_backend
from cfgplan_runtime.processes.process_backend import OUTLETS
from cfgplan_runtime.supervision.events import OutOfDescriptors, SpareUsed
from real_run import PROGRAMS, UNITS, RealRun, eventually, source, worker
from unit_signals import unit_pid

RESULT, SLOW, DYING = {"/result": "Y"}, {"/slow": "S"}, {"/dying": "D"}
CHAIN = (source(), worker("first", gives="Z"), worker("last", needs="Z"))


def test_the_stream_goes_on_after_the_death_of_each_unit(run_for_real: RealRun) -> None:
    run_for_real.start(*CHAIN)
    for number, unit in enumerate(sorted(run_for_real.runtime.environment.unit), 1):
        run_for_real.kill(unit)
        eventually(lambda number=number: len(run_for_real.seen(UnitGone)) == number)  # type: ignore[misc]
        assert run_for_real.manager.settle(60)
        run_for_real.await_result("last")
    assert [gone.how for gone in run_for_real.seen(UnitGone)] == ["died"] * 3
    assert Decision.FAILED not in {review.decision for review in run_for_real.reviews}


@pytest.mark.parametrize("form", PROGRAMS)
def test_a_killed_program_is_replaced_by_its_spare_and_its_unit_by_a_new_one(run_for_real: RealRun, form: str) -> None:
    run = run_for_real
    run.start(source(), worker(source=PROGRAMS[form], run={"format": form}, standby=0.0001), survive=1)
    for number in (1, 2):
        eventually(lambda: bool(prepared(run)))
        unit = next(name for name in run.runtime.environment.unit if name.startswith("work") and run.runtime.pid(name))
        (program,) = psutil.Process(run.runtime.pid(unit)).children()
        program.kill()
        eventually(lambda number=number: len(run.seen(UnitGone)) == number)  # type: ignore[misc]
        assert run.manager.settle(60)
        run.await_result("work")
    assert used(run)


def test_a_restarted_unit_takes_over_without_a_gap_and_has_the_new_code(run_for_real: RealRun) -> None:
    run = run_for_real
    run.start(source(), worker(standby=0.0001), source("spare", tag="N"), survive=1)
    units = run.file.with_name("units.py")
    units.write_text(UNITS.replace("return [self.name, x", 'return [self.name + "2", x'))
    review = run.manager.request(RestartUnits(("work.1",))).result(60)
    assert review is not None
    assert review.decision is Decision.APPLIED
    run.await_result("work2")
    eventually(lambda: len(run.runtime.environment.unit) >= 3)
    numbers = [received.value[1] for received in run.listener().received]
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))


@pytest.mark.parametrize("fault", ["raise ValueError('bad luck')", "import os; os._exit(3)"])
def test_a_restarted_unit_whose_new_code_fails_leaves_the_old_one_at_work(run_for_real: RealRun, fault: str) -> None:
    run = run_for_real
    run.start(source(), worker())
    run.file.with_name("units.py").write_text(UNITS.replace('if self.deed == "hang":', f"{fault}\n        if False:"))
    review = run.manager.request(RestartUnits(("work.1",))).result(60)
    assert review is not None
    assert (review.decision, "work.2" in review.cause) == (Decision.FAILED, True)
    assert run.manager.settle(60)
    run.await_result("work")
    assert set(run.runtime.environment.unit) == {"count.1", "work.1"}
    numbers = [received.value[1] for received in run.listener().received]
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))


def test_a_killed_unit_is_replaced_where_its_spare_was_prepared(run_for_real: RealRun) -> None:
    run = run_for_real
    run.start(source(standby=0.0001), worker(deed="start slowly", standby=0.0001), survive=1)
    eventually(lambda: len(prepared(run)) == 2)
    spares = prepared(run)
    run.kill("work.1")
    eventually(lambda: bool(used(run)))
    assert {event.spare for event in used(run)} < spares
    assert run.manager.settle(60)
    run.await_result("work")
    eventually(lambda: len(prepared(run)) == 2)
    assert [gone.unit for gone in run.seen(UnitGone)] == ["work.1"]


def test_one_of_several_streams_is_replaced_where_its_spare_was_prepared(run_for_real: RealRun) -> None:
    run, several = run_for_real, worker(standby=0.0001)
    several["work"]["inputs"] = {"x": {"tag": "N", "count": 2}}
    run.start(source(standby=0.0001), several, survive=1)
    eventually(lambda: len(prepared(run)) == 2)
    before = run.runtime.environment.unit["work.1"].feeds["x"]
    assert len(before) == 2
    killed = run.runtime.pid(before[0].unit)
    run.kill(before[0].unit)
    eventually(lambda: bool(used(run)))
    assert run.manager.settle(60)
    run.await_result("work")
    after = run.runtime.environment.unit["work.1"].feeds["x"]
    assert len(after) == 2
    assert before[1] in after
    assert killed not in {run.runtime.pid(stream.unit) for stream in after}
    eventually(lambda: len(prepared(run)) == 2)
    assert [gone.unit for gone in run.seen(UnitGone)] == [before[0].unit]


def prepared(run: RealRun) -> set[str]:
    """The cold spares that are ready."""
    return {view.unit.id for view in run.manager.snapshot().units if view.is_prepared}


def used(run: RealRun) -> list[SpareUsed]:
    told = [report.event for report in list(run.reports) if isinstance(report, UnitEvent)]
    return [event for event in told if isinstance(event, SpareUsed)]


def test_the_stream_goes_on_after_a_subscription_is_removed(run_for_real: RealRun) -> None:
    run_for_real.start(*CHAIN)
    for unit, port in ((None, "/result"), ("last.1", "x"), ("first.1", "x")):
        lost = len(run_for_real.seen(SubscriptionLost))
        run_for_real.runtime.cut(unit, port)
        eventually(lambda lost=lost: len(run_for_real.seen(SubscriptionLost)) > lost)  # type: ignore[misc]
        assert run_for_real.manager.settle(60)
        run_for_real.await_result("last")
    assert sorted(run_for_real.runtime.environment.unit) == ["count.1", "first.1", "last.1"]


def test_a_cheaper_transformation_takes_over_at_the_horizon_and_not_before(run_for_real: RealRun) -> None:
    run_for_real.start(source(), worker(), horizon=4)
    run_for_real.write(source(), worker(), worker("cheap", upkeep=0.0, labor=0.01), horizon=4)
    eventually(lambda: len(run_for_real.seen(WorldChanged)) > 0)
    run_for_real.await_result("cheap")
    switched_at = run_for_real.providers().index("cheap")
    assert set(run_for_real.providers()[:switched_at]) == {"work"}
    assert set(run_for_real.providers()[switched_at:]) == {"cheap"}

    def later() -> list[Review]:
        return [each for each in run_for_real.reviews if each.change_set and each.decision is Decision.APPLIED][1:]

    eventually(lambda: bool(later()))
    (review,) = later()
    assert any(isinstance(perturbation, HorizonReached) for perturbation in review.perturbations)
    assert_nothing_is_missing(run_for_real)


def test_a_transformation_in_use_can_be_removed_or_changed_without_a_loss(run_for_real: RealRun) -> None:
    run_for_real.start(source(), worker(), worker("spare", upkeep=0.5))
    assert set(run_for_real.providers()) == {"work"}
    run_for_real.write(source(), worker("spare", upkeep=0.5))
    run_for_real.await_result("spare")
    eventually(lambda: set(run_for_real.runtime.environment.unit) == {"count.1", "spare.1"})
    run_for_real.write(source(), worker("spare", upkeep=0.5, host="here"))
    eventually(lambda: "spare.2" in run_for_real.runtime.environment.unit)
    run_for_real.await_result("spare")
    assert_nothing_is_missing(run_for_real)


def test_an_impossible_target_and_a_broken_file_leave_the_others_alone(run_for_real: RealRun) -> None:
    run_for_real.start(source(), worker())
    run_for_real.write(source(), worker(), targets={"/result": "Y", "/other": "Impossible"})
    eventually(lambda: any("other" in review.unmet for review in run_for_real.reviews))
    good = run_for_real.file.read_text()
    run_for_real.write_text(good.replace("Impossible", "Impossible and"))
    eventually(lambda: len(run_for_real.refused) == 1)
    (fault,) = run_for_real.manager.snapshot().faults
    assert (fault.file, fault.line is None) == (str(run_for_real.file), False)
    run_for_real.write_text(good.replace("Impossible", "N"))
    eventually(lambda: run_for_real.manager.snapshot().faults == ())
    eventually(lambda: all(view.is_met for view in run_for_real.manager.snapshot().targets))
    run_for_real.await_result("work")
    assert_nothing_is_missing(run_for_real)


def test_a_hung_unit_a_failing_one_and_one_that_cannot_start_give_way_to_others(run_for_real: RealRun) -> None:
    impatient = Policy(failing_s=0.5, failing_steps=3, back_off=BackOffRules(first_s=600))
    bad = [
        worker("hanging", deed="hang", upkeep=0.001, run={"hang": 2}),
        worker("raising", deed="raise", upkeep=0.002),
        worker("dying", deed="die at start", upkeep=0.003),
    ]
    run_for_real.start(source(), worker(upkeep=0.004), *bad, policy=impatient)
    run_for_real.await_result("work")
    assert {gone.how for gone in run_for_real.seen(UnitGone)} == {"hung"}
    assert {each.transformation for each in run_for_real.seen(UnitKeepsFailing)} == {"raising"}
    assert any("no such device" in review.cause for review in run_for_real.reviews)


def test_a_slow_start_does_not_hold_up_a_repair(run_for_real: RealRun) -> None:
    run_for_real.start(source(), worker())
    me, pid = psutil.Process(), run_for_real.runtime.pid("work.1")
    assert pid is not None
    processes = len(me.children(recursive=True))
    slow = worker("slow", gives="S", deed="start slowly")
    run_for_real.write(source(), worker(), slow, targets={"/result": "Y", "/slow": "S"})
    eventually(lambda: len(me.children(recursive=True)) > processes)
    os.kill(pid, signal.SIGKILL)
    run_for_real.await_result("work")
    assert not any(view.is_met for view in run_for_real.manager.snapshot().targets if view.topic == "/slow")
    run_for_real.await_result("slow", topic="/slow")


def test_what_only_waits_for_a_source_that_died_twice_is_not_loaded_again(run_for_real: RealRun) -> None:
    run_for_real.start(source(), worker(deed="start slowly"))
    pid = run_for_real.runtime.pid("work.1")
    for number in (1, 2):
        eventually(lambda: "count.1" in run_for_real.runtime.environment.unit)
        run_for_real.kill("count.1")
        eventually(lambda number=number: len(run_for_real.seen(UnitGone)) == number)  # type: ignore[misc]
    run_for_real.await_result("work")
    assert run_for_real.runtime.pid("work.1") == pid


def test_what_loads_while_another_can_not_start_is_loaded_once(run_for_real: RealRun) -> None:
    slow = worker("slow", gives="S", deed="start slowly")
    run_for_real.start(source(), worker())
    run_for_real.write(
        source(), worker(), slow, worker("dying", gives="D", deed="die at start"), targets={**RESULT, **SLOW, **DYING}
    )
    eventually(lambda: "slow.1" in run_for_real.runtime.environment.unit)
    pid = run_for_real.runtime.pid("slow.1")
    run_for_real.await_result("slow", topic="/slow")
    assert any("no such device" in review.cause for review in run_for_real.reviews)
    assert run_for_real.runtime.pid("slow.1") == pid


def test_a_stopped_nursery_makes_few_reviews_and_the_stream_goes_on(
    run_for_real: RealRun, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(process_backend, "HELPER_S", 6.0)
    run_for_real.start(source(), worker())
    run_for_real.await_result("work", more=400)
    nursery = psutil.Process(unit_pid(run_for_real.runtime, "work.1")).parent()
    assert nursery is not None
    run_for_real.kill("count.1")
    nursery.suspend()
    gone = len(run_for_real.seen(UnitGone))
    eventually(lambda: len(run_for_real.seen(UnitGone)) > gone)
    assert len(run_for_real.reviews) < 30
    run_for_real.await_result("work")


def test_a_full_disk_for_a_topics_address_costs_no_unit_and_the_topic_comes_once_there_is_room(
    run_for_real: RealRun, monkeypatch: pytest.MonkeyPatch
) -> None:
    run_for_real.start(source(), worker())
    pids = [run_for_real.runtime.pid(unit) for unit in ("count.1", "work.1", OUTLETS)]

    write_text = Path.write_text

    def full(path: Path, *text: Any, **more: Any) -> int:
        if path.suffix == ".topic":
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return write_text(path, *text, **more)

    def told() -> list[str]:
        events = [report.event for report in list(run_for_real.reports) if isinstance(report, UnitEvent)]
        return [event.cause for event in events if isinstance(event, OutOfDescriptors)]

    with monkeypatch.context() as patched:
        patched.setattr(Path, "write_text", full)
        run_for_real.write(source(), worker(), worker("slow", gives="S"), targets={**RESULT, **SLOW})
        eventually(told)
        run_for_real.await_result("work")
    run_for_real.await_result("slow", topic="/slow")
    assert told() == ["topic /slow can't be opened: No space left on device"]
    assert [run_for_real.runtime.pid(unit) for unit in ("count.1", "work.1", OUTLETS)] == pids


def test_an_edit_that_declares_hosts_is_refused_on_one_computer(run_for_real: RealRun) -> None:
    run_for_real.start(source(), worker(), policy=Policy(refuses_hosts=True))
    run_for_real.write_text(run_for_real.file.read_text() + "hosts: [{name: here}]\n")
    eventually(lambda: len(run_for_real.refused) == 1)
    (fault,) = run_for_real.manager.snapshot().faults
    assert fault.message == "this run is on one computer, and can't place units on hosts (here)"
    assert fault.mend == "add --local to try all hosts on this computer, or --connect to reach their agents"
    run_for_real.await_result("work")


def test_a_removed_target_takes_away_what_only_it_needed(run_for_real: RealRun) -> None:
    both = {"/result": "Y", "/other": "Z"}
    run_for_real.start(source(), worker(), worker("other", gives="Z"), targets=both)
    run_for_real.await_result("other", topic="/other")
    run_for_real.write(source(), worker(), worker("other", gives="Z"))
    eventually(lambda: set(run_for_real.runtime.environment.unit) == {"count.1", "work.1"})
    run_for_real.await_result("work")
    run_for_real.write(source(), worker(), worker("other", gives="Z"), targets=both)
    run_for_real.await_result("other", topic="/other")
    assert_nothing_is_missing(run_for_real)


def assert_nothing_is_missing(run: RealRun) -> None:
    """Whatever happened, /result has had every number of the source, once and in order."""
    numbers = [received.value[1] for received in run.listener().received]
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
