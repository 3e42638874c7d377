"""The planner finds what it found before."""

from __future__ import annotations

import json

import pytest
from golden import FILE, problems, row

from cfgplan.planners import PLANNERS

PROBLEMS, KEPT = problems(), json.loads(FILE.read_text(encoding="utf-8"))


def test_every_instance_has_a_plan_that_is_kept() -> None:
    assert PROBLEMS.keys() == KEPT.keys()
    assert len(KEPT) >= 110


@pytest.mark.parametrize("name", PROBLEMS)
def test_the_plan_costs_and_changes_what_it_did(name: str) -> None:
    assert row(PLANNERS["cpsat"](PROBLEMS[name]())) == KEPT[name]
