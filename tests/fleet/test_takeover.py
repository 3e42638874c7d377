"""A manager that takes over continues with the failures, back-offs and hand-overs of states of the one before it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import msgspec
import pytest
from cfgplan_runtime.errors import RuntimeFaultError
from cfgplan_runtime.fleet import orders
from cfgplan_runtime.fleet.fleet_backend import FleetBackend
from cfgplan_runtime.fleet.fleet_runtime import Fleet, LeftUnits, left_units
from cfgplan_runtime.lifecycle.basis import Preview
from cfgplan_runtime.lifecycle.manager import Manager
from cfgplan_runtime.lifecycle.policy import Policy
from cfgplan_runtime.operating.operation import Settings
from cfgplan_runtime.streams.run_folder import base_folder, remove_dead_runs
from cfgplan_runtime.supervision.backend import Failures
from cfgplan_runtime.supervision.events import Event, FailuresKept, HostJoined, HostLost
from failing_run import FIRST_S, HOSTS, world
from small_fleet import (
    FOLDER,
    PATIENCE_S,
    Listener,
    SmallFleet,
    eventually,
    moved,
    seen,
    small_fleet,
    source,
    swap,
    unit,
    worker,
)
from warm_python import warm_subprocess

from cfgplan import __version__, api
from cfgplan.api import matches
from cfgplan.cli.first_plan import first_review
from cfgplan.domain import ChangeSet, RunOptions

WORK = worker("work", "same")
FAILED = Failures(WORK, "r1", 3, 200.0, "no camera")


@contextmanager
def killed_run(fleet: SmallFleet, note: Path) -> Iterator[None]:
    """A run whose worker has failed on r1 and runs on r2; its manager is killed, then the worker."""
    line = [sys.executable, "-c", "import failing_run; failing_run.main()", str(note), *fleet.endpoints]
    with warm_subprocess("failing_run").Popen(line, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        try:
            assert process.stdout.readline() == b"met\n"
        finally:
            process.kill()
    remove_dead_runs(base_folder())
    (pid,) = fleet.pids("work")
    os.kill(pid, signal.SIGKILL)
    eventually(lambda: not fleet.pids("work"))
    yield


@pytest.mark.parametrize("is_changed", [False, True], ids=["as it was", "changed"])
def test_a_transformation_that_failed_on_a_host_is_not_started_there_by_the_next_manager_unless_it_is_changed(
    tmp_path: Path, is_changed: bool
) -> None:
    first, then = tmp_path / "first", tmp_path / "then"
    with small_fleet(*HOSTS) as fleet:
        with killed_run(fleet, first):
            pass
        known = world(then if is_changed else first)
        left = left_units(Fleet(fleet.endpoints), known.environment, FOLDER)
        assert [(one.transformation, one.host) for one in left.failures] == ([] if is_changed else [("work", "r1")])
        assert hosts_of_work(preview(known, left)) == {"r1" if is_changed else "r2"}, "the plan that is shown"
        policy, unaware = Policy(hosts_s=PATIENCE_S), preview(known, LeftUnits(left.running))
        assert hosts_of_work(unaware) == {"r1"}
        with (
            fleet.runtime(*known.environment.library) as runtime,
            Manager(known, runtime, policy=policy, first=unaware) as manager,
        ):
            eventually(lambda: all(target.is_met for target in manager.targets))
            assert [one.host for one in runtime.environment.units if one.transformation == "work"] == ["r2"]
            backing_off = manager.snapshot().backing_off
    assert len(first.read_text().splitlines()) == 1
    assert then.exists() is is_changed, "other params may start on r1"
    if not is_changed:
        (one,) = backing_off
        assert (one.transformation, one.host, one.failures) == ("work", "r1", 1)
        assert "no camera" in one.cause
        assert 0 < one.left_s < FIRST_S, "the wait goes on"


def preview(known: api.World, left: LeftUnits) -> Preview:
    """The first plan of a run, as the command makes it."""
    found = matches(known, most=api.FEW_PAIRS)
    return first_review(known, Settings(estimates=None), found, left.running, failures=left.failures)


def hosts_of_work(made: Preview) -> set[str | None]:
    assert made.findings.change_set is not None
    return {one.host for one in made.findings.change_set.started if one.transformation == "work"}


def told(backend: FleetBackend, kind: type[Event]) -> list[Event]:
    """The events of a kind that a backend has to tell now."""
    found = list[Event]()

    def has_joined() -> bool:
        found.extend(backend.wait(0.1))
        return any(isinstance(one, HostJoined) for one in found)

    eventually(has_joined)
    return [one for one in found if isinstance(one, kind)]


def deliver(backend: FleetBackend, host: str) -> None:
    """Wait until an agent has all orders."""
    eventually(lambda: backend.wait(0.05) is not None and backend._presence.there[host].channel.is_done)


def test_a_host_tells_each_later_manager_of_the_failures_there_until_they_are_forgotten() -> None:
    with small_fleet("r1") as fleet, fleet.backend("r1", library=[WORK]) as first, ExitStack() as stack:
        first.remember("work", "r1", FAILED)
        first.remember("other", "r1", FAILED)
        first.remember("other", "r1", None)
        deliver(first, "r1")
        for _ in range(2):
            later = stack.enter_context(fleet.backend("r1", library=[WORK], takes_over=True))
            (kept,) = told(later, FailuresKept)
            assert isinstance(kept, FailuresKept)
            assert (kept.transformation, kept.host, kept.number, kept.cause) == ("work", "r1", 3, "no camera")
            assert 0 < kept.left_s <= FAILED.left_s


def test_failures_of_changed_code_are_forgotten(tmp_path: Path) -> None:
    code = (FOLDER / "fleet_units.py").read_text()
    (tmp_path / "fleet_units.py").write_text(code + "# mended")
    with small_fleet("r1") as fleet, fleet.backend("r1", library=[WORK]) as first, ExitStack() as stack:
        first.remember("work", "r1", FAILED)
        deliver(first, "r1")
        later = stack.enter_context(fleet.backend("r1", library=[WORK], folder=tmp_path, takes_over=True))
        assert told(later, FailuresKept) == []
        last = stack.enter_context(fleet.backend("r1", library=[WORK], takes_over=True))
        assert told(last, FailuresKept) == [], "they are forgotten for good"


def test_failures_are_reported_whatever_the_library_was_when_the_run_began() -> None:
    """The manager judges them by its present library."""
    with small_fleet("r1", "r2") as fleet, fleet.backend("r1", "r2") as first:
        first.remember("work", "r2", FAILED)
        deliver(first, "r2")
        edited = replace(WORK, params={"edited": True})
        with fleet.backend("r1", library=[edited], takes_over=True) as later:
            assert told(later, FailuresKept) == []
            later.take_hosts(["r2"])
            (kept,) = told(later, FailuresKept)
            assert isinstance(kept, FailuresKept)
            assert [kept.is_of(one) for one in (WORK, edited, None)] == [True, False, False]


def test_failures_that_were_forgotten_while_their_host_was_away_are_forgotten_there_and_here() -> None:
    with small_fleet("r1") as fleet, fleet.backend("r1") as first:
        told(first, HostJoined)
        first.remember("work", "r1", FAILED)
        deliver(first, "r1")
        host = first._presence.there["r1"]
        first._presence._lose(host, "cut")
        first.remember("work", "r1", None)
        first._presence._greet("r1", host.life, "")
        assert told(first, FailuresKept) == []
        assert not any(first._failures.values()), "nothing is kept of them"
        deliver(first, "r1")
        with fleet.backend("r1", takes_over=True) as later:
            assert told(later, FailuresKept) == []


def test_a_host_that_joins_later_tells_of_the_failures_there_and_one_that_is_back_is_told_of_them() -> None:
    with small_fleet("r1", "r2") as fleet, fleet.backend("r1", "r2", library=[WORK]) as first:
        first.remember("work", "r2", FAILED)
        deliver(first, "r2")
        with fleet.backend("r1", library=[WORK], takes_over=True) as later:
            assert told(later, FailuresKept) == []
            later.take_hosts(["r2"])
            (kept,) = told(later, FailuresKept)
            assert isinstance(kept, FailuresKept) and kept.host == "r2"


def test_the_wait_after_a_failure_goes_on_while_a_host_is_away() -> None:
    with small_fleet("r1") as fleet, fleet.backend("r1", library=[WORK]) as first:
        first.remember("work", "r1", FAILED)
        first.leave_hosts(["r1"])
        first.now = lambda: time.monotonic() + 50.0  # type: ignore[method-assign]
        first.take_hosts(["r1"])
        told(first, HostJoined)
        deliver(first, "r1")
        with fleet.backend("r1", library=[WORK], takes_over=True) as later:
            (kept,) = told(later, FailuresKept)
            assert isinstance(kept, FailuresKept)
            assert 0 < kept.left_s <= FAILED.left_s - 50.0


def test_failures_end_with_their_run() -> None:
    with small_fleet("r1") as fleet:
        with fleet.backend("r1", library=[WORK]) as first:
            first.remember("work", "r1", FAILED)
            deliver(first, "r1")
        with fleet.backend("r1", library=[WORK]) as later:
            assert told(later, FailuresKept) == []


TALLY = worker("work", "Tally", run=RunOptions(state="altitude"))
COUNT, FIRST = unit("count.1", "r1"), unit("work.1", "r2", topic="/result", x="count.1/n")
SECOND = moved(FIRST, "work.2", "r1")
LATE = 1300
"""More elements than arrive while a new unit keeps all of them."""


@contextmanager
def stuck_handover(fleet: SmallFleet, *, is_given: bool) -> Iterator[Listener]:
    """A manager that replaces work.1 on r2 by work.2 on r1, and stops when work.2 waits for the state of work.1, or
    has it. Yields a listener to the topic of both.
    """
    stuck, may_end = threading.Event(), threading.Event()
    with fleet.runtime(source(), TALLY) as runtime:
        runtime.apply(ChangeSet(started=(COUNT, FIRST)))
        listener = fleet.outside_listener("r1")
        listener.await_more(20)
        backend = runtime.supervisor.backend
        give = backend.give_state

        def give_state(*given: Any) -> None:
            if is_given:
                give(*given)
                backend.wait(0.0)  # which sends it
            stuck.set()
            may_end.wait()

        def swapped() -> None:
            with suppress(RuntimeFaultError):
                runtime.apply(swap(FIRST, SECOND))

        backend.give_state = give_state  # type: ignore[method-assign]
        updating = threading.Thread(target=swapped)
        updating.start()
        try:
            assert stuck.wait(PATIENCE_S)
            yield listener
        finally:
            runtime.supervisor.end()
            may_end.set()
            updating.join()


@pytest.mark.parametrize("is_given", [False, True], ids=["undone", "finished"])
@pytest.mark.parametrize("late", [0, LATE], ids=["soon", "late"])
def test_a_handover_that_a_manager_has_left_is_undone_or_finished_without_losing_or_repeating_a_step(
    is_given: bool, late: int
) -> None:
    with small_fleet("r1", "r2") as fleet, stuck_handover(fleet, is_given=is_given) as listener:
        listener.await_more(late)
        with fleet.runtime(source(), TALLY, takes_over=True) as later:
            kept = SECOND if is_given else FIRST
            assert later.environment.unit.keys() == {"count.1", kept.id}
            later.apply(ChangeSet(rewired=() if later.environment.unit[kept.id] == kept else (kept,)))
            eventually(lambda: sorted(fleet.units()) == ["count.1", kept.id])
            listener.await_more(20)
            assert listener.values == list(range(listener.values[0], listener.values[0] + len(listener.values)))


class SingOrder(msgspec.Struct, tag=True):
    """An order of another version."""

    unit: str


def test_units_run_on_if_their_agent_can_not_read_an_order_and_the_run_says_what_to_install() -> None:
    with small_fleet("r1") as fleet:
        one = unit("count.1", "r1")
        with fleet.runtime(source()) as runtime:
            runtime.apply(ChangeSet(started=(one,)))
            (pid,) = fleet.pids("count")
            backend = runtime.supervisor.backend
            assert isinstance(backend, FleetBackend)

            def give() -> None:
                backend._presence.say("r1", cast("orders.Order", SingOrder("count.1")))
                backend.kill("count.1")

            runtime._executor.call(give)
            eventually(lambda: bool(seen(runtime, HostLost)))
            cause = seen(runtime, HostLost)[0].cause
            assert f"its agent has cfgplan {__version__}" in cause and "SingOrder" in cause
            assert f"this run has cfgplan {__version__}" in cause and "install the same version" in cause
            assert runtime.environment.units == ()
            assert fleet.pids("count") == [pid], "no order that came with it is carried out"
            with fleet.runtime(source()) as later:
                assert later.environment.units == (one,)
                assert fleet.pids("count") == [pid]


def test_a_run_whose_messages_have_other_fields_says_so_and_the_agent_serves_the_next_run(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with small_fleet("r1") as fleet:
        with monkeypatch.context() as other:
            other.setattr(orders, "digest_of_fields", lambda: "0123456789abcdef")
            with fleet.runtime(source()) as runtime:
                eventually(lambda: bool(seen(runtime, HostLost)))
                cause = seen(runtime, HostLost)[0].cause
                assert f"its agent has cfgplan {__version__} from other sources" in cause
                assert "install the same version" in cause
        with fleet.runtime(source()) as runtime:
            runtime.apply(ChangeSet(started=(unit("count.1", "r1"),)))
            assert len(fleet.pids("count")) == 1
