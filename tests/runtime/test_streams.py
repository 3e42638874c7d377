"""What a consumer of a topic gets while units are replaced, with real processes."""

from __future__ import annotations

import signal
from itertools import pairwise

import pytest
from cfgplan_runtime import Runtime
from cfgplan_runtime.supervision.events import (
    Event,
    SourceExhausted,
    StateNotExact,
    TopicsStatus,
    UnitDied,
    UnitStatus,
)
from cfgplan_runtime.supervision.observation import Observation
from unit_signals import signal_unit
from watching import Listener, StartRuntime, seen
from world import RESULT, eventually, source, start, unit, worker

from cfgplan.domain import ChangeSet, RunOptions, Transformation


def swap(number: int) -> ChangeSet:
    return ChangeSet(started=(unit(f"work.{number}", topic="/result", x="count.1/n"),), stopped=(f"work.{number - 1}",))


class Counts:
    """The elements that units and topics count as dropped, as far as they have told."""

    def __init__(self, runtime: Runtime) -> None:
        self._dropped: dict[str, int] = {}
        runtime.listen(self._hear)

    @property
    def dropped(self) -> int:
        return sum(list(self._dropped.values()))

    def _hear(self, event: Event) -> None:
        match event:
            case UnitStatus(unit_id):
                self._dropped[unit_id] = sum(counts.dropped for counts in event.inputs.values())
            case TopicsStatus(flows):
                self._dropped["topics"] = sum(flow.dropped for flow in flows.values())


@pytest.mark.parametrize(("rate_hz", "swaps"), [(30, 4), (200, 12), (1000, 12)])
def test_nothing_is_lost_uncounted_repeated_or_reordered_while_units_are_replaced(
    run_units: StartRuntime, rate_hz: float, swaps: int
) -> None:
    """At 1,000 Hz a unit that gets no CPU time for a quarter of a second drops elements."""
    runtime = run_units(source(rate_hz=rate_hz), worker())
    counts = Counts(runtime)
    runtime.apply(start(unit("count.1"), unit("work.1", topic="/result", x="count.1/n")))
    listener = Listener("/result")
    eventually(lambda: len(listener.received) > 3)
    for number in range(2, swaps + 2):
        assert runtime.apply(swap(number)).unswitched == 0
    last = listener.values[-1]
    eventually(lambda: listener.values[-1] > last + 3)
    until = listener.values
    lost = sum(after - before - 1 for before, after in pairwise(until))
    eventually(lambda: counts.dropped + listener.subscription.dropped >= lost)
    runtime.close()
    listener.join()
    assert lost == 0 or rate_hz == 1000
    assert all(before < after for before, after in pairwise(listener.values))


def test_no_image_is_lost_while_units_are_replaced(run_units: StartRuntime) -> None:
    runtime = run_units(
        source(code="image_units.py:images", rate_hz=30), worker(), worker("number", "image_units.py:image_number")
    )
    runtime.apply(
        start(
            unit("count.1"),
            unit("work.1", x="count.1/n"),
            unit("number.1", topic="/result", x="work.1/y"),
        )
    )
    listener = Listener("/result")
    eventually(lambda: len(listener.received) > 3)
    for number in range(2, 6):
        runtime.apply(
            ChangeSet(
                started=(unit(f"work.{number}", x="count.1/n"),),
                rewired=(unit("number.1", topic="/result", x=f"work.{number}/y"),),
                stopped=(f"work.{number - 1}",),
            )
        )
    last = listener.values[-1]
    eventually(lambda: listener.values[-1] > last + 3)
    runtime.close()
    listener.join()
    first = listener.values[0]
    assert listener.values == list(range(first, first + len(listener.values)))


def test_a_whole_chain_is_replaced_without_losing_anything(run_units: StartRuntime) -> None:
    runtime = run_units(source(), worker("first"), worker("second"), worker("third"))

    def chain(number: int) -> tuple[object, ...]:
        return (
            unit(f"first.{number}", x="count.1/n"),
            unit(f"second.{number}", x=f"first.{number}/y"),
            unit(f"third.{number}", topic="/result", x=f"second.{number}/y"),
        )

    runtime.apply(start(unit("count.1"), *chain(1)))  # type: ignore[arg-type]
    listener = Listener("/result")
    for number in range(2, 6):
        old = tuple(f"{label}.{number - 1}" for label in ("first", "second", "third"))
        runtime.apply(ChangeSet(started=chain(number), stopped=old))  # type: ignore[arg-type]
    eventually(lambda: len(listener.received) > 20)
    runtime.close()
    listener.join()
    first = listener.values[0]
    assert listener.values == list(range(first, first + len(listener.values)))


