"""Answer sets: they prove transports, agree with the oracle, and only time is lost without them."""

from __future__ import annotations

from dataclasses import replace
from threading import Event

import pytest
from hypothesis import given
from test_against_the_oracle import quality
from worlds import examples, histories, oracle_of, problems

from cfgplan.planners.exact import answer_sets
from cfgplan.planners.exact.answer_sets import LogicProgram
from cfgplan.planners.exact.memory import Structure
from cfgplan.planners.exact.session import PlannerSession
from cfgplan.planners.networks.network import LexicographicWeights
from cfgplan.planners.solving.clock import Clock
from cfgplan.planners.tuning import USUAL, Cycles
from cfgplan.planning import Problem, Status
from cfgplan.validity import plan_violations
from experiments.families.random_library import random_library
from experiments.families.transport import transport

pytest.importorskip("clingo")
ALWAYS = replace(USUAL, cycles=Cycles(labels=0, values=1000, near=1.0))


def program_of(problem: Problem) -> LogicProgram:
    structure = Structure.of(problem, None, Clock())
    weights = LexicographicWeights.with_changes(problem, structure.network)
    assert weights is not None
    return LogicProgram(structure.network, weights, Clock())


def agree(problem: Problem, session: PlannerSession) -> None:
    found = session.plan(problem)
    assert plan_violations(problem, found) == []
    assert quality(found) == quality(oracle_of(problem))


@examples(200)
@given(problems(special=False))
def test_answer_sets_equal_the_oracle_on_plain_problems(problem: Problem) -> None:
    agree(problem, PlannerSession(ALWAYS))


@examples(200, part=4)
@given(histories())
def test_answer_sets_equal_the_oracle_after_something_happened(history: list[tuple[Problem, object]]) -> None:
    session = PlannerSession(ALWAYS)
    for problem, _ in history:
        agree(problem, session)


@pytest.mark.parametrize("seed", range(3))
def test_transports_are_proven_without_the_constraint_model(seed: int) -> None:
    found = PlannerSession().plan(transport(seed, places=4, trucks=3, crates=8))
    assert found.status is Status.OPTIMAL
    assert found.ties_proven
    assert "rounds" not in found.counts


def test_without_the_extra_the_answer_is_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = transport(0, crates=5)
    usual = PlannerSession().plan(problem)
    monkeypatch.setattr("cfgplan.extras.find_spec", lambda _: None)
    monkeypatch.setattr(answer_sets, "LogicProgram", None)
    without = PlannerSession().plan(problem)
    assert quality(without) == quality(usual)
    assert plan_violations(problem, without) == []


def test_answer_sets_are_not_tried_where_costs_differ_much(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(answer_sets, "LogicProgram", None)
    assert PlannerSession().plan(random_library(0, transformations=200)).status is Status.OPTIMAL


def test_a_bound_by_too_few_conflicts_is_none_too_high() -> None:
    problem = transport(11, places=4, trucks=3, crates=8)
    program, best = program_of(problem), program_of(problem)
    assert best.run(100_000, Clock())
    assert not program.run(20, Clock())
    assert 0 < program.value < best.value


def test_what_is_stopped_tells_its_bound() -> None:
    stop = Event()
    stop.set()
    program = program_of(transport(7, places=8, trucks=4, crates=16, pallets=3))
    assert not program.run(10**9, Clock(stop=stop))
    assert program.conflicts < 100_000
