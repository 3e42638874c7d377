"""A state goes from one unit to the next between two steps: none is lost, and none is made twice."""

from __future__ import annotations

import random
import time
from collections.abc import Iterable
from dataclasses import replace
from itertools import islice, pairwise
from types import SimpleNamespace
from typing import cast

import msgspec
import pytest
from cfgplan_runtime import Runtime
from cfgplan_runtime.children.handover import Handover
from cfgplan_runtime.children.messages import (
    Activate,
    Finish,
    GivenInput,
    HoldSteps,
    StateTold,
    TakeState,
    TellState,
)
from cfgplan_runtime.children.ports import Ports
from cfgplan_runtime.children.steps import Step, StepQueue
from cfgplan_runtime.errors import ApplyError
from cfgplan_runtime.streams.element import BEFORE_ALL, Element, Moment
from cfgplan_runtime.streams.inlet import InputQueue
from cfgplan_runtime.streams.payload import PayloadEncoder
from cfgplan_runtime.supervision.events import StateNotExact
from cfgplan_runtime.supervision.updates import Patience
from handing_over import delay_states
from watching import Listener, StartRuntime, seen
from world import child_of, eventually, source, start, unit, worker

from cfgplan.domain import ChangeSet, ComputationUnit, OutputPort, RunOptions, Transformation

Arrival = tuple[str, Element]


def queue_of(start: str, loose: str) -> StepQueue:
    by_name = {"optional": ["c"]} if loose == "optional" else {"services": ["c"]}
    return StepQueue(["a", "b", "c"], start=start, tolerance_ns=2, limit=1000, **by_name)  # type: ignore[arg-type]


def made(queue: StepQueue) -> list[dict[str, int]]:
    """The times of the elements of each step that can be made now."""
    found = []
    while (step := queue.next()) is not None:
        found.append(times(step))
    return found


def times(step: Step) -> dict[str, int]:
    return {port: one.time_ns for port, one in step.elements.items() if isinstance(one, Element)}


def fed(queue: StepQueue, arrivals: Iterable[Arrival]) -> list[dict[str, int]]:
    """The steps of elements that arrive one after the other."""
    found = []
    for inlet, element in arrivals:
        queue.put(inlet, element, may_drop=True)
        found += made(queue)
    return found


@pytest.mark.parametrize("loose", ["optional", "services"])
@pytest.mark.parametrize("start", ["all", "any", "aligned", "a"])
@pytest.mark.parametrize("seed", range(20))
def test_the_steps_of_two_units_are_those_of_one(seed: int, start: str, loose: str) -> None:
    """The next unit gets what arrives from some moment on; later the one before stops between two steps."""
    draw = random.Random(seed)
    arrivals = [(draw.choice("aabbbc"), Element(number, 0, number, b"%d" % number)) for number in range(60)]
    first, last = sorted(draw.sample(range(61), 2))
    whole = fed(queue_of(start, loose), arrivals)

    before, following = queue_of(start, loose), queue_of(start, loose)
    steps = fed(before, arrivals[:last])
    for inlet in "abc":
        got = [element.moment for name, element in arrivals[:last] if name == inlet]
        place: Moment = max((moment for moment in got if moment[0] < first), default=BEFORE_ALL)
        given = before.given(inlet, got[-1] if got else BEFORE_ALL, place)
        assert all((one.time_ns, one.turn) <= place for one in given.elements), "the next one gets the others itself"
        kept = [Element(one.time_ns, one.turn, 0, one.payload) for one in given.elements]
        kept += [element for name, element in arrivals[first:last] if name == inlet]
        for element in following.begin_at(inlet, given.done, kept):
            following.put(inlet, element, may_drop=False)
    assert steps + made(following) + fed(following, arrivals[last:]) == whole


