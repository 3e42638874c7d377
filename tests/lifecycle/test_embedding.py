"""The life-cycle on a middleware that cfgplan knows nothing of: the manual's worked example, carried out."""

from __future__ import annotations

import os
import re
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

import pytest
from cfgplan_runtime import Manager, Policy, Runtime, SimulatedRuntime, testing
from cfgplan_runtime.errors import ApplyError, RuntimeFaultError, StaleChangeSetError
from cfgplan_runtime.lifecycle.changes import Add, KillUnit
from cfgplan_runtime.lifecycle.reports import Decision, Ended, Report
from cfgplan_runtime.streams.run_folder import base_folder, topics_of
from cfgplan_runtime.supervision.simulated_backend import Behaviour
from cfgplan_runtime.testing import FIRST, LAST, Bench, Hosts, check_middleware
from living import RESULT, source, worker
from real_run import UNITS

from cfgplan import api
from cfgplan.domain import Environment, RunOptions, Target, Transformation
from cfgplan.planners import PLANNERS

MIDDLEWARE = (Path(__file__).parents[2] / "cfgplan" / "manual" / "middleware.md").read_text(encoding="utf-8")
WORLD = api.world(Environment((), (source(), worker()), (RESULT,)), horizon_s=60)


class FakeRobot:
    """A nodelet manager: what is loaded, and what is remapped to what."""

    def __init__(self) -> None:
        self.loaded: dict[str, str] = {}
        self.wires: dict[str, str] = {}
        self.on_crash: Callable[[str], None]

    def load(self, name: str, code: str) -> None:
        if code == "broken":
            raise OSError("no such nodelet")
        assert name not in self.loaded
        self.loaded[name] = code

    def has(self, name: str) -> bool:
        return name in self.loaded

    def unload(self, name: str) -> None:
        del self.loaded[name]

    def remap(self, name: str, to: str) -> None:
        self.wires[name] = to

    def unmap(self, name: str) -> None:
        del self.wires[name]

    def cpu_us(self, name: str) -> tuple[int, int]:
        return 1000, 500 if name.startswith("work") else 100

    def crash(self, name: str) -> None:
        del self.loaded[name]
        self.on_crash(name)


def nodelets(robot: FakeRobot) -> Any:
    """An instance of the class that the manual shows."""
    names: dict[str, Any] = {}
    (shown,) = re.findall(r"```python\n(.*?)```", MIDDLEWARE, re.DOTALL)
    exec(shown, names)
    return names["Nodelets"](robot)


class SetClock:
    """A clock that is set by waiting."""

    def __init__(self) -> None:
        self.time_s = 0.0

    def now(self) -> float:
        return self.time_s

    def wait(self, bell: threading.Event, timeout_s: float) -> None:
        if not bell.is_set():
            self.time_s += timeout_s


def test_a_foreign_middleware_is_kept_the_best_it_can_be() -> None:
    robot = FakeRobot()
    with Manager(WORLD, nodelets(robot)) as manager:
        assert manager.settle(60)
        assert robot.loaded == {"count.1": "units.py:count", "work.1": "units.py:work"}
        assert robot.wires == {"work.1/x": "count.1/n", "/result": "work.1/y"}
        robot.crash("count.1")
        assert manager.settle(60)
        assert set(robot.loaded) == {"count.1", "work.1"}
        assert manager.request(KillUnit("work.1")).result(60).decision is Decision.APPLIED  # type: ignore[union-attr]
        manager.request(Add(targets=(Target("numbers", "N", "/numbers"),))).result(60)
        assert robot.wires["/numbers"] == "count.1/n"
    assert robot.loaded == {}


def test_every_part_can_be_replaced() -> None:
    class Thrifty:
        """Believes what was observed last."""

        def __init__(self) -> None:
            self.known: dict[str, int] = {}

        def observe(self, observations: Any, now_s: float) -> None:  # noqa: ARG002
            self.known |= {seen.transformation: seen.upkeep_us for seen in observations}

        def failed(self, transformation: str, now_s: float) -> None: ...

        def labor_us(self, transformation: Transformation, horizon_s: int) -> int:  # noqa: ARG002
            return 0

        def upkeep_us(self, transformation: Transformation, horizon_s: int) -> int:  # noqa: ARG002
            return self.known.get(transformation.label, 300)

    robot, clock = FakeRobot(), SetClock()
    library = (source(), worker(), worker("work_unknown"))
    world = api.world(Environment((), library, (RESULT,)), horizon_s=60)
    planner = PLANNERS["exhaustive"]
    manager = Manager(world, nodelets(robot), planner=planner, estimator=Thrifty(), clock=clock, policy=Policy())
    manager.run(50)
    assert set(robot.loaded) == {"count.1", "work.1"}
    manager.run(20)  # the horizon: 500 us/s were observed of work, 300 are guessed of the other
    assert set(robot.loaded) == {"count.1", "work_unknown.1"}
    assert manager.snapshot().reviews[-1].cost_us == 60 * (300 + 100)


def test_a_middleware_that_refuses_once_is_asked_again() -> None:
    middleware = nodelets(FakeRobot())
    apply, refusals = middleware.apply, [StaleChangeSetError("not now"), ApplyError("the robot said no")]

    def refusing(*arguments: Any, **more: Any) -> Any:
        if refusals:
            raise refusals.pop(0)
        return apply(*arguments, **more)

    middleware.apply = refusing
    manager = Manager(WORLD, middleware, clock=SetClock())
    manager.run(5)
    assert [review.decision for review in manager.snapshot().reviews] == [
        Decision.FAILED,
        Decision.FAILED,
        Decision.APPLIED,
    ]


