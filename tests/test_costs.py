"""Costs: exact integers of microseconds."""

from __future__ import annotations

from decimal import Decimal

import pytest

from cfgplan.costs import LARGEST_COST_US, keep_cost_us, microseconds, seconds, start_cost_us
from cfgplan.domain import Transformation
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