@pytest.mark.parametrize("queue", [1, 40])
@pytest.mark.parametrize("is_next", [True, False], ids=["the next unit", "the unit before"])
def test_large_elements_that_come_in_a_hand_over_are_bounded_in_bytes(*, is_next: bool, queue: int) -> None:
    """Images: their number alone would allow gigabytes. As many as may wait otherwise are kept in any case."""
    high, _ = modes("Tally", run=RunOptions(queue=queue))
    with child_of(high) as child:
        child._obey(Activate(), [])
        child._obey(HoldSteps() if is_next else TellState({}), [])
        child._work()
        for number in range(50):
            child._ports.inputs["x"].take(Element(number, 0, number, bytes(1 << 20)))
        room = max(queue, 32)
        assert (child._handover.waiting("x"), child._steps.dropped) == (room, {"x": 50 - room})


def test_places_that_are_asked_for_are_told_after_the_first_step_except_those_of_first_elements() -> None:
    """A first element that has become a step is not kept any more; the places of other inlets still count."""
    receiver = SimpleNamespace(place=None)
    ports = SimpleNamespace(inputs={name: SimpleNamespace(receivers={"": receiver}) for name in "ab"})
    handover = Handover(queue_of("all", "optional"), cast("Ports", ports), 10)
    handover.hold()
    handover.ask_places({"a": True, "b": False})
    handover.begin({})
    assert handover.places() is None
    receiver.place = 7, 0
    assert handover.places() == {"b": (7, 0)}
    assert handover.places() is None
    handover.hold()
    handover.ask_places({"a": True})
    handover.keep("a", Element(1, 0, 1, b""), may_drop=False)
    handover.begin({})
    assert handover.places() is None


@pytest.mark.parametrize("is_next", [True, False], ids=["the next unit", "the unit before"])
def test_no_step_begins_in_a_hand_over_however_long_the_update_takes(
    monkeypatch: pytest.MonkeyPatch, *, is_next: bool
) -> None:
    """Other units of the update may hand over their states slowly, one after the other."""
    high, _ = modes("Tally")
    with child_of(high) as child:
        child._obey(Activate(), [])
        child._obey(HoldSteps() if is_next else TellState({}), [])
        child._work()
        now_ns = time.monotonic_ns()
        monkeypatch.setattr("time.monotonic_ns", lambda: now_ns + 3_600_000_000_000)
        for number in range(1000):
            child._ports.inputs["x"].take(Element(number, 0, number, b"".join(PayloadEncoder().encode(number))))
        child._work()
        assert child.step == 0
        child._obey(TakeState(None, {}, {}), [])
        while (step := child._pending) is not None:
            child._begin(step)
        assert (child.step, child._steps.dropped) == (1000, {"x": 0})


@pytest.mark.parametrize("is_next", [True, False], ids=["the next unit", "a unit that stays"])
def test_a_unit_that_is_slower_than_its_source_catches_up_after_a_hand_over(*, is_next: bool) -> None:
    """Else it would work on old elements from then on: its queue drops all but the newest one."""
    inlet = InputQueue(limit=10)
    ports = SimpleNamespace(inputs={"x": SimpleNamespace(inlet=inlet)}, outputs={}, say=list[object]().append)
    queue = StepQueue(["x"], start="all", tolerance_ns=0, limit=1)
    handover = Handover(queue, cast("Ports", ports), 1)
    if is_next:
        handover.hold()
    else:
        inlet.last = (100, 0)
        handover.ask_state({})
        handover.tell(b"state", {})
    numbers = iter(range(10_000))

    def come(count: int) -> None:
        for number in islice(numbers, count):
            put = handover.keep if handover.is_keeping else queue.put
            put("x", Element(number, 0, number, b""), may_drop=True)

    come(20)
    handover.begin({}) if is_next else handover.stay()
    for _ in range(500):
        handover.refill()
        assert queue.next() is not None
        come(2)
    assert handover.waiting("x") + queue.waiting("x") <= 2