def test_a_middleware_with_a_fault_of_its_own_does_not_end_the_life_cycle() -> None:
    middleware = nodelets(FakeRobot())
    apply, crashes = middleware.apply, [ZeroDivisionError("a bug of the middleware")]

    def crashing(*arguments: Any, **more: Any) -> Any:
        if crashes:
            raise crashes.pop()
        return apply(*arguments, **more)

    middleware.apply = crashing
    manager = Manager(WORLD, middleware, clock=SetClock())
    manager.run(5)
    first, last = manager.snapshot().reviews
    assert (first.decision, first.cause) == (
        Decision.FAILED,
        "the middleware failed: ZeroDivisionError: a bug of the middleware",
    )
    assert last.decision is Decision.APPLIED


def test_a_manager_is_settled_though_its_middleware_keeps_failing() -> None:
    middleware = nodelets(FakeRobot())

    def crashing(*_: Any, **__: Any) -> Any:
        raise ZeroDivisionError("a bug of the middleware")

    middleware.apply = crashing
    manager = Manager(WORLD, middleware)
    manager.start()
    try:
        assert manager.settle(60)
        assert manager.snapshot().reviews[-1].decision is Decision.FAILED
    finally:
        manager.close()


@contextmanager
def bench_of_nodelets() -> Iterator[Bench]:
    robot = FakeRobot()
    broken = worker("broken", source="broken")
    yield Bench(
        nodelets(robot), source(), worker(), broken, robot.crash, lambda: robot.loaded, lambda: robot.wires.keys()
    )


@contextmanager
def simulated_bench() -> Iterator[Bench]:
    runtime = SimulatedRuntime(behaviours={"broken": Behaviour(dies_at_start="no camera")})

    def wait(seconds: float) -> None:
        runtime.clock.wait(threading.Event(), seconds)

    yield Bench(
        runtime,
        source(),
        worker(),
        worker("broken"),
        runtime.backend.fail,
        lambda: [unit.id for unit in runtime.environment.units if unit.id in runtime.backend.units],
        lambda: runtime.backend.topics,
        wait,
        Hosts("near", "far", runtime.backend.lose_host, runtime.backend.join_host),
    )


@contextmanager
def real_bench(folder: Path) -> Iterator[Bench]:
    (folder / "units.py").write_text(UNITS)
    code, params = "units.py:Worker", {"name": "x"}
    with Runtime(folder=folder) as runtime:
        yield Bench(
            runtime,
            source(source="units.py:count", run=RunOptions(rate_hz=100)),
            worker(source=code, params=params),
            worker("broken", source=code, params={**params, "deed": "die at start"}),
            lambda unit: os.kill(runtime.pid(unit) or 0, signal.SIGKILL),
            lambda: [name for name in ("count.1", "work.1", "work.2", FIRST, LAST) if runtime.pid(name) is not None],
            lambda: topics_of(base_folder() / runtime.id),
        )


@pytest.mark.parametrize("make", [bench_of_nodelets, simulated_bench])
def test_a_middleware_keeps_its_promises(make: Callable[[], AbstractContextManager[Bench]]) -> None:
    check_middleware(make)


def test_the_runtime_keeps_its_promises(
    tmp_path: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path_factory.mktemp("r")))
    check_middleware(lambda: real_bench(tmp_path))


@pytest.mark.parametrize(
    ("method", "broken", "promise"),
    [
        ("unmap", lambda *_: None, "is still there"),
        ("unload", lambda *_: None, "other units run"),
        ("crash", lambda *_: None, "is never told"),
    ],
)
def test_the_kit_names_the_promise_that_is_not_kept(
    monkeypatch: pytest.MonkeyPatch, method: str, broken: Callable[..., None], promise: str
) -> None:
    monkeypatch.setattr(FakeRobot, method, broken)
    monkeypatch.setattr(testing, "PATIENCE_S", 0.1)
    with pytest.raises(AssertionError, match=promise):
        check_middleware(bench_of_nodelets)


def test_without_its_middleware_a_manager_ends_and_tells_who_waits() -> None:
    middleware = nodelets(FakeRobot())
    reports: list[Report] = []
    with Manager(WORLD, middleware, report=reports.append) as manager:
        assert manager.settle(60)

        def closed(*_: Any, **__: Any) -> Any:
            raise RuntimeFaultError("the runtime is closed")

        middleware.apply = closed
        with pytest.raises(RuntimeFaultError, match="the manager has ended"):
            manager.request(Add(targets=(Target("numbers", "N", "/numbers"),))).result(60)
        assert manager.wait(60)
    assert reports[-1] == Ended("the runtime is closed")


def test_who_asked_together_with_what_goes_wrong_is_told_too() -> None:
    middleware = nodelets(FakeRobot())
    manager = Manager(WORLD, middleware)
    while not manager.is_settled:
        manager.step(1.0)

    def closed(_: str) -> None:
        raise RuntimeFaultError("the robot is gone")

    middleware.kill = closed
    outcomes = [manager.request(change) for change in (KillUnit("work.1"), Add(targets=()), KillUnit("count.1"))]
    manager.start()
    for outcome in outcomes:
        with pytest.raises(RuntimeFaultError, match="the manager has ended"):
            outcome.result(60)
