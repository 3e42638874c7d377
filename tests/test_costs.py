"""Costs: exact integers of microseconds."""

from __future__ import annotations

from decimal import Decimal

import pytest

from cfgplan.costs import (
    LARGEST_COST_US,
    keep_cost_us,
    microseconds,
    seconds,
    standby_cost_us,
    start_cost_us,
    taken,
)
from cfgplan.domain import CPU, Host, Transformation
from cfgplan.errors import InvalidValueError


@pytest.mark.parametrize(("text", "expected"), [("0.3", 300_000), ("1e-6", 1), ("20.5", 20_500_000), ("0", 0)])
def test_decimal_text_is_converted_exactly(text: str, expected: int) -> None:
    assert microseconds(Decimal(text)) == expected


@pytest.mark.parametrize("text", ["-1", "NaN", "Infinity", "0.0000001", "1e300"])
def test_what_is_no_cost_is_refused(text: str) -> None:
    with pytest.raises(InvalidValueError):
        microseconds(Decimal(text))


def test_seconds_reverse_microseconds() -> None:
    for cost_us in (0, 1, 300_000, LARGEST_COST_US):
        assert seconds(cost_us) * 1_000_000 == cost_us


def test_keeping_costs_upkeep_and_starting_costs_labor_too() -> None:
    transformation = Transformation("t", labor_us=7, upkeep_us=2)
    assert keep_cost_us(transformation, 10) == 20
    assert start_cost_us(transformation, 10) == 27


def test_on_a_host_of_half_the_speed_all_costs_twice_as_much() -> None:
    transformation, slow = Transformation("t", labor_us=7, upkeep_us=2, standby_us=1), Host("slow", speed=500_000)
    assert keep_cost_us(transformation, 10, slow) == 40
    assert start_cost_us(transformation, 10, slow) == 54
    assert standby_cost_us(transformation, 10, slow) == 20
    assert taken(transformation, slow)[CPU] == 4


def test_each_second_on_a_host_is_rounded_up_to_a_microsecond() -> None:
    assert keep_cost_us(Transformation("t", upkeep_us=2), 10, Host("fast", speed=3_000_000)) == 10


def test_what_was_seen_on_a_host_counts_instead_of_its_speed() -> None:
    seen, slow = Transformation("t", labor_us=7, upkeep_us=2, seen_us={"slow": (1, 3)}), Host("slow", speed=500_000)
    assert start_cost_us(seen, 10, slow) == 31
    assert taken(seen, slow)[CPU] == 3


def test_a_host_without_speed_is_refused() -> None:
    with pytest.raises(InvalidValueError, match="Host 'dead': speed must be a whole number of 1 or more"):
        Host("dead", speed=0)