def told(handover: Handover, said: list[object]) -> StateTold:
    """The answer of a unit that is asked for its state at once."""
    handover.ask_state({"x": (100, 0)})
    assert handover.is_state_due
    handover.tell(b"state", {})
    (answer,) = said
    assert isinstance(answer, StateTold)
    return answer


def test_elements_that_have_no_room_among_the_steps_are_given_too() -> None:
    """The unit has itself just begun with a state, and the elements that it kept wait for their steps."""
    said = list[object]()
    inlet = InputQueue(limit=10)
    ports = SimpleNamespace(inputs={"x": SimpleNamespace(inlet=inlet)}, outputs={}, say=said.append)
    handover = Handover(StepQueue(["x"], start="all", tolerance_ns=0, limit=2), cast("Ports", ports), 2)
    handover.hold()
    for number in range(5):
        handover.keep("x", Element(number, 0, number, b""), may_drop=False)
    inlet.last = (100, 0)
    handover.begin({})
    handover.refill()
    given = told(handover, said).inputs["x"]
    assert (given.done, [one.time_ns for one in given.elements]) == ((0, -1), [0, 1, 2, 3, 4])


def test_elements_that_are_too_long_for_a_message_are_dropped_and_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Images that wait for a camera that is silent, for example."""
    monkeypatch.setattr("cfgplan_runtime.children.handover._MOST_GIVEN_BYTES", 1000)
    said = list[object]()
    ports = SimpleNamespace(
        inputs={name: SimpleNamespace(inlet=InputQueue(limit=10, last=(100, 0))) for name in "xz"},
        outputs={},
        say=said.append,
    )
    queue = StepQueue(["x", "z", "s"], start="all", tolerance_ns=0, limit=10)
    handover = Handover(queue, cast("Ports", ports), 10)
    for number in range(5):
        queue.put("x", Element(number, 0, number, bytes(300)), may_drop=True)
    queue.put("z", Element(1, 0, 0, bytes(200)), may_drop=True)
    handover.ask_state({"x": (100, 0), "z": (100, 0)})
    handover.tell(b"", {})
    (answer,) = said
    assert isinstance(answer, StateTold)
    given = {name: [one.time_ns for one in one_input.elements] for name, one_input in answer.inputs.items()}
    assert (given, queue.dropped) == ({"x": [3, 4], "z": [1]}, {"x": 3, "z": 0, "s": 0})


def test_a_unit_that_is_asked_for_its_state_has_room_for_what_this_needs() -> None:
    """Its other input pauses, so that no step makes room."""
    inlet = InputQueue(limit=10)
    ports = SimpleNamespace(inputs={"x": SimpleNamespace(inlet=inlet)})
    queue = StepQueue(["x", "z"], start="all", tolerance_ns=0, limit=1)
    handover = Handover(queue, cast("Ports", ports), 1)
    queue.put("x", Element(1, 0, 0, b""), may_drop=False)
    assert handover.is_full("x")
    handover.ask_state({"x": (2, 0)})
    assert (handover.is_full("x"), handover.is_state_due) == (False, False)
    inlet.last = (2, 0)
    assert (handover.is_full("x"), handover.is_state_due) == (True, True)


def test_a_unit_that_pauses_holds_up_no_source_that_also_feeds_the_next_one() -> None:
    said = list[object]()
    inlet = InputQueue(limit=10, last=(100, 0))
    ports = SimpleNamespace(inputs={"x": SimpleNamespace(inlet=inlet)}, outputs={}, say=said.append)
    handover = Handover(StepQueue(["x"], start="all", tolerance_ns=0, limit=1), cast("Ports", ports), 1)
    told(handover, said)
    for number in range(20):
        handover.keep("x", Element(number, 0, number, bytes(1 << 10)), may_drop=False)
    assert not handover.is_full("x")
    for number in range(33):
        handover.keep("x", Element(number, 0, number, bytes(1 << 20)), may_drop=False)
    assert handover.is_full("x"), "more would fill the memory"
    handover.stay()
    assert handover.is_full("x")


def modes(code: str, **more: object) -> tuple[Transformation, Transformation]:
    """Two transformations with one state."""
    high, low = (worker(label, code, **more) for label in ("high", "low"))  # type: ignore[arg-type]
    return tuple(replace(one, run=replace(one.run, state="altitude")) for one in (high, low))  # type: ignore[return-value]


def next_mode(number: int, **feeds: str) -> ChangeSet:
    """Unit `number` replaces the one before it: odd ones are low."""
    labels = "high", "low"
    new = unit(f"{labels[number % 2]}.{number}", topic="/result", **feeds)
    return ChangeSet(started=(new,), stopped=(f"{labels[(number - 1) % 2]}.{number - 1}",))


def rises(runtime: Runtime, listener: Listener) -> set[tuple[int, ...]]:
    """End the run. Returns the differences between the numbers of successive elements."""
    runtime.close()
    listener.join()
    return {tuple(after - before for before, after in zip(*two, strict=True)) for two in pairwise(listener.values)}


def rises_of_one(runtime: Runtime, listener: Listener) -> set[int]:
    """End the run. Returns the differences between successive numbers."""
    runtime.close()
    listener.join()
    return {after - before for before, after in pairwise(listener.values)}


def test_elements_that_wait_for_a_partner_wait_in_the_next_unit(run_units: StartRuntime) -> None:
    """Input b has every second number, so that each step leaves one more element at input a."""
    high, low = modes("Pairs", inputs=("a", "b"), run=RunOptions(queue=10_000))
    half = worker("half", "even")
    runtime = run_units(source(), half, high, low)
    feeds = {"a": "count.1/n", "b": "half.1/y"}
    runtime.apply(start(unit("count.1"), unit("half.1", x="count.1/n"), unit("high.0", topic="/result", **feeds)))
    listener = Listener("/result")
    eventually(lambda: len(listener.received) > 20)
    for number in range(1, 6):
        runtime.apply(next_mode(number, **feeds))
    received = len(listener.received)
    eventually(lambda: len(listener.received) > received + 5)
    assert seen(runtime, StateNotExact) == []
    assert rises(runtime, listener) == {(1, 1, 2)}


def test_the_last_element_of_a_quiet_stream_goes_to_the_next_unit(run_units: StartRuntime) -> None:
    high, low = modes("Pairs", inputs=("a", "b"), run=RunOptions(start="a"))
    runtime = run_units(source(), source("seldom", rate_hz=0.25), high, low)
    feeds = {"a": "count.1/n", "b": "seldom.1/n"}
    runtime.apply(start(unit("high.0", topic="/result", **feeds), unit("count.1"), unit("seldom.1")))
    listener = Listener("/result")
    eventually(lambda: len(listener.received) > 20)
    for number in range(1, 4):
        runtime.apply(next_mode(number, **feeds))
    received = len(listener.received)
    eventually(lambda: len(listener.received) > received + 5)
    assert seen(runtime, StateNotExact) == []
    assert rises(runtime, listener) <= {(1, 1, 0), (1, 1, 1)}, "no step waited for the next element of b"


def test_a_chain_of_units_with_states_is_replaced_exactly(run_units: StartRuntime) -> None:
    first, second = (worker(label, "Tally", run=RunOptions(state=True)) for label in ("first", "second"))
    runtime = run_units(source(), first, second)

    def chain(number: int) -> tuple[ComputationUnit, ...]:
        return (
            unit(f"first.{number}", topic="/result", x=f"second.{number}/y"),
            unit(f"second.{number}", x="count.1/n"),
        )

    runtime.apply(start(unit("count.1"), *chain(1)))
    listener = Listener("/result")
    eventually(lambda: len(listener.received) > 20)
    for number in range(2, 5):
        runtime.apply(ChangeSet(started=chain(number), stopped=(f"first.{number - 1}", f"second.{number - 1}")))
    received = len(listener.received)
    eventually(lambda: len(listener.received) > received + 5)
    assert seen(runtime, StateNotExact) == []
    assert rises_of_one(runtime, listener) == {1}


def test_units_start_at_once_although_the_last_known_state_is_large(run_units: StartRuntime) -> None:
    """It goes to the new unit's process by way of the nursery, in many parts."""
    high, low = modes("LargeTally")
    runtime = run_units(source(rate_hz=20), high, low)
    runtime.apply(start(unit("count.1"), unit("high.0", topic="/result", x="count.1/n")))
    listener = Listener("/result")
    eventually(lambda: len(listener.received) > 5)
    for number in range(1, 3):
        runtime.apply(next_mode(number, x="count.1/n"))
    received = len(listener.received)
    eventually(lambda: len(listener.received) > received + 5)
    assert rises_of_one(runtime, listener) == {1}


