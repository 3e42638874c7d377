"""The life-cycle on a middleware that cfgplan knows nothing of: the manual's worked example, carried out."""

from __future__ import annotations

import re
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, get_args

import pytest
from cfgplan_runtime import Manager, Policy, SimulatedRuntime, UnitDied
from cfgplan_runtime.errors import ApplyError, RuntimeFaultError, StaleChangeSetError
from cfgplan_runtime.lifecycle.changes import Add, KillUnit
from cfgplan_runtime.lifecycle.reports import Decision, Ended, Report
from cfgplan_runtime.supervision.simulated_backend import Behaviour
from cfgplan_runtime.testing import CHECKS, ENDING_CHECKS, HOST_CHECKS, Bench, Hosts, check_middleware
from real_bench import real_bench
from real_run import PROGRAMS
from simulated_life import RESULT, source, worker

from cfgplan import api
from cfgplan.domain import ChangeSet, Environment, RunOptions, Target, Transformation
from cfgplan.errors import InvalidValueError
from cfgplan.planners import PLANNERS
from cfgplan.transformations import ProgramFormat

MIDDLEWARE = (Path(__file__).parents[2] / "cfgplan" / "manual" / "middleware.md").read_text(encoding="utf-8")
FORMATS: tuple[ProgramFormat, ...] = get_args(ProgramFormat)
WORLD = api.world(Environment((), (source(), worker()), (RESULT,)), horizon_s=60)


class FakeRobot:
    """A nodelet manager: what is loaded, and what is remapped to what. Elements come where all that is needed is."""

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

    def gives(self, topic: str) -> bool:
        return topic in self.wires and self._flows(self.wires[topic])

    def _flows(self, stream: str) -> bool:
        name, _, _ = stream.rpartition("/")
        if name not in self.loaded:
            return False
        inlet = f"{name}/x"
        return self.loaded[name] == "units.py:count" or (inlet in self.wires and self._flows(self.wires[inlet]))

    def fed(self) -> dict[str, set[str]]:
        return {inlet: {stream} for inlet, stream in self.wires.items()}


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

    def wait(self, waker: threading.Event, timeout_s: float) -> None:
        if not waker.is_set():
            self.time_s += timeout_s


def instead(method: str, change: Callable[..., Any]) -> Callable[[FakeRobot, Any], None]:
    """Breaks a middleware: its `method` becomes `change(middleware, the method, ...)`."""

    def break_(_: FakeRobot, middleware: Any) -> None:
        whole = getattr(middleware, method)
        setattr(middleware, method, lambda *arguments, **more: change(middleware, whole, *arguments, **more))

    return break_


def of_robot(method: str, change: Callable[..., Any]) -> Callable[[FakeRobot, Any], None]:
    """Breaks what a middleware asks of the robot."""

    def break_(robot: FakeRobot, _: Any) -> None:
        whole = getattr(robot, method)
        setattr(robot, method, lambda *arguments: change(robot, whole, *arguments))

    return break_


def half_undone(middleware: Any, apply: Any, change_set: ChangeSet, **more: Any) -> Any:
    """Leaves loaded what an update that failed had loaded."""
    try:
        return apply(change_set, **more)
    except ApplyError:
        for unit in change_set.started:
            if unit.transformation == "work" and not middleware.robot.has(unit.id):
                middleware.robot.load(unit.id, "units.py:work")
        raise


def raising_another(_: Any, apply: Any, change_set: ChangeSet, **more: Any) -> Any:
    """Raises an error of the robot's own."""
    try:
        return apply(change_set, **more)
    except ApplyError as error:
        raise RuntimeFaultError("the robot failed") from error


def without_names(_: Any, apply: Any, change_set: ChangeSet, **more: Any) -> Any:
    try:
        return apply(change_set, **more)
    except ApplyError as error:
        raise ApplyError(error.cause) from None


def forgetful(middleware: Any, apply: Any, change_set: ChangeSet, **more: Any) -> Any:
    """Forgets what targets there are."""
    applied = apply(change_set, **more)
    middleware.environment = replace(middleware.environment, targets=())
    return applied


def deaf_to_rewiring(_: Any, apply: Any, change_set: ChangeSet, **more: Any) -> Any:
    return apply(replace(change_set, rewired=()), **more)