def test_a_consumer_keeps_receiving_when_a_killed_unit_is_replaced(run_units: StartRuntime) -> None:
    runtime = run_units(source(), worker())
    runtime.apply(start(unit("count.1"), unit("work.1", topic="/result", x="count.1/n")))
    listener = Listener("/result")
    eventually(lambda: len(listener.received) > 3)
    signal_unit(runtime, "work.1")
    eventually(lambda: bool(seen(runtime, UnitDied)))
    assert [unit.id for unit in runtime.environment.units] == ["count.1"]
    before = len(listener.received)
    runtime.apply(start(unit("work.2", topic="/result", x="count.1/n")))
    eventually(lambda: len(listener.received) > before + 3)
    runtime.close()
    listener.join()
    assert listener.values == sorted(set(listener.values))


def test_what_a_unit_drops_because_it_got_no_cpu_time_is_counted(run_units: StartRuntime) -> None:
    queue = 5
    runtime = run_units(source(), worker(run=RunOptions(queue=queue)))
    runtime.apply(start(unit("count.1"), unit("work.1", topic="/result", x="count.1/n")))
    listener = Listener("/result")
    eventually(lambda: len(listener.received) > 3)

    def observed(unit_id: str) -> Observation:
        return next(one for one in runtime.observe() if one.unit == unit_id)

    def lost() -> int:
        return sum(after - before - 1 for before, after in pairwise(listener.values))

    signal_unit(runtime, "work.1", signal.SIGSTOP)
    before = observed("count.1").steps
    eventually(lambda: observed("count.1").steps > before + 10 * queue)
    signal_unit(runtime, "work.1", signal.SIGCONT)
    eventually(lambda: lost() > queue)
    eventually(lambda: observed("work.1").dropped == lost())


def test_several_consumers_get_the_same_and_one_that_stalls_harms_nobody(run_units: StartRuntime) -> None:
    from cfgplan_runtime import subscribe

    runtime = run_units(source(code="image_units.py:images", rate_hz=25))  # 32 MB, which may wait, are three seconds
    runtime.apply(start(unit("count.1", topic="/result", port="n")))
    listeners = [Listener("/result"), Listener("/result")]
    stalled = subscribe("/result")
    eventually(lambda: all(len(listener.received) > 90 for listener in listeners))
    stalled.close()
    runtime.close()
    for listener in listeners:
        listener.join()
        assert listener.subscription.dropped == 0


def test_a_slow_unit_drops_the_oldest_and_counts_what_it_drops(run_units: StartRuntime) -> None:
    slow = worker("slow", "Slow", run=RunOptions(queue=2), seconds=0.05)
    runtime = run_units(source(rate_hz=1000), slow)
    runtime.apply(start(unit("count.1"), unit("slow.1", topic="/result", x="count.1/n")))
    listener = Listener("/result")
    eventually(lambda: len(listener.received) > 30)
    eventually(lambda: any(o.unit == "slow.1" and o.dropped > 20 for o in runtime.observe()))
    runtime.close()
    listener.join()
    assert listener.values == sorted(set(listener.values))
    assert listener.values[-1] - listener.values[0] > 5 * len(listener.values)


def test_a_slow_unit_that_blocks_loses_nothing(run_units: StartRuntime) -> None:
    slow = worker("slow", "Slow", run=RunOptions(queue=2, blocks=True), seconds=0.02)
    runtime = run_units(source(rate_hz=1000), slow)
    runtime.apply(start(unit("count.1"), unit("slow.1", topic="/result", x="count.1/n")))
    listener = Listener("/result")
    eventually(lambda: len(listener.received) > 60)
    runtime.close()
    listener.join()
    first = listener.values[0]
    assert listener.values == list(range(first, first + len(listener.values)))


@pytest.mark.parametrize("mode", ["all", "aligned"])
def test_inputs_of_one_origin_meet_again(run_units: StartRuntime, mode: str) -> None:
    join = worker("join", "add", inputs=("a", "b"), run=RunOptions(start=mode))
    runtime = run_units(source(), worker(), join)
    runtime.apply(
        start(
            unit("count.1"),
            unit("work.1", x="count.1/n"),
            unit("join.1", topic="/result", a="count.1/n", b="work.1/y"),
        )
    )
    listener = Listener("/result")
    eventually(lambda: len(listener.received) > 30)
    runtime.close()
    listener.join()
    steps = {after - before for before, after in pairwise(listener.values)}
    assert steps == {2}