def test_results_after_a_state_was_told_are_the_next_units(run_units: StartRuntime) -> None:
    """The next unit makes these steps in another way, and from the state without them."""
    high, low = (replace(one, params={"by": by}) for one, by in zip(modes("Tally"), (10, 1), strict=True))
    runtime = run_units(source(), high, low)
    delay_states(runtime)
    runtime.apply(start(unit("count.1"), unit("high.0", topic="/result", x="count.1/n")))
    listener = Listener("/result")
    eventually(lambda: len(listener.received) > 20)
    for number in range(1, 6):
        assert runtime.apply(next_mode(number, x="count.1/n")).unswitched == 0
    received = len(listener.received)
    eventually(lambda: len(listener.received) > received + 5)
    assert seen(runtime, StateNotExact) == []
    assert rises_of_one(runtime, listener) == {1, 10}


def test_results_of_a_chain_after_states_were_told_are_the_next_chains(run_units: StartRuntime) -> None:
    chains = [
        [worker(f"{place}_{mode}", "Tally", by=by, run=RunOptions(state=place)) for place in ("first", "second")]
        for mode, by in (("high", 10), ("low", 1))
    ]
    runtime = run_units(source(), *chains[0], *chains[1])
    delay_states(runtime)

    def chain(number: int) -> tuple[ComputationUnit, ...]:
        mode = ("high", "low")[number % 2]
        return (
            unit(f"first_{mode}.{number}", topic="/result", x=f"second_{mode}.{number}/y"),
            unit(f"second_{mode}.{number}", topic="/second", x="count.1/n"),
        )

    runtime.apply(start(unit("count.1"), *chain(0)))
    listeners = [Listener("/result"), Listener("/second")]
    eventually(lambda: min(len(listener.received) for listener in listeners) > 20)
    for number in range(1, 5):
        runtime.apply(ChangeSet(started=chain(number), stopped=tuple(one.id for one in chain(number - 1))))
    received = len(listeners[0].received)
    eventually(lambda: len(listeners[0].received) > received + 5)
    assert seen(runtime, StateNotExact) == []
    assert [rises_of_one(runtime, listener) for listener in listeners] == [{1, 10}] * 2


