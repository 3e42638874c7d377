"""Sums of what elements say of their own quality, whatever unit code gives."""

from __future__ import annotations

from math import isfinite

import numpy
import pytest
from cfgplan_runtime.streams.measured_stream import MeasuredStream, Quality
from cfgplan_runtime.streams.said_qualities import SaidQualities


class _Unconvertible:
    def __float__(self) -> float:
        raise RuntimeError("more than one value")


@pytest.mark.parametrize("numbers", [(1.7e308, -1.7e308, 3.0), (1e300, -1e300), (-1e13, 10**300)])
def test_sums_of_huge_numbers_are_finite(numbers: tuple[float, ...]) -> None:
    said = SaidQualities({"p": {"error": "how.error"}})
    for number in numbers:
        assert said.take("p", {"how": {"error": number}}, {}) == []
    sums = said.taken()["p"]["error"]
    assert (sums.elements, isfinite(sums.mean), isfinite(sums.squares)) == (len(numbers), True, True)


@pytest.mark.parametrize(
    "said", ["0.3", b"1", None, True, [1.0], {"a": 1}, 1j, 10**400, float("nan"), _Unconvertible()]
)
def test_what_is_no_number_is_told_once_and_is_no_part_of_the_sums(said: object) -> None:
    taken = SaidQualities({"p": {"error": "error"}})
    (fault,) = taken.take("p", {"error": said}, {})
    assert fault.startswith("output p does not say its error: ")
    assert taken.take("p", {"error": said}, {}) == []
    assert taken.taken() == {}


def test_bad_values_between_good_ones_are_told_once() -> None:
    taken = SaidQualities({"p": {"error": "error"}})
    told = [fault for number in range(500) for fault in taken.take("p", {"error": 0.1} if number % 2 else {}, {})]
    assert len(told) == 1
    for _ in range(100):
        taken.take("p", {"error": 0.1}, {})
    assert len(taken.take("p", {}, {})) == 1


@pytest.mark.parametrize(
    "value", [{"covariance": [0.3, 9.0]}, {"covariance": (0.3,)}, {"covariance": numpy.array([0.3])}]
)
def test_a_number_leads_into_a_list(value: object) -> None:
    taken = SaidQualities({"p": {"error": "covariance.0"}})
    assert taken.take("p", value, {}) == []
    assert taken.taken()["p"]["error"] == (1, 0.3, 0.0)


@pytest.mark.parametrize("value", [{"covariance": []}, {"covariance": 0.3}, {"covariance": {"1": 0.3}}])
def test_a_list_that_is_too_short_has_no_such_field(value: object) -> None:
    (fault,) = SaidQualities({"p": {"error": "covariance.0"}}).take("p", value, {})
    assert fault == "output p does not say its error: a value has no field 'covariance.0'"


def test_sums_of_two_halves_are_those_of_the_whole() -> None:
    whole, first, second = (Quality(0, 0.0, 0.0) for _ in range(3))
    for number in range(10):
        one = Quality(1, number**1.5, 0.0)
        whole = whole.with_more(one)
        first, second = (first.with_more(one), second) if number % 3 else (first, second.with_more(one))
    assert first.with_more(second) == pytest.approx(whole)
    assert whole.with_more(Quality(0, 0.0, 0.0)) == whole


KINDS = {"hz": "rate", "delay": "age", "unrest": "jitter"}


def test_rate_age_and_jitter_of_a_stream_are_measured() -> None:
    stream = MeasuredStream(KINDS)
    assert stream.taken(5.0) == {}
    for number in range(11):
        stream.note(0.1 + number / 100, 10 + number / 10 + (number % 2) * 0.01)
    found = stream.taken(11.01)
    assert found["hz"] == Quality(1, pytest.approx(10 / 1.01), 0.0)
    assert found["delay"].mean == pytest.approx(0.15)
    assert found["unrest"] == (9, pytest.approx(0.02), pytest.approx(0.0, abs=1e-12))  # 0.11, 0.09, 0.11 s, ...


def test_a_stream_that_falls_silent_has_a_rate_of_0_and_no_age() -> None:
    stream = MeasuredStream(KINDS)
    stream.note(0.1, 0.0)
    stream.note(0.1, 0.5)
    assert stream.taken(1.0)["hz"].mean == 1.0
    assert stream.taken(2.0) == {"hz": Quality(1, 0.0, 0.0)}


def test_a_rate_is_not_measured_over_a_moment() -> None:
    stream = MeasuredStream({"hz": "rate"})
    stream.note(0.0, 0.0)
    stream.note(0.0, 0.001)
    assert stream.taken(0.002) == {}
    stream.note(0.0, 0.999)
    assert stream.taken(1.0)["hz"].mean == 2.0


def test_what_is_measured_needs_no_field() -> None:
    taken = SaidQualities({"p": {"hz": "measured.rate", "delay": "measured.age"}})
    assert taken.take("p", None, {}) == []
    taken.note("p", 0.25)
    assert taken.taken() == {"p": {"delay": Quality(1, 0.25, 0.0)}}
