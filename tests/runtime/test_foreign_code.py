"""Foreign code that raises: backends, listeners and estimators. What was begun is undone or carried out, and told."""

from __future__ import annotations

import logging
import threading
from typing import Any

import pytest
from cfgplan_runtime import ApplyError, SimulatedRuntime
from cfgplan_runtime.lifecycle.guarded_estimator import GuardedEstimator
from cfgplan_runtime.lifecycle.seams import DeclaredCosts
from cfgplan_runtime.supervision.backend import Inlet
from cfgplan_runtime.supervision.events import Event
from cfgplan_runtime.supervision.simulated_backend import Behaviour
from world import RESULT, source, start, unit, worker

from cfgplan.domain import ChangeSet, Environment

COUNT, WORK = unit("count.1"), unit("work.1", topic="/result", x="count.1/n")
SWAP = ChangeSet(started=(unit("work.2", topic="/result", x="count.1/n"),), stopped=("work.1",))
ORDERS = ("start", "stop", "kill", "connect", "disconnect", "end_wire", "switch_now", "open_outlet", "close_outlet")


def running() -> SimulatedRuntime:
    runtime = SimulatedRuntime((source(), worker()), (RESULT,))
    runtime.apply(start(COUNT, WORK))
    return runtime


def fail_at(runtime: SimulatedRuntime, number: int) -> list[str]:
    """Let the call of this number of a backend's order raise. Returns the orders that are called, as they are."""
    called: list[str] = []
    for name in ORDERS:
        order = getattr(runtime.backend, name)

        def call(*given: Any, name: str = name, order: Any = order, **more: Any) -> None:
            called.append(name)
            if len(called) == number:
                raise OSError(28, "No space left on device")
            order(*given, **more)

        setattr(runtime.backend, name, call)
    return called


def wires(environment: Environment) -> set[tuple[str, str]]:
    fed = {(f"{one.id}/{each.port}", str(each.stream)) for one in environment.units for each in one.subscriptions}
    return fed | {(each.topic, f"{one.id}/{each.port}") for one in environment.units for each in one.publications}


def really(runtime: SimulatedRuntime) -> set[tuple[str, str]]:
    inlets = {inlet for _, inlet in runtime.backend.wires.values()}
    return {(str(inlet), str(fed)) for inlet in inlets if (fed := runtime.backend.feeding(inlet)) is not None}


def test_a_backend_may_raise_at_any_order_and_what_is_believed_is_what_runs() -> None:
    outcomes: set[bool] = set()
    number = 0
    while True:
        number += 1
        runtime = running()
        before = runtime.environment
        called = fail_at(runtime, number)
        try:
            runtime.apply(SWAP)
            outcomes.add(True)
            assert set(runtime.environment.unit) == {"count.1", "work.2"}
        except ApplyError as error:
            outcomes.add(False)
            assert "No space left on device" in str(error)
            assert (runtime.environment, runtime.supervisor.alive) == (before, {"count.1", "work.1"})
        if len(called) < number:
            break
        assert set(runtime.environment.unit) <= set(runtime.backend.units), called
        if called[number - 1] in ("start", "connect"):
            assert set(runtime.environment.unit) == set(runtime.backend.units), called
            assert wires(runtime.environment) == really(runtime), called
        runtime.apply(ChangeSet(started=(unit("work.3"),)))
        assert "work.3" in runtime.backend.units
    assert outcomes == {True, False}


@pytest.mark.parametrize(
    "other",
    [Behaviour(dies_at_start="no camera"), Behaviour(dies_s=0.1, quiet=True)],
    ids=["at its start", "when it is connected"],
)
def test_a_backend_may_raise_while_an_update_is_undone_since_a_unit_has_died(other: Behaviour) -> None:
    number = 0
    while True:
        number += 1
        runtime = SimulatedRuntime((source(), worker(), worker("other")), (RESULT,), behaviours={"other": other})
        runtime.apply(start(COUNT, WORK))
        called = fail_at(runtime, number)
        with pytest.raises(ApplyError):
            runtime.apply(ChangeSet(started=(unit("other.1", topic="/result", x="count.1/n"),), stopped=("work.1",)))
        assert runtime.supervisor.alive - {"other.1"} == set(runtime.environment.unit) == {"count.1", "work.1"}
        if len(called) < number:
            break
    assert number > 3


def test_the_first_update_is_undone_too() -> None:
    for number in range(1, 5):
        runtime = SimulatedRuntime((source(), worker()), (RESULT,))
        fail_at(runtime, number)
        with pytest.raises(ApplyError, match="No space left"):
            runtime.apply(start(COUNT, WORK))
        assert (runtime.environment.units, runtime.supervisor.alive, runtime.backend.units) == ((), set(), {})
        runtime.apply(start(COUNT, WORK))
        assert runtime.backend.feeding(Inlet("", "/result")) is not None


def test_a_listener_that_raises_is_told_of_once_and_keeps_nobody_from_hearing(caplog: pytest.LogCaptureFixture) -> None:
    runtime = SimulatedRuntime((source(), worker()), (RESULT,))
    heard: list[Event] = []

    def dashboard(event: Event) -> None:  # noqa: ARG001
        raise ValueError("a bug of the dashboard")

    runtime.listen(dashboard)
    runtime.listen(heard.append)
    with caplog.at_level(logging.ERROR, "cfgplan"):
        runtime.apply(start(COUNT, WORK))
        runtime.backend.fail("work.1")
        runtime.clock.wait(threading.Event(), 1.0)
    assert set(runtime.environment.unit) == {"count.1"}
    assert len(heard) > 3
    assert len([record for record in caplog.records if "dashboard" in record.getMessage()]) == 1


class Bad(DeclaredCosts):
    """Raises, or gives no cost, at every call."""

    def observe(self, *_: object) -> None:
        raise ZeroDivisionError("a bug of the estimator")

    failed = observe

    def labor_us(self, *_: object) -> Any:
        return "cheap"

    def upkeep_us(self, *_: object) -> Any:
        return -1


def test_an_estimator_that_raises_is_replaced_by_what_is_declared() -> None:
    guarded, transformation = GuardedEstimator(Bad()), worker()
    assert guarded.warning == ""
    guarded.observe((), 0.0)
    assert (
        guarded.warning
        == "the estimator has failed (ZeroDivisionError: a bug of the estimator): declared costs are used"
    )
    guarded.failed("work", 1.0)
    assert guarded.labor_us(transformation, 60) == transformation.labor_us
    assert guarded.upkeep_us(transformation, 60) == transformation.upkeep_us
    assert "-1 is not a cost" in guarded.warning