def dying_twice(middleware: Any, lose: Any, unit: str) -> None:
    lose(unit)
    middleware.tell(UnitDied(unit, "once more"))


def without_gap(middleware: Any, _: Any, unit: str) -> None:
    """A dead unit is still said to feed others."""
    left = tuple(each for each in middleware.environment.units if each.id != unit)
    middleware.environment = replace(middleware.environment, units=left)
    middleware.tell(UnitDied(unit, "it crashed"))


def on_its_way(middleware: Any, wire: Any, wanted: Any) -> None:
    """Wires are wanted as before at inputs that are wired."""
    wire({inlet: middleware.wires.get(inlet, stream) for inlet, stream in wanted.items()})


MUTANTS: dict[str, tuple[str, Callable[[FakeRobot, Any], None]]] = {
    "connects nothing": ("a topic that a unit publishes on|other wires", of_robot("remap", lambda *_: None)),
    "connects only topics": (
        "other wires",
        of_robot("remap", lambda _, remap, name, to: remap(name, to) if name.startswith("/") else None),
    ),
    "drops publications": (
        "a topic that a unit publishes on is not there",
        of_robot("remap", lambda _, remap, name, to: None if name.startswith("/") else remap(name, to)),
    ),
    "ignores rewires, and does not say so": ("other wires", instead("wire", on_its_way)),
    "ignores rewires": ("the environment is another one", instead("apply", deaf_to_rewiring)),
    "connects another stream": (
        "other wires",
        of_robot("remap", lambda _, remap, name, to: remap(name, "count.9/n" if name.startswith("work") else to)),
    ),
    "leaves old wires": ("other wires|is still there", of_robot("unmap", lambda *_: None)),
    "returns nothing": ("returned None", instead("apply", lambda _, apply, *a, **m: (apply(*a, **m), None)[1])),
    "stops nothing": ("other units run", of_robot("unload", lambda *_: None)),
    "starts under another name": (
        "other units run",
        of_robot("load", lambda _, load, name, code: load(name.replace("work.2", "work.3"), code)),
    ),
    "does not undo": ("other units run", instead("apply", half_undone)),
    "raises another error": ("raised RuntimeFaultError, which it does not promise", instead("apply", raising_another)),
    "does not name what failed": ("does not name the unit", instead("apply", without_names)),
    "takes what is stale": (
        "raises no StaleChangeSetError",
        instead("apply", lambda _, apply, change_set, **more: apply(change_set, **{**more, "basis": None})),
    ),
    "forgets targets": ("another targets", instead("apply", forgetful)),
    "never tells of deaths": ("is never told", instead("listen", lambda _, listen, __: listen(lambda _: None))),
    "tells of a death twice": ("is told 2 times", instead("lose", dying_twice)),
    "leaves no gap": ("the environment is another one", instead("lose", without_gap)),
    "does not tell of those that it kills": ("is never told", instead("kill", lambda m, _, unit: m.robot.unload(unit))),
    "observes nothing": ("tells of other units", instead("observe", lambda *_: [])),
    "observes negative costs": ("a negative cost", of_robot("cpu_us", lambda *_: (-1, 3))),
    "abandon stops everything": ("the environment is another one", instead("abandon", lambda m, _: m.stop())),
    "goes on after stop": ("after stop", instead("stop", lambda *_: None)),
}
"""Middlewares that are right but for one thing, and the words of the promise that each breaks."""
ONLY_BY_WIRES = {"leaves old wires"}


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


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"world": WORLD.environment}, "world must be a World, but is an Environment"),
        ({"planner": "cpsat"}, "planner must be a function or None, but is 'cpsat'"),
        ({"policy": 3}, "policy must be a Policy or None, but is 3"),
    ],
)
def test_a_part_of_another_kind_is_refused_at_once(wrong: dict[str, Any], said: str) -> None:
    with SimulatedRuntime() as runtime, pytest.raises(InvalidValueError, match=rf"Manager\(\): {said}"):
        Manager(**{"world": WORLD, "middleware": runtime, **wrong})


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
def bench_of_nodelets(
    make: Callable[[FakeRobot], Any] = nodelets, *, patience_s: float = 30.0, has_wires: bool = True
) -> Iterator[Bench]:
    robot = FakeRobot()
    yield Bench(
        make(robot),
        source(),
        worker(),
        worker("broken", source="broken"),
        robot.crash,
        lambda: robot.loaded,
        lambda: robot.wires.keys(),
        robot.gives,
        wires=robot.fed if has_wires else None,
        patience_s=patience_s,
    )