def test_a_unit_without_a_state_pauses_with_the_one_that_feeds_it(run_units: StartRuntime) -> None:
    """Both are replaced; a topic whose old unit neither gives an element nor pauses would be silent for 2 s."""
    high, low = modes("Tally")
    runtime = run_units(source(), high, low, worker())
    delay_states(runtime)

    def chain(number: int) -> tuple[ComputationUnit, ...]:
        tally = f"{('high', 'low')[number % 2]}.{number}"
        return unit(tally, x="count.1/n"), unit(f"work.{number}", topic="/result", x=f"{tally}/y")

    runtime.apply(start(unit("count.1"), *chain(0)))
    listener = Listener("/result")
    eventually(lambda: len(listener.received) > 20)
    for number in range(1, 4):
        stopped = tuple(one.id for one in chain(number - 1))
        assert runtime.apply(ChangeSet(started=chain(number), stopped=stopped)).unswitched == 0
    received = len(listener.received)
    eventually(lambda: len(listener.received) > received + 5)
    assert seen(runtime, StateNotExact) == []
    assert rises_of_one(runtime, listener) == {1}


def while_replaced(runtime: Runtime, times: int, feeds: dict[str, str]) -> Listener:
    """Replace add.0 so often. Returns a listener that has heard results before and after."""
    listener = Listener("/result")
    eventually(lambda: len(listener.received) > 20)
    for number in range(1, times + 1):
        next_one = unit(f"add.{number}", topic="/result", **feeds)
        assert runtime.apply(ChangeSet(started=(next_one,), stopped=(f"add.{number - 1}",))).unswitched == 0
    received = len(listener.received)
    eventually(lambda: len(listener.received) > received + 20)
    return listener


