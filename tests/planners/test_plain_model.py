"""The plain model against the enumeration on small problems, and the planner against the plain model on larger ones."""

from __future__ import annotations

import pytest
from hypothesis import assume, given, reject
from hypothesis import strategies as st
from kinds import KINDS, LeftOpenError, sets_of_units
from plain_model import MOST_UNITS, Optimum, TooLargeError, number_of_units, optimum
from test_toys import ANSWERS, problem_of
from worlds import examples, oracle_of

from cfgplan.planning import Feature, Problem

SMALL = ["plain", "optional", "counts", "limits", "quality", "quality of several", "hosts", "latency", "company",
         "order", "runs", "wiring"]  # fmt: skip


@pytest.mark.parametrize("kind", SMALL)
@examples(10)
@given(data=st.data())
def test_the_plain_model_equals_the_enumeration(kind: str, data: st.DataObject) -> None:
    problem: Problem = data.draw(KINDS[kind].drawn)
    assume(Feature.SURVIVAL not in problem.features)
    assume(sets_of_units(problem) < 500 and number_of_units(problem) <= MOST_UNITS)
    assert optimum(problem) == Optimum.of(oracle_of(problem))


@pytest.mark.parametrize("kind", ["larger", "far apart"])
@examples(20)
@given(data=st.data())
def test_the_planner_equals_the_plain_model(kind: str, data: st.DataObject) -> None:
    drawn = data.draw(KINDS[kind].drawn)
    try:
        assert KINDS[kind].differences(drawn) == []
    except LeftOpenError:
        reject()


@pytest.mark.parametrize("name", ANSWERS)
def test_the_plain_model_has_the_answers_of_toys(name: str) -> None:
    found = optimum(problem_of(name))
    assert found.status == ANSWERS[name]["status"]


def test_the_plain_model_refuses_what_it_does_not_know(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = problem_of("two-qualities")
    monkeypatch.setattr("plain_model.MOST_UNITS", 1)
    with pytest.raises(TooLargeError, match="units"):
        optimum(problem)
