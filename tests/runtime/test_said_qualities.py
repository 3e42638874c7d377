"""Sums of what elements say of their own quality, whatever unit code gives."""

from __future__ import annotations

from collections.abc import Iterable
from math import inf, isfinite, sqrt
from random import Random

import numpy
import pytest
from cfgplan_runtime.streams.measured_stream import MeasuredStream, Quality
from cfgplan_runtime.streams.said_qualities import SaidQualities
from hypothesis import given
from hypothesis import strategies as st

from cfgplan.observed import NEWS_ERRORS, Figures, Window


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


ORDINARY, HUGE = st.floats(0.05, 1.0), st.floats(1001.0, 1e12)


def sums_of(numbers: Iterable[float]) -> tuple[Quality, list[str]]:
    said = SaidQualities({"p": {"error": "error"}})
    faults = [fault for number in numbers for fault in said.take("p", {"error": number}, {})]
    return said.taken()["p"]["error"], faults


@given(st.lists(ORDINARY, min_size=2), st.lists(st.tuples(st.lists(HUGE, max_size=2), st.lists(ORDINARY, min_size=3))))
def test_absurd_numbers_do_not_count_and_are_told(
    begin: list[float], rest: list[tuple[list[float], list[float]]]
) -> None:
    series = [*begin, *(number for spike, calm in rest for number in (*spike, *calm))]
    sums, faults = sums_of(series)
    assert sums == sums_of(number for number in series if number <= 1.0)[0]
    told = [number for number in series[:-5] if number > 1.0]
    assert len(faults) >= bool(told)
    assert not faults or faults[0].startswith(f"output p says {told[0]:g} as its error, more than 1000 times")


@given(st.lists(ORDINARY, min_size=3), st.lists(st.floats(101.0, 5000.0), min_size=3))
def test_numbers_that_are_huge_from_now_on_all_count(before: list[float], after: list[float]) -> None:
    sums, faults = sums_of([*before, *after])
    assert (sums.elements, faults) == (len(before) + len(after), [])
    assert sums.mean == pytest.approx(sum([*before, *after]) / sums.elements)


@given(st.lists(st.floats(1.0, 1000.0), min_size=1))
def test_bursts_count(latencies: list[float]) -> None:
    sums, faults = sums_of(latencies)
    assert (sums.elements, faults) == (len(latencies), [])


@given(st.lists(st.sampled_from((0.0, 1.0)), min_size=1), st.integers(1, 5))
def test_no_number_among_zeros_is_absurd(numbers: list[float], zeros: int) -> None:
    series = [each for number in numbers for each in (*[0.0] * zeros, number)]
    assert sums_of(series)[0].elements == len(series)


@pytest.mark.parametrize("rate", [1, 5, 20])
def test_a_change_after_an_absurd_number_is_noticed_at_once(rate: int) -> None:
    """Before, the absurd number hid it for two to five minutes."""
    chance, said, window = Random(1), SaidQualities({"p": {"error": "error"}}), Window(0.0)

    def heard(at_s: int, level: float, *more: float) -> tuple[float, float]:
        nonlocal window
        for number in (*more, *(chance.gauss(level, 0.04) for _ in range(rate - len(more)))):
            said.take("p", {"error": number}, {})
        quality = said.taken().get("p", {}).get("error", Quality(0, 0.0, 0.0))
        window = window.after(Figures(*quality), at_s)
        sample = window.sample
        return (0.2, inf) if sample is None else (sample.mean, sqrt(sample.variance))

    for at_s in range(1, 60):
        heard(at_s, 0.2)
    heard(60, 0.2, 65_535.0)
    for at_s in range(61, 70):
        heard(at_s, 0.2)
    for at_s in range(70, 79):
        mean, error = heard(at_s, 0.8)
        if abs(mean - 0.2) > NEWS_ERRORS * error:
            return
    pytest.fail("the change was not noticed within 9 s")


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
