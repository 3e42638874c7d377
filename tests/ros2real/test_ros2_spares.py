"""Cold spares of ROS 2 nodes: lifecycle nodes are configured and wait, other nodes begin in a process that waits."""

from __future__ import annotations

import os
import queue
import signal
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import islice

import psutil
import pytest
from cfgplan_runtime import ApplyError, Runtime
from cfgplan_runtime.ros2.ros2_backend import Ros2Backend
from cfgplan_runtime.supervision.events import Event, SpareLost, SparePrepared, SpareUsed, UnitDied
from operated_world import PATIENCE_S, eventually
from ros2_words import NODES, Observer, command_of
from unit_signals import signal_unit

from cfgplan.domain import (
    ChangeSet,
    ComputationUnit,
    InputPort,
    OutputPort,
    Publication,
    RunOptions,
    Stream,
    Subscription,
    Target,
    Transformation,
)

STRING = "std_msgs/String"
TALKER = Transformation(
    "talker",
    (),
    (OutputPort("words", "Word", remap="chatter", type=STRING),),
    source="node:./talking.py talker",
    params={"rate": 100, "first": 1000},
)
WORKER = Transformation(
    "worker",
    (InputPort("quiet", "Word", type=STRING),),
    (OutputPort("loud", "LoudWord", remap="~loud", type=STRING),),
    source="node:./talking.py worker",
    run=RunOptions(lifecycle=True),
    standby_us=1,
)
SHOUTER = replace(WORKER, label="shouter", source="node:./talking.py shouter", run=RunOptions())
SHOUT = Target("shout", "LoudWord", "/shout")


@pytest.fixture
def backends() -> list[Ros2Backend]:
    """The backend that is made."""
    return []


@pytest.fixture
def runtime(backends: list[Ros2Backend]) -> Iterator[Runtime]:
    def make() -> Ros2Backend:
        backends.append(Ros2Backend(folder=NODES.parent))
        return backends[0]

    with Runtime(backend=make) as runtime:
        yield runtime


@pytest.fixture
def told(runtime: Runtime) -> Callable[[type[Event]], Event]:
    """The next event of a kind that is told."""
    heard: queue.SimpleQueue[Event] = queue.SimpleQueue()
    runtime.listen(heard.put)

    def next_of(kind: type[Event]) -> Event:
        return next(event for event in iter(lambda: heard.get(timeout=PATIENCE_S), None) if isinstance(event, kind))

    return next_of


def worker(of: str) -> ComputationUnit:
    feeds = (Subscription("quiet", Stream("talker.1", "words")),)
    return ComputationUnit(of, of.partition(".")[0], feeds, (Publication("loud", "/shout"),))


def begin(runtime: Runtime, transformation: Transformation) -> None:
    started = (ComputationUnit("talker.1", "talker"), worker(f"{transformation.label}.1"))
    runtime.apply(ChangeSet(started, added_transformations=(TALKER, transformation), added_targets=(SHOUT,)))


def processes(word: str) -> set[int]:
    """Children whose command line has this word."""
    children = psutil.Process().children(recursive=True)
    return {child.pid for child in children if any(word in part for part in command_of(child))}


def test_a_lifecycle_node_is_configured_and_activated(runtime: Runtime, observer: Observer) -> None:
    begin(runtime, WORKER)
    numbers = [int(shout.removesuffix("!")) for shout in islice(observer.listen("/shout"), 20)]
    assert numbers == list(range(numbers[0], numbers[0] + 20))


def test_a_lifecycle_node_that_can_not_be_configured_is_told_of(
    runtime: Runtime, told: Callable[[type[Event]], Event]
) -> None:
    cause = "/worker_1 could not be configured; its state is unconfigured"
    with pytest.raises(ApplyError, match=f"worker.1 refused a transition: {cause}"):
        begin(runtime, replace(WORKER, params={"lame": True}))
    assert told(UnitDied) == UnitDied("worker.1", cause, "refused a transition")


@pytest.mark.parametrize("transformation", [WORKER, SHOUTER], ids=["lifecycle", "warm"])
def test_a_spare_waits_and_is_the_unit_that_replaces_another(
    transformation: Transformation, runtime: Runtime, observer: Observer, told: Callable[[type[Event]], Event]
) -> None:
    label = transformation.label
    begin(runtime, transformation)
    shouts = observer.listen("/shout")
    next(shouts)
    runtime.apply(ChangeSet((ComputationUnit(f"{label}.2", label, standby=True),)))
    prepared = told(SparePrepared)
    assert isinstance(prepared, SparePrepared)
    assert prepared.unit == f"{label}.2"
    assert prepared.labor_us > 0
    waiting = processes("__node:=worker_2" if transformation is WORKER else "warm.py")
    signal_unit(runtime, f"{label}.1")
    told(UnitDied)
    runtime.apply(ChangeSet((worker(f"{label}.3"),)))
    assert told(SpareUsed) == SpareUsed(f"{label}.3", f"{label}.2")
    assert runtime.pid(f"{label}.3") in waiting
    reached = max(int(shout.removesuffix("!")) for shout in islice(shouts, 100))
    assert reached < int(next(shouts).removesuffix("!")), "the words go on"


def test_a_spare_that_dies_is_told_and_one_that_is_not_wanted_ends(
    runtime: Runtime, told: Callable[[type[Event]], Event]
) -> None:
    begin(runtime, WORKER)
    runtime.apply(ChangeSet((ComputationUnit("worker.2", "worker", standby=True),)))
    told(SparePrepared)
    (waiting,) = processes("__node:=worker_2")
    os.kill(waiting, signal.SIGKILL)
    lost = told(SpareLost)
    assert isinstance(lost, SpareLost)
    assert (lost.unit, lost.cause) == ("worker.2", "killed by SIGKILL")
    told(SparePrepared)
    runtime.apply(ChangeSet(stopped=("worker.2",)))
    eventually(lambda: not processes("__node:=worker_2"))


def test_a_process_waits_for_any_node_and_has_its_parameters_and_names(
    runtime: Runtime, backends: list[Ros2Backend], observer: Observer, told: Callable[[type[Event]], Event]
) -> None:
    begin(runtime, SHOUTER)
    shouts = observer.listen("/shout")
    eventually(lambda: backends[0].has_warm)
    waiting = processes("warm.py")
    numbers = (int(shout.removesuffix("!")) for shout in islice(shouts, 2000))
    before_death = next(number for number in numbers if number >= 1100)
    signal_unit(runtime, "talker.1")
    told(UnitDied)
    runtime.apply(ChangeSet((ComputationUnit("talker.2", "talker"),), rewired=(fed_by("talker.2"),)))
    assert runtime.pid("talker.2") in waiting
    eventually(lambda: "/talker_2" in observer.look()["nodes"])
    assert next(number for number in numbers if number < before_death) >= 1000, "it begins anew, with its parameter"


def fed_by(talker: str) -> ComputationUnit:
    return replace(worker("shouter.1"), subscriptions=(Subscription("quiet", Stream(talker, "words")),))