@contextmanager
def simulated_bench() -> Iterator[Bench]:
    runtime = SimulatedRuntime(behaviours={"broken": Behaviour(dies_at_start="no camera")})

    def wait(seconds: float) -> None:
        runtime.clock.wait(threading.Event(), seconds)

    def wires() -> dict[str, set[str]]:
        """The streams that feed the inlets of units and topics that there are."""
        inlets = {inlet for _, inlet in runtime.backend.wires.values()}
        fed = {inlet: runtime.backend.feeding(inlet) for inlet in inlets}
        return {inlet.port if inlet.is_outlet else str(inlet): {str(each)} for inlet, each in fed.items() if each}

    def gives(inlet: str) -> bool:
        return any(
            stream.rpartition("/")[0] in runtime.backend.units
            and (stream.startswith("count") or gives(f"{stream.rpartition('/')[0]}/x"))
            for stream in wires().get(inlet, ())
        )

    yield Bench(
        runtime,
        source(),
        worker(),
        worker("broken"),
        runtime.backend.fail,
        lambda: [unit.id for unit in runtime.environment.units if unit.id in runtime.backend.units],
        lambda: runtime.backend.topics,
        gives,
        wait,
        Hosts("near", "far", runtime.backend.lose_host, runtime.backend.join_host),
        wires,
    )


@pytest.mark.parametrize("make", [bench_of_nodelets, simulated_bench])
def test_a_middleware_keeps_its_promises(make: Callable[[], AbstractContextManager[Bench]]) -> None:
    check_middleware(make)


@pytest.fixture
def own_runs(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs have a folder of their own."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path_factory.mktemp("r")))


@pytest.mark.usefixtures("own_runs")
def test_the_runtime_keeps_its_promises(tmp_path: Path) -> None:
    check_middleware(lambda: real_bench(tmp_path, "units.py:Worker", RunOptions()))


@pytest.mark.usefixtures("own_runs")
@pytest.mark.parametrize("seed", range(len(FORMATS)), ids=FORMATS)
def test_the_runtime_keeps_its_promises_with_programs(seed: int, tmp_path: Path) -> None:
    """A push takes one of the formats, the night all: `tests/runtime` tests what they differ in."""
    form = FORMATS[seed]
    check_middleware(lambda: real_bench(tmp_path, PROGRAMS[form], RunOptions(format=form)))


def test_without_wires_a_middleware_is_checked_by_its_elements() -> None:
    check_middleware(partial(bench_of_nodelets, has_wires=False))


def test_no_middleware_is_made_for_promises_that_its_bench_leaves_out() -> None:
    made = []

    def make(robot: FakeRobot) -> Any:
        made.append(robot)
        return nodelets(robot)

    check_middleware(partial(bench_of_nodelets, make))
    assert len(made) == len(CHECKS) - len(HOST_CHECKS) - len(ENDING_CHECKS)


@pytest.mark.parametrize("has_wires", [True, False])
@pytest.mark.parametrize("name", MUTANTS)
def test_the_kit_catches_a_broken_middleware(name: str, has_wires: bool) -> None:
    if not has_wires and name in ONLY_BY_WIRES:
        pytest.skip("only who sees wires can tell")
    promise, break_ = MUTANTS[name]

    def make(robot: FakeRobot) -> Any:
        middleware = nodelets(robot)
        break_(robot, middleware)
        return middleware

    with pytest.raises(AssertionError, match=promise if has_wires else None):
        check_middleware(partial(bench_of_nodelets, make, patience_s=0.05, has_wires=has_wires))


def test_without_its_middleware_a_manager_ends_and_tells_who_waits() -> None:
    middleware = nodelets(FakeRobot())
    reports: list[Report] = []
    with Manager(WORLD, middleware, report=reports.append) as manager:
        assert manager.settle(60)

        def closed(*_: Any, **__: Any) -> Any:
            raise RuntimeFaultError("the runtime is closed")

        middleware.apply = closed
        with pytest.raises(RuntimeFaultError, match="the run has ended"):
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
        with pytest.raises(RuntimeFaultError, match="the run has ended"):
            outcome.result(60)
