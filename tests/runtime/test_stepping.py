"""What starts a step. No process."""

from __future__ import annotations

from collections.abc import Sequence

import pytest
from cfgplan_runtime.children.steps import StepQueue
from cfgplan_runtime.streams.element import Element

from cfgplan.rows import ALL


def steps(
    start: str, arrivals: Sequence[tuple[str, int]], *, tolerance_ns: int = 0, limit: int = 100
) -> list[dict[str, int]]:
    """The times of the elements of each step, given (port, time) in the order of arrival."""
    queue = StepQueue(["a", "b"], start=start, tolerance_ns=tolerance_ns, limit=limit)
    found = []
    for number, (port, time_ns) in enumerate(arrivals):
        queue.put(port, Element(time_ns, 0, number, b""), may_drop=True)
        while (step := queue.next()) is not None:
            found.append({name: element.time_ns for name, element in step.elements.items()})
    return found


def test_all_takes_one_fresh_element_of_each_input() -> None:
    assert steps("all", [("a", 1), ("a", 2), ("b", 5), ("b", 6)]) == [{"a": 1, "b": 5}, {"a": 2, "b": 6}]


def test_any_takes_each_element_with_the_latest_of_the_others() -> None:
    found = steps("any", [("a", 1), ("b", 2), ("b", 3), ("a", 4)])
    assert found == [{"a": 1, "b": 2}, {"a": 1, "b": 2}, {"a": 1, "b": 3}, {"a": 4, "b": 3}]


def test_no_step_starts_before_every_input_had_an_element() -> None:
    assert steps("any", [("a", 1), ("a", 2)]) == []
    assert steps("a", [("a", 1), ("a", 2)]) == []


def test_a_named_input_sets_the_pace() -> None:
    found = steps("a", [("b", 1), ("a", 2), ("b", 3), ("b", 4), ("a", 5)])
    assert found == [{"a": 2, "b": 1}, {"a": 5, "b": 4}]


def test_elements_wait_until_the_other_inputs_have_one() -> None:
    assert steps("a", [("a", 1), ("a", 2), ("b", 3)]) == [{"a": 1, "b": 3}, {"a": 2, "b": 3}]


def test_aligned_skips_what_finds_no_partner() -> None:
    found = steps("aligned", [("a", 1), ("a", 2), ("b", 2), ("b", 3), ("a", 4), ("b", 4)])
    assert found == [{"a": 2, "b": 2}, {"a": 4, "b": 4}]


def test_aligned_accepts_times_within_the_tolerance() -> None:
    assert steps("aligned", [("a", 10), ("b", 12)], tolerance_ns=2) == [{"a": 10, "b": 12}]
    assert steps("aligned", [("a", 10), ("b", 13)], tolerance_ns=2) == []


def test_a_full_queue_drops_the_oldest_and_counts_it() -> None:
    queue = StepQueue(["a", "b"], start="all", tolerance_ns=0, limit=2)
    for time_ns in (1, 2, 3):
        queue.put("a", Element(time_ns, 0, 0, b""), may_drop=True)
    queue.put("b", Element(9, 0, 0, b""), may_drop=True)
    step = queue.next()
    assert step is not None
    assert step.elements["a"].time_ns == 2
    assert step.moment == (9, 0)
    assert queue.dropped == {"a": 1, "b": 0}


def test_a_queue_that_may_not_drop_only_says_that_it_is_full() -> None:
    queue = StepQueue(["a"], start="all", tolerance_ns=0, limit=2)
    for time_ns in (1, 2, 3):
        queue.put("a", Element(time_ns, 0, 0, b""), may_drop=False)
    assert queue.is_full("a")
    assert queue.waiting("a") == 3


def _element(time_ns: int) -> Element:
    return Element(time_ns, 0, 0, b"")


@pytest.mark.parametrize("loose", ["optional", "services"])
def test_a_step_waits_neither_for_an_optional_input_nor_for_a_service(loose: str) -> None:
    queue = StepQueue(["a", "b"], start="all", tolerance_ns=0, limit=2, **{loose: ["b"]})  # type: ignore[arg-type]
    queue.put("a", _element(1), may_drop=True)
    first = queue.next()
    assert first is not None and set(first.elements) == {"a"}
    queue.put("b", _element(2), may_drop=True)
    assert queue.next() is None
    queue.put("a", _element(3), may_drop=True)
    second = queue.next()
    assert second is not None and second.elements["b"].time_ns == 2
    queue.forget("b")
    queue.put("a", _element(4), may_drop=True)
    third = queue.next()
    assert third is not None and set(third.elements) == {"a"}


def test_an_optional_input_starts_steps_where_any_does_and_a_service_does_not() -> None:
    queue = StepQueue(["a", "b"], start="any", tolerance_ns=0, limit=2, optional=["a"], services=["b"])
    queue.put("b", _element(1), may_drop=True)
    assert queue.next() is None
    queue.put("a", _element(2), may_drop=True)
    step = queue.next()
    assert step is not None and set(step.elements) == {"a", "b"}


def test_where_all_inputs_are_optional_each_element_starts_a_step() -> None:
    queue = StepQueue(["a", "b"], start="all", tolerance_ns=0, limit=2, optional=["a", "b"])
    assert queue.next() is None
    queue.put("a", _element(1), may_drop=True)
    step = queue.next()
    assert step is not None and set(step.elements) == {"a"}
    assert queue.next() is None


@pytest.mark.parametrize(
    ("start", "waiting", "still", "rests"),
    [
        ("all", "", "a", True),
        ("all", "a", "a", False),
        ("all", "b", "a", True),
        ("aligned", "b", "a", True),
        ("any", "", "a", False),
        ("any", "", "ab", True),
        ("any", "b", "ab", False),
        ("a", "", "a", True),
        ("a", "b", "b", False),
        ("all", "", "", False),
        ("any", "", "", False),
    ],
)
def test_steps_rest_on_a_source_that_pauses_if_none_can_begin_without_it(
    start: str, waiting: str, still: str, rests: bool
) -> None:
    queue = StepQueue(["a", "b"], start=start, tolerance_ns=0, limit=10)
    for number, inlet in enumerate(waiting):
        queue.put(inlet, Element(number, 0, 0, b""), may_drop=True)
    assert queue.rests_on([*still]) == rests


def test_a_port_of_all_streams_rests_once_each_of_them_pauses() -> None:
    queue = StepQueue(["a"], start="all", tolerance_ns=0, limit=10, counts={"a": ALL})
    for inlet in ("a/1", "a/2"):
        queue.put(inlet, Element(1, 0, 0, b""), may_drop=True)
    assert queue.next() is not None
    assert not queue.rests_on(["a/1"])
    assert queue.rests_on(["a/1", "a/2"])