@pytest.mark.parametrize("run", [RunOptions(), RunOptions(start="aligned"), RunOptions(state="kept")])
def test_inputs_stay_paired_if_a_unit_without_a_state_is_replaced(run_units: StartRuntime, run: RunOptions) -> None:
    """Both come from one source, one of them through another unit: the sums of equal numbers are even."""
    add = worker("add", "add", inputs=("a", "b"), run=run)
    runtime = run_units(source(rate_hz=1000), worker("same"), add)
    feeds = {"a": "count.1/n", "b": "same.1/y"}
    runtime.apply(start(unit("count.1"), unit("same.1", x="count.1/n"), unit("add.0", topic="/result", **feeds)))
    listener = while_replaced(runtime, 12, feeds)
    assert rises_of_one(runtime, listener) == {2}
    assert listener.values[0] % 2 == 0


def test_a_unit_without_a_state_has_the_last_element_of_a_quiet_stream_from_the_one_before(
    run_units: StartRuntime,
) -> None:
    """A map that came once, for example."""
    add = worker("add", "add", inputs=("a", "b"), run=RunOptions(start="a"))
    runtime = run_units(source(), source("once", "once"), add)
    feeds = {"a": "count.1/n", "b": "once.1/n"}
    runtime.apply(start(unit("add.0", topic="/result", **feeds), unit("count.1"), unit("once.1")))
    listener = while_replaced(runtime, 3, feeds)
    assert rises_of_one(runtime, listener) == {1}


def test_a_unit_whose_successor_fails_at_each_step_makes_the_steps_that_came_meanwhile(
    run_units: StartRuntime,
) -> None:
    """More of them than may wait at an input otherwise."""
    high, _ = modes("Tally", run=RunOptions(queue=8))
    low = replace(worker("low", "FailsWithState"), run=high.run)
    runtime = run_units(source(), high, low)
    runtime.apply(start(unit("count.1"), unit("high.0", topic="/result", x="count.1/n")))
    listener = Listener("/result")
    eventually(lambda: len(listener.received) > 20)
    with pytest.raises(ApplyError, match="its code fails"):
        runtime.apply(next_mode(1, x="count.1/n"), patience=Patience(switch_s=0.5))
    received = len(listener.received)
    eventually(lambda: len(listener.received) > received + 150)
    assert seen(runtime, StateNotExact) == []
    assert rises_of_one(runtime, listener) == {1}


def test_a_unit_that_has_told_its_state_leaves_the_steps_that_wait_when_it_ends() -> None:
    high, _ = modes("Tally")
    with child_of(high) as child:
        child._obey(Activate(), [])
        child._obey(TellState({}), [])
        child._work()
        child._ports.inputs["x"].take(Element(1, 0, 0, b"".join(PayloadEncoder().encode(1))))
        child._obey(Finish(), [])
        child._work()
        assert (child.step, child._has_work) == (0, False)


