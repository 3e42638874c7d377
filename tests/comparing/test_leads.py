"""How far one planner is ahead: what was not proven counts with its limit, and what no one proved compares bounds."""

from __future__ import annotations

import pytest
from made_rows import row

from cfgplan.comparing import RunFailure
from experiments.planning.leads import lead, matched
from experiments.study.rows import Row


def test_a_lead_is_the_mean_ratio_of_times_to_proof() -> None:
    found = lead([(row("base", 1, 1.0), row("other", 1, 4.0)), (row("base", 1, 1.0), row("other", 1, 1.0))])
    assert found.ratio == pytest.approx(2.0)
    assert found.text() == "2"


def test_what_the_other_did_not_prove_counts_with_its_limit() -> None:
    found = lead([(row("base", 1, 0.5), row("other", 1))])
    assert found.text() == "≥ 10"


def test_what_the_base_did_not_prove_counts_against_it() -> None:
    found = lead([(row("base", 1), row("other", 1, 0.5))])
    assert found.text() == "≤ 0.1"


def test_where_neither_proved_anything_bounds_and_plans_compare() -> None:
    pairs = [
        (row("base", 10, bound_us=8), row("other", 12, bound_us=9)),
        (row("base", 10, bound_us=8), row("other", None)),
    ]
    assert lead(pairs).text() == "2 open: bounds 1:1, plans 2:0"


def test_the_first_of_several_to_prove_is_matched() -> None:
    rows = [row("base", 1, 1.0), row("slow", 1, 3.0), row("fast", 1, 2.0), row("never", 1)]
    ((base, other),) = matched(rows, "base", ["slow", "fast", "never"])
    assert (base.planner, other.planner) == ("base", "fast")


@pytest.mark.parametrize("outcome", [RunFailure.REFUSED, RunFailure.UNAVAILABLE])
def test_who_refuses_an_instance_is_not_matched(outcome: RunFailure) -> None:
    refused: Row = row("other", None, outcome=outcome, violations=None)
    assert list(matched([row("base", 1, 1.0), refused], "base", ["other"])) == []


@pytest.mark.parametrize("outcome", [RunFailure.CRASHED, RunFailure.OUT_OF_MEMORY, RunFailure.KILLED])
def test_who_fails_counts_as_not_having_proved(outcome: RunFailure) -> None:
    failed = row("other", None, outcome=outcome, violations=None)
    assert lead(matched([row("base", 1, 1.0), failed], "base", ["other"])).text() == "≥ 5"
