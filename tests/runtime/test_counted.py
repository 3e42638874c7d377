"""Inputs that take several streams: their steps, their wires, and what units get while streams come and go."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import pytest
from cfgplan_runtime import SimulatedRuntime, StaleChangeSetError
from cfgplan_runtime.children.steps import StepQueue
from cfgplan_runtime.streams.element import Element
from cfgplan_runtime.supervision.backend import Inlet
from cfgplan_runtime.supervision.events import UnitDied
from cfgplan_runtime.supervision.wiring import starved_units, wanted_feeds, without_feed
from unit_signals import signal_unit
from watching import Listener, StartRuntime, seen
from world import RESULT, eventually, source, start, unit, worker

from cfgplan.domain import (
    ALL,
    ChangeSet,
    ComputationUnit,
    Environment,
    InputPort,
    RunOptions,
    Stream,
    Subscription,
    Transformation,
)


def steps(
    start: str, arrivals: Sequence[tuple[str, int]], *, count: int, optional: Sequence[str] = ()
) -> list[dict[str, int | list[int]]]:
    """The times of each step's elements, given (inlet, time) in order of arrival; time 0: the inlet's source is lost.

    The input x takes `count` streams, y takes one.
    """
    queue = StepQueue(["x", "y"], start=start, tolerance_ns=0, limit=9, optional=optional, counts={"x": count})
    found = []
    for number, (inlet, time_ns) in enumerate(arrivals):
        if time_ns:
            queue.put(inlet, Element(time_ns, 0, number, b""), may_drop=True)
        else:
            queue.forget(inlet)
        while (step := queue.next()) is not None:
            found.append({port: times(elements) for port, elements in step.elements.items()})
    return found


def times(elements: Element | list[Element]) -> int | list[int]:
    return elements.time_ns if isinstance(elements, Element) else [element.time_ns for element in elements]


@pytest.mark.parametrize(
    ("start", "arrivals", "found"),
    [
        ("all", [("x/2", 1), ("y", 1), ("x/2", 2), ("x/1", 3)], [{"x": [1, 3], "y": 1}]),
        ("any", [("x/2", 1), ("y", 1), ("x/1", 3)], [{"x": [1, 3], "y": 1}] * 3),
        ("aligned", [("x/1", 1), ("x/2", 2), ("y", 2), ("x/1", 2)], [{"x": [2, 2], "y": 2}]),
        ("x", [("x/1", 5), ("y", 7), ("x/2", 6), ("x/2", 8)], [{"x": [5, 6], "y": 7}] * 2 + [{"x": [5, 8], "y": 7}]),
        ("y", [("x/1", 5), ("y", 7), ("x/2", 4), ("x/1", 8)], [{"x": [4, 5], "y": 7}]),
    ],
)
def test_an_input_of_k_streams_is_like_k_inputs(
    start: str, arrivals: Sequence[tuple[str, int]], found: list[dict[str, int | list[int]]]
) -> None:
    assert steps(start, arrivals, count=2) == found


@pytest.mark.parametrize(
    ("start", "arrivals", "found"),
    [
        ("all", [("x/1", 2), ("x/2", 1), ("y", 3), ("y", 4), ("x/2", 5)], [{"x": [1, 2], "y": 3}, {"x": [5], "y": 4}]),
        (
            "any",
            [("y", 1), ("x/1", 2), ("x/2", 3), ("x/1", 0), ("x/2", 4)],
            [{"x": [2], "y": 1}] * 2 + [{"x": [2, 3], "y": 1}, {"x": [4], "y": 1}],
        ),
        ("any", [("y", 1), ("x/1", 2), ("x/1", 0), ("y", 3)], [{"x": [2], "y": 1}] * 2),
        (
            "aligned",
            [("x/1", 1), ("x/2", 1), ("y", 1), ("y", 2), ("x/2", 2), ("x/1", 0)],
            [{"x": [1, 1], "y": 1}, {"x": [2], "y": 2}],
        ),
        ("x", [("y", 1), ("x/1", 2), ("x/2", 3)], [{"x": [2], "y": 1}, {"x": [2, 3], "y": 1}]),
        ("y", [("y", 1), ("x/3", 2), ("x/1", 3), ("y", 4)], [{"x": [2], "y": 1}, {"x": [2, 3], "y": 4}]),
    ],
)
def test_an_input_of_all_streams_is_like_those_that_have_an_element(
    start: str, arrivals: Sequence[tuple[str, int]], found: list[dict[str, int | list[int]]]
) -> None:
    assert steps(start, arrivals, count=ALL) == found


def test_what_has_come_before_a_stream_ended_is_still_taken() -> None:
    arrivals = [("x/1", 1), ("x/2", 2), ("x/1", 0), ("y", 3), ("y", 4)]
    assert steps("any", arrivals, count=ALL)[-1] == {"x": [2], "y": 4}
    assert steps("all", arrivals, count=ALL) == [{"x": [1, 2], "y": 3}]


@pytest.mark.parametrize("count", [2, ALL])
def test_an_unfed_optional_input_of_several_streams_has_an_empty_list(count: int) -> None:
    arrivals = [("y", 1), ("x/1", 2), ("x/2", 3), ("y", 4), ("x/1", 0), ("y", 5)]
    found = [{"x": [], "y": 1}, {"x": [2, 3], "y": 4}, {"x": [3], "y": 5}]
    assert steps("all", arrivals, count=count, optional=["x"]) == found


def test_each_stream_has_a_queue_of_its_own() -> None:
    queue = StepQueue(["x"], start="all", tolerance_ns=0, limit=2, counts={"x": 2})
    for inlet, time_ns in [("x/1", 1), ("x/1", 2), ("x/1", 3), ("x/2", 4)]:
        queue.put(inlet, Element(time_ns, 0, 0, b""), may_drop=True)
    assert (queue.dropped, queue.waiting("x"), queue.is_full("x/1"), queue.is_full("x/2")) == ({"x": 1}, 3, True, False)


def gather(count: int, start: str = "all", **more: bool) -> Transformation:
    """What it gives are the lists that its input x gets."""
    return replace(worker("gather", run=RunOptions(start=start)), inputs=(InputPort("x", "N", count=count, **more),))


def gathering(*streams: str) -> ComputationUnit:
    feeds = tuple(Subscription("x", Stream.parse(stream)) for stream in streams)
    return replace(unit("gather.1", topic="/result"), subscriptions=feeds)


def wires(environment: Environment, present: dict[Inlet, Stream]) -> dict[str, str]:
    found = wanted_feeds(environment, present)
    return {inlet.port: stream.unit for inlet, stream in found.items() if not inlet.is_outlet}


def test_streams_keep_their_inlets_and_a_new_one_takes_that_of_one_that_goes() -> None:
    before = Environment((gathering("b/n", "c/n", "d/n"),), (gather(ALL),), (RESULT,))
    present = {Inlet("gather.1", f"x/{n}"): Stream(name, "n") for n, name in enumerate("bcd", start=1)}
    assert wires(before, {}) == wires(before, present) == {"x/1": "b", "x/2": "c", "x/3": "d"}
    swapped = replace(before, units=(gathering("a/n", "b/n", "d/n"),))
    assert wires(swapped, present) == {"x/1": "b", "x/2": "a", "x/3": "d"}
    fewer = replace(before, units=(gathering("d/n"),))
    assert wires(fewer, present) == {"x/3": "d"}
    more = replace(before, units=(gathering("a/n", "d/n"),))
    assert wires(more, {Inlet("gather.1", "x/3"): Stream("d", "n")}) == {"x/3": "d", "x/1": "a"}


def test_a_gap_is_at_one_of_the_streams() -> None:
    before = Environment((gathering("a/n", "b/n"),), (gather(2),), (RESULT,))
    after = without_feed(before, Inlet("gather.1", "x/2"), Stream("a", "n"))
    assert after.unit["gather.1"] == gathering("b/n")


@pytest.mark.parametrize(("count", "start", "starves"), [(2, "all", True), (2, "any", False), (ALL, "all", False)])
def test_an_input_of_k_streams_starves_with_less(count: int, start: str, starves: bool) -> None:
    units = (unit("count.1"), gathering("count.1/n"))
    assert ("gather.1" in starved_units(Environment(units, (source(), gather(count, start))))) is starves


def test_more_streams_than_an_input_takes_are_refused() -> None:
    with SimulatedRuntime([source(), gather(2)], [RESULT]) as runtime:
        units = [unit(f"count.{n}") for n in range(3)]
        with pytest.raises(StaleChangeSetError, match=r"input x of gather\.1 takes 2 streams, not 3"):
            runtime.apply(start(*units, gathering(*(f"{each.id}/n" for each in units))))


def test_one_stream_less_is_noted_and_comes_back() -> None:
    with SimulatedRuntime([source(), gather(2)], [RESULT]) as runtime:
        counts, both = (unit("count.1"), unit("count.2")), gathering("count.1/n", "count.2/n")
        runtime.apply(start(*counts, both))
        runtime.cut("gather.1", "x/2")
        assert runtime.environment.unit["gather.1"] == gathering("count.1/n")
        runtime.apply(ChangeSet(rewired=(both,)))
        assert runtime.environment.unit["gather.1"] == both
        assert runtime.backend.calls[-1] == ("connect", "count.2/n", "gather.1/x/2")


def test_replacing_one_of_k_units_loses_nothing_of_any(run_units: StartRuntime) -> None:
    runtime = run_units(source(), worker(), gather(3))
    works = [unit(f"work.{n}", x="count.1/n") for n in range(1, 4)]
    runtime.apply(start(unit("count.1"), *works, gathering(*(f"{each.id}/y" for each in works))))
    listener = Listener("/result")
    eventually(lambda: len(listener.received) > 10)
    for number in range(4, 10):
        works = [*works[1:], unit(f"work.{number}", x="count.1/n")]
        applied = runtime.apply(
            ChangeSet((works[-1],), (gathering(*(f"{each.id}/y" for each in works)),), (f"work.{number - 3}",))
        )
        assert applied.unswitched == 0
    last = len(listener.received)
    eventually(lambda: len(listener.received) > last + 10)
    runtime.close()
    listener.join()
    assert all(len(value) == 3 for value in listener.values)
    for one_stream in zip(*listener.values, strict=True):
        assert {after - before for before, after in pairwise(one_stream)} == {1}


def test_streams_come_and_go_at_an_input_of_all_and_the_others_lose_nothing(run_units: StartRuntime) -> None:
    names = ("a", "b", "c")
    library = [replace(source(name, "named"), params={"name": name}) for name in names]
    runtime = run_units(*library, gather(ALL))
    runtime.apply(start(unit("a.1"), unit("b.1"), gathering("a.1/n", "b.1/n")))
    listener = Listener("/result")

    def came(name: str) -> list[int]:
        return [number for value in list(listener.values) for one, number in value if one == name]

    eventually(lambda: bool(came("a") and came("b")))
    runtime.apply(ChangeSet((unit("c.1"),), (gathering("a.1/n", "b.1/n", "c.1/n"),)))
    eventually(lambda: len(came("c")) > 5)
    runtime.apply(ChangeSet(rewired=(gathering("a.1/n", "c.1/n"),), stopped=("b.1",)))
    signal_unit(runtime, "c.1")
    eventually(lambda: bool(seen(runtime, UnitDied)))
    assert runtime.environment.unit["gather.1"] == gathering("a.1/n")
    before = len(came("a"))
    eventually(lambda: len(came("a")) > before + 5)
    runtime.apply(ChangeSet((unit("c.2"),), (gathering("a.1/n", "c.2/n"),)))
    ended = len(came("c"))
    eventually(lambda: len(came("c")) > ended + 5)
    eventually(lambda: any(o.inputs["x"].elements > len(came("b")) > 0 for o in runtime.observe() if o.inputs))
    runtime.close()
    listener.join()
    assert {after - before for before, after in pairwise(came("a"))} == {1}