def test_a_unit_gives_several_outputs_and_several_elements_of_one_step(run_units: StartRuntime) -> None:
    two = worker("two", "TwoOutputs", outputs=("even", "double"))
    runtime = run_units(source(), two, worker("twice", "twice"))
    runtime.apply(
        start(unit("count.1"), unit("two.1", x="count.1/n"), unit("twice.1", topic="/result", x="two.1/even"))
    )
    listener = Listener("/result")
    eventually(lambda: len(listener.received) > 30)
    runtime.close()
    listener.join()
    values = listener.values[listener.values[0] != listener.values[1] :]
    assert [after - before for before, after in pairwise(values)][:9] == [0, 2, 0, 2, 0, 2, 0, 2, 0]


def test_state_survives_a_restart_when_asked(run_units: StartRuntime) -> None:
    tally = worker("tally", "Tally", run=RunOptions(state=True))
    runtime = run_units(source(), tally)
    runtime.apply(start(unit("count.1"), unit("tally.1", topic="/result", x="count.1/n")))
    listener = Listener("/result")
    eventually(lambda: len(listener.received) > 20)
    runtime.apply(ChangeSet(stopped=("tally.1",)))
    before = len(listener.received)
    runtime.apply(start(unit("tally.2", topic="/result", x="count.1/n")))
    eventually(lambda: len(listener.received) > before + 5)
    runtime.close()
    listener.join()
    assert listener.values == sorted(set(listener.values)), "a count that began anew would fall back to 1"


def test_transformations_whose_state_has_one_name_go_on_from_each_other_without_losing_a_step(
    run_units: StartRuntime,
) -> None:
    high, low = (worker(label, "Tally", run=RunOptions(state="altitude")) for label in ("high", "low"))
    runtime = run_units(source(), high, low)
    runtime.apply(start(unit("count.1"), unit("high.1", topic="/result", x="count.1/n")))
    listener = Listener("/result")
    eventually(lambda: len(listener.received) > 20)
    labels = ["high", "low"]
    for number in range(1, 7):
        new = unit(f"{labels[number % 2]}.{number + 1}", topic="/result", x="count.1/n")
        runtime.apply(ChangeSet(started=(new,), stopped=(f"{labels[number % 2 - 1]}.{number}",)))
    before = len(listener.received)
    eventually(lambda: len(listener.received) > before + 5)
    assert seen(runtime, StateNotExact) == []
    runtime.close()
    listener.join()
    first = listener.values[0]
    assert listener.values == list(range(first, first + len(listener.values)))


def test_values_are_those_that_were_sent(run_units: StartRuntime) -> None:
    runtime = run_units(source(code="image_units.py:images", rate_hz=20))
    runtime.apply(start(unit("count.1", topic="/result", port="n")))
    listener = Listener("/result")
    eventually(lambda: len(listener.received) > 3)
    runtime.close()
    listener.join()
    image = listener.values[0]
    assert (image.shape, str(image.dtype)) == ((480, 960), "uint8")


def test_a_stopped_target_leaves_its_topic_there(run_units: StartRuntime) -> None:
    library: tuple[Transformation, ...] = (source(),)
    runtime = run_units(*library)
    runtime.apply(start(unit("count.1", topic="/result", port="n")))
    listener = Listener("/result")
    eventually(lambda: len(listener.received) > 3)
    runtime.apply(ChangeSet(stopped=("count.1",)))
    runtime.apply(start(unit("count.2", topic=RESULT.topic, port="n")))
    before = len(listener.received)
    eventually(lambda: len(listener.received) > before + 3)
    runtime.close()
    listener.join()


def test_a_source_without_a_rate_sets_its_own_pace_and_may_end(run_units: StartRuntime) -> None:
    countdown = Transformation("count", outputs=source().outputs, source="running_units.py:countdown")
    runtime = run_units(countdown)
    runtime.apply(start(unit("count.1", topic="/result", port="n")))
    listener = Listener("/result")
    eventually(lambda: bool(seen(runtime, SourceExhausted)))
    assert list(runtime.environment.unit) == ["count.1"]
    eventually(lambda: listener.values[-1:] == [1])
    runtime.close()
    listener.join()


def test_an_element_can_have_a_time_of_its_own(run_units: StartRuntime) -> None:
    runtime = run_units(source(code="timed"), worker())
    runtime.apply(start(unit("count.1"), unit("work.1", topic="/result", x="count.1/n")))
    listener = Listener("/result")
    eventually(lambda: len(listener.received) > 5)
    runtime.close()
    listener.join()
    assert all(received.time_ns == received.value * 1_000_000_000 for received in listener.received)
