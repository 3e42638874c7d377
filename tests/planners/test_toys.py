"""Toys of four or five transformations, each hard for a planner that takes it for a large problem."""

from __future__ import annotations

from collections.abc import Iterator
from decimal import Decimal
from pathlib import Path
from typing import Any

import pytest
import yaml

from cfgplan import api
from cfgplan.costs import microseconds
from cfgplan.planners.cpsat import plan
from cfgplan.planners.exact import search
from cfgplan.planning import Problem, Status
from cfgplan.validity import plan_violations

TOYS = Path(__file__).parent / "toys"
ANSWERS: dict[str, dict[str, Any]] = yaml.load((TOYS / "answers.yaml").read_text(), yaml.BaseLoader)


def problem_of(name: str) -> Problem:
    return api.match(api.load(TOYS / f"{name}.yaml"))


def test_each_toy_has_an_answer() -> None:
    assert {path.stem for path in TOYS.glob("*.yaml")} == {*ANSWERS, "answers"}


@pytest.fixture
def rounds() -> Iterator[list[search.Search]]:
    """The rounds that searches have, one after the other."""
    found: list[search.Search] = []
    solver = search.Search.solver

    def counted(self: search.Search) -> Any:
        found.append(self)
        return solver(self)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(search.Search, "solver", counted)
        yield found


@pytest.mark.parametrize("name", ANSWERS)
def test_a_toy_is_proven_in_a_few_rounds_of_the_solver(name: str, rounds: list[search.Search]) -> None:
    problem, answer = problem_of(name), ANSWERS[name]
    found = plan(problem)
    assert plan_violations(problem, found) == []
    assert found.status == answer["status"]
    if found.status is Status.OPTIMAL:
        assert found.cost_us == found.bound_us == microseconds(Decimal(answer["cost"]))
        assert found.ties_proven
    assert len(rounds) <= 3
    assert all(one.model.cp.is_exact() for one in rounds)
