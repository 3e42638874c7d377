"""Failures of steps as reports: new ones at once, repeats as counts."""

from __future__ import annotations

from collections import Counter

from cfgplan_runtime.children.failures import Failures
from cfgplan_runtime.children.messages import Trouble
from cfgplan_runtime.errors import EncodingError

SECOND_NS = 1_000_000_000


def failing(error: Exception) -> Exception:
    """An exception that was raised, as unit code raises it."""
    try:
        raise error
    except Exception as raised:
        return raised


def failing_elsewhere(error: Exception) -> Exception:
    try:
        raise error
    except Exception as raised:
        return raised


def test_a_failure_of_each_element_is_one_report_and_then_counts_that_come_ever_less_often() -> None:
    failures, told = Failures(), list[tuple[int, Trouble]]()
    for step in range(1, 3001):  # ten a second
        now_ns = step * SECOND_NS // 10
        new = failures.take(failing(EncodingError(f"a value of type Pose can't be sent: {step}")), step, now_ns)
        told += [(now_ns, new)] if new is not None else []
        if step % 10 == 0:
            told += [(now_ns, more) for more in failures.due(now_ns)]
    told += [(now_ns, more) for more in failures.due(now_ns, is_last=True)]
    first, *repeats = (trouble for _, trouble in told)
    assert first == Trouble("can't be sent", 1, "a value of type Pose can't be sent: 1")
    assert {(one.kind, one.text) for one in repeats} == {(first.kind, first.text)}
    assert 1 + sum(one.suppressed for one in repeats) == repeats[-1].step == 3000
    assert [now_ns // SECOND_NS for now_ns, _ in told] == [0, 1, 2, 4, 8, 16, 32, 64, 124, 184, 244, 300]


def test_failures_of_different_types_places_or_words_are_reported_each() -> None:
    failures = Failures()
    errors = [
        failing(ValueError("no ball in 17")),
        failing_elsewhere(ValueError("no ball in 17")),
        failing(KeyError("no ball in 17")),
        failing(ValueError("no goal in 17")),
    ]
    assert all(failures.take(error, step, 0) for step, error in enumerate(errors))
    assert failures.take(failing(ValueError("no ball in 18")), 9, 0) is None
    assert [(one.step, one.suppressed) for one in failures.due(SECOND_NS)] == [(9, 1)]
    assert list(failures.due(100 * SECOND_NS, is_last=True)) == []


class UnsayableError(Exception):
    def __str__(self) -> str:
        raise RuntimeError("no words")


def test_an_exception_that_fails_to_say_what_it_is_is_reported_too() -> None:
    failures = Failures()
    told = failures.take(failing(UnsayableError()), 1, 0)
    assert told is not None and "UnsayableError" in told.text
    assert failures.take(failing(UnsayableError()), 2, 0) is None, "it is the same failure"


def test_failures_that_have_ended_make_room_for_new_ones() -> None:
    failures = Failures()
    for number in range(20):
        assert failures.take(failing(ValueError(chr(ord("a") + number))), number, 0)
    assert failures.take(failing(ValueError("a")), 20, SECOND_NS) is None
    later_ns = 60 * SECOND_NS
    new = failures.take(failing(ZeroDivisionError("by zero")), 21, later_ns)
    assert new is not None and "by zero" in new.text
    assert failures.take(failing(ValueError("a")), 22, later_ns) is None, "its repeats were not told yet"
    (more,) = failures.due(later_ns)
    assert (more.suppressed, "ValueError: a" in more.text) == (2, True)


def test_endless_kinds_of_failures_are_reported_up_to_a_number_and_all_are_counted() -> None:
    failures, words = Failures(), [chr(ord("a") + number % 26) * (1 + number // 26) for number in range(100)]
    told = [failures.take(failing(ValueError(word)), 1, 0) for word in words]
    more = [one.suppressed for one in failures.due(SECOND_NS)]
    assert Counter(one is None for one in told) == {False: 20, True: 80}
    assert sum(more) == 80