@pytest.mark.parametrize("code", ["Clock", "SlowFirst"])
def test_a_source_goes_on_where_the_one_before_has_ended(run_units: StartRuntime, code: str) -> None:
    """Also if the new source is at a step when it is told to wait for the state: the result of that step is void."""
    fast, slow = (
        Transformation(
            label,
            outputs=(OutputPort("y", "Y"),),
            source=f"running_units.py:{code}",
            run=RunOptions(rate_hz=rate_hz, state="clock"),
        )
        for label, rate_hz in (("high", 200.0), ("low", 100.0))
    )
    runtime = run_units(fast, slow)
    runtime.apply(start(unit("high.0", topic="/result")))
    listener = Listener("/result")
    eventually(lambda: len(listener.received) > 20)
    for number in range(1, 5):
        runtime.apply(next_mode(number))
    received = len(listener.received)
    eventually(lambda: len(listener.received) > received + 5)
    assert rises_of_one(runtime, listener) == {1}


@pytest.mark.parametrize(
    ("deed", "cause"),
    [("fail", "the code of high.0 gives no state"), ("sleep", "high.0 did not tell its state within 1 s")],
)
def test_a_unit_that_does_not_tell_its_state_is_replaced_all_the_same(
    run_units: StartRuntime, deed: str, cause: str
) -> None:
    high, low = modes("KeepsItsState", deed=deed)
    runtime = run_units(source(), high, low)
    runtime.apply(start(unit("count.1"), unit("high.0", topic="/result", x="count.1/n")))
    listener = Listener("/result")
    eventually(lambda: len(listener.received) > 5)
    runtime.apply(next_mode(1, x="count.1/n"))
    told = seen(runtime, StateNotExact)
    assert [(one.unit, one.before, one.cause) for one in told] == [("low.1", "high.0", cause)]
    received = len(listener.received)
    eventually(lambda: len(listener.received) > received + 5)
    runtime.close()
    listener.join()


def test_a_state_that_comes_again_changes_nothing_in_a_unit_that_makes_steps(run_units: StartRuntime) -> None:
    high, _ = modes("Tally")
    runtime = run_units(source(), high)
    runtime.apply(start(unit("count.1"), unit("high.0", topic="/result", x="count.1/n")))
    listener = Listener("/result")
    eventually(lambda: len(listener.received) > 20)
    zero = msgspec.msgpack.encode(0)
    runtime._executor.call(lambda: runtime.supervisor.backend.give_state("high.0", zero, {}, {}))
    received = len(listener.received)
    eventually(lambda: len(listener.received) > received + 20)
    assert rises_of_one(runtime, listener) == {1}


def test_a_source_that_was_asked_for_its_state_and_stays_gives_again_at_once() -> None:
    handover = Handover(
        StepQueue([], start="all", tolerance_ns=0, limit=1),
        cast("Ports", SimpleNamespace(inputs={}, outputs={}, say=lambda _: None)),
        3,
    )
    handover.ask_state({})
    handover.tell(b"state", {})
    assert handover.is_still
    handover.stay()
    assert not handover.is_still
    handover.ask_state({})
    handover.stay()
    assert not handover.is_state_due


@pytest.mark.parametrize("is_begun", [False, True])
def test_elements_that_waited_before_a_unit_was_told_to_wait_for_a_state_are_no_steps_after_it(is_begun: bool) -> None:
    """An undone update has kept the unit; the unit before it has made these steps, and its state has them."""
    _, low = modes("Tally")
    with child_of(low) as child:
        elements = [Element(at, 0, 0, b"".join(PayloadEncoder().encode(at))) for at in range(1, 6)]
        child._obey(Activate(), [])
        for element in elements[:4]:
            child._steps.put("x", element, may_drop=False)
        if is_begun:
            assert child._pending is not None
        child._obey(HoldSteps(), [])
        child._work()
        child._ports.inputs["x"].take(elements[4])
        child._obey(TakeState(msgspec.msgpack.encode(4), {"x": GivenInput((4, 0))}, {"y": (9, 0)}), [])
        child._work()
        assert child.step == 1
        assert child._state() == msgspec.msgpack.encode(5)
        assert child._ports.outputs["y"].last == (9, 1), "after the elements of the unit before it"
