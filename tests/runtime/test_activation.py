"""A started unit gives nothing before all its streams are connected, so that no first element is lost.

The start of a unit beside a source is held up until a source that began too early would have given elements.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import get_args

import pytest
from cfgplan_runtime import Runtime
from cfgplan_runtime.children.messages import Activate, Deactivate, Finish, HoldSteps, TakeState
from cfgplan_runtime.children.unit_child import UnitChild
from cfgplan_runtime.streams.channel import Receiver, Sender, socket_pair
from cfgplan_runtime.streams.element import Element
from cfgplan_runtime.streams.payload import PayloadEncoder, decode
from cfgplan_runtime.supervision.events import Event, UnitDied, UnitStatus
from mosquitto import NEEDS_MOSQUITTO, running
from program_units import provider
from unit_signals import signal_unit
from watching import Listener, StartRuntime, seen
from world import child_of, eventually, source, start, unit, worker

from cfgplan.domain import ChangeSet, ComputationUnit, OutputPort, RunOptions, Transformation
from cfgplan.transformations import ProgramFormat

NUMBERS = Transformation("give", outputs=(OutputPort("n", "N"),), source="running_units.py:count")
WORK = worker(run=RunOptions(blocks=True))
GIVEN, WORKED = unit("give.1"), unit("work.1", topic="/result", x="give.1/n")


def connect(child: UnitChild, port: str) -> Receiver:
    sender, receiver = socket_pair()
    child._ports.add_sender(port, Sender(sender, queue=10, blocks=False))
    return Receiver(receiver)


@pytest.mark.parametrize("transformation", [NUMBERS, source("give"), worker()], ids=["source", "at a rate", "worker"])
def test_the_first_step_waits_until_the_unit_is_told_to_begin(transformation: Transformation) -> None:
    (port,) = (output.name for output in transformation.outputs)
    with child_of(transformation) as child:
        if transformation.inputs:
            child._steps.put("x", Element(1, 0, 0, b"".join(PayloadEncoder().encode(0))), may_drop=True)
        child._work()
        assert child.step == 0
        receiver = connect(child, port)
        child._obey(Activate(), [])
        child._work()
        assert decode(next(receiver.read()).payload) == 0
        receiver.close()


@pytest.mark.parametrize("code", ["twice", "same"])
def test_a_unit_that_pauses_gives_nothing_and_then_what_has_waited(code: str) -> None:
    with child_of(worker(code=code)) as child:
        receiver = connect(child, "y")
        child._obey(Activate(), [])
        for number in range(3):
            child._steps.put("x", Element(number, 0, 0, b"".join(PayloadEncoder().encode(number))), may_drop=True)
        assert child._pending is not None
        child._begin(child._pending)
        before = [decode(one.payload) for one in receiver.read()]
        child._obey(Deactivate(), [])
        child._work()
        assert list(receiver.read()) == []
        child._status_ns = time.monotonic_ns() + 10**12
        assert child._patience_s() > 0.0, "it waits"
        child._obey(Activate(), [])
        child._work()
        given = before + [decode(one.payload) for one in receiver.read()]
        assert given == ([0, 0, 1, 1, 2, 2] if code == "twice" else [0, 1, 2])
        receiver.close()


def test_a_unit_tells_no_state_before_it_begins_or_while_it_waits_for_one() -> None:
    """Its state would replace the newer one of the unit that still works in its place."""
    with child_of(worker("tally", "Tally", run=RunOptions(state=True))) as child:
        signs = list[bool]()
        child._ports.say = lambda sign: signs.append(sign.state is not None)  # type: ignore[method-assign, union-attr]
        for message in (None, Activate(), HoldSteps(), TakeState(None, {}, {}), Deactivate(), Finish()):
            if message is not None:
                child._obey(message, [])
            child._say_status()
        assert signs == [False, True, False, True, False, False]


def test_a_unit_that_is_told_to_end_before_it_begins_makes_the_steps_of_its_elements() -> None:
    with child_of(worker()) as child:
        child._steps.put("x", Element(1, 0, 0, b"".join(PayloadEncoder().encode(7))), may_drop=True)
        receiver = connect(child, "y")
        child._obey(Finish(), [])
        child._work()
        assert [decode(one.payload) for one in receiver.read()] == [7]
        receiver.close()


def apply_slowly(runtime: Runtime, note: Path, *started: ComputationUnit) -> Listener:
    """Start GIVEN to feed WORKED, beside a unit that is ready after two signs of life of GIVEN, seconds later."""
    signs = list[Event]()
    change_set = ChangeSet((GIVEN, unit("slow.1", x="give.1/n"), *started), rewired=() if started else (WORKED,))
    runtime.listen(signs.append)
    with ThreadPoolExecutor(1) as pool:
        applying = pool.submit(runtime.apply, change_set)
        listener = Listener("/result")
        eventually(lambda: sum(isinstance(one, UnitStatus) and one.unit == "give.1" for one in list(signs)) > 1)
        note.touch()
        applying.result()
    return listener


def run_with(run_units: StartRuntime, given: Transformation, note: Path) -> Runtime:
    return run_units(given, WORK, worker("slow", "SlowToConstruct", note=str(note)))


@pytest.mark.parametrize(
    "given",
    [
        NUMBERS,
        source("give"),
        *(provider(form, "own pace") for form in get_args(ProgramFormat)),
    ],
    ids=["source", "at a rate", *(f"program, {form}" for form in get_args(ProgramFormat))],
)
def test_a_source_loses_nothing_while_another_unit_of_its_update_starts_slowly(
    given: Transformation, run_units: StartRuntime, tmp_path: Path
) -> None:
    given = replace(given, run=replace(given.run, blocks=True))
    listener = apply_slowly(run_with(run_units, given, tmp_path / "note"), tmp_path / "note", WORKED)
    eventually(lambda: len(listener.received) > 5)
    assert listener.values[:5] == [0, 1, 2, 3, 4]


@NEEDS_MOSQUITTO
@pytest.mark.xdist_group("mqtt")
@pytest.mark.parametrize("is_replaced", [False, True], ids=["retained", "kept for its session"])
def test_messages_that_a_broker_keeps_come_though_another_unit_starts_slowly(
    is_replaced: bool, run_units: StartRuntime, tmp_path: Path
) -> None:
    pytest.importorskip("paho", reason="paho-mqtt is not installed (extra mqtt)")
    from paho.mqtt.publish import multiple

    with running(tmp_path) as broker:
        params = {"broker": broker.name, "topic": "in/+", "with_topic": False}
        given = replace(NUMBERS, source="cfgplan_runtime.mqtt:Subscriber", params=params)
        runtime = run_with(run_units, given, tmp_path / "note")
        if is_replaced:
            runtime.apply(start(GIVEN, WORKED))
            first = Listener("/result")
            eventually(lambda: put(broker.port, multiple, [0], retain=True) or bool(first.received))
            signal_unit(runtime, "give.1")
            eventually(lambda: bool(seen(runtime, UnitDied)))
        put(broker.port, multiple, [1, 2, 3], retain=not is_replaced)
        listener = apply_slowly(runtime, tmp_path / "note", *(() if is_replaced else (WORKED,)))
        eventually(lambda: {1, 2, 3} <= set(listener.values))


def put(port: int, multiple: Callable[..., None], numbers: list[int], *, retain: bool) -> None:
    """Publish each number on a topic of its own."""
    messages = [{"topic": f"in/{one}", "payload": str(one), "qos": 1, "retain": retain} for one in numbers]
    multiple(messages, hostname="127.0.0.1", port=port)
