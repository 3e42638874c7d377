"""Progression against the definition of the logic."""

from __future__ import annotations

from collections.abc import Iterator
from random import Random

import pytest
from cfgplan_runtime.reasoning.monitor import Monitor
from cfgplan_runtime.reasoning.parser import parse
from cfgplan_runtime.reasoning.program import folded
from cfgplan_runtime.reasoning.reader import Vocabulary
from cfgplan_runtime.reasoning.syntax import Atom, Constant, Formula
from cfgplan_runtime.reasoning.truth import Verdict
from direct import State, holds
from following import VERDICT, follow
from hypothesis import given, settings
from hypothesis import strategies as st
from random_formulas import ATOMS, formulas, formulas_over, formulas_that_look_far, three_values, traces

many = settings(max_examples=1200, deadline=None)


@many
@given(formulas, traces(three_values))
def test_progression_through_a_complete_trace_gives_what_the_formula_means(
    formula: Formula, trace: list[State]
) -> None:
    monitor = Monitor(formula)
    follow(monitor, trace)
    assert monitor.ended() == VERDICT[holds(formula, trace)]


@many
@given(formulas, traces(three_values, 6), traces(three_values, 6))
def test_an_early_verdict_is_right_however_the_stream_goes_on(
    formula: Formula, seen: list[State], more: list[State]
) -> None:
    monitor = Monitor(formula)
    verdict = follow(monitor, seen)
    allowed = monitor.possible
    whole = [*seen, *((time + seen[-1][0], state) for time, state in more)]
    meant = VERDICT[holds(formula, whole)]
    assert meant in allowed
    if verdict is not Verdict.OPEN:
        assert meant == verdict


@pytest.mark.parametrize(
    ("text", "verdict"),
    [
        ("eventually[0,3s] false", Verdict.FALSE),
        ("eventually[1s,3s] false", Verdict.FALSE),
        ("eventually true", Verdict.TRUE),
        ("eventually[1s,3s] true", Verdict.OPEN),
        ("always true", Verdict.TRUE),
        ("always[1s,2s] true", Verdict.TRUE),
        ("always false", Verdict.FALSE),
        ("always[1s,2s] false", Verdict.OPEN),
        ("not always (p or true)", Verdict.FALSE),
        ("always (p -> eventually (q or true))", Verdict.TRUE),
        ("p until false", Verdict.FALSE),
        ("p until[1s,2s] (q and false)", Verdict.FALSE),
        ("p until true", Verdict.TRUE),
        ("false until[1s,2s] q", Verdict.FALSE),
        ("false until eventually q", Verdict.OPEN),
        ("always p and eventually false", Verdict.FALSE),
        ("always p or always (false -> q)", Verdict.TRUE),
    ],
)
def test_what_constants_decide_is_decided_in_the_first_state(text: str, verdict: Verdict) -> None:
    monitor = Monitor(parse(text, Vocabulary(set(ATOMS), {})))
    assert follow(monitor, [(1, dict.fromkeys(ATOMS))]) == verdict


@given(formulas_over([Constant(False), Constant(True)]).filter(lambda formula: all(map(_is_now, walk(formula)))))
def test_constants_alone_are_a_constant_where_no_interval_begins_later(formula: Formula) -> None:
    assert isinstance(folded(formula), Constant)


@many
@given(formulas, traces(three_values))
def test_a_folded_formula_means_the_same(formula: Formula, trace: list[State]) -> None:
    assert holds(folded(formula), trace) == holds(formula, trace)


def walk(formula: Formula) -> Iterator[Formula]:
    yield formula
    for name in ("part", "left", "right"):
        if hasattr(formula, name):
            yield from walk(getattr(formula, name))


def _is_now(formula: Formula) -> bool:
    return not hasattr(formula, "interval") or formula.interval.begin_ns == 0


@settings(max_examples=150, deadline=None)
@given(formulas_that_look_far([Atom(name) for name in ATOMS]), st.integers(0, 2**32), st.sampled_from([5, 50, 95]))
def test_many_intervals_that_have_not_begun_are_followed_together(formula: Formula, seed: int, percent: int) -> None:
    source = Random(seed)
    trace: list[State] = []
    for _ in range(40):
        time = trace[-1][0] + source.choice([1, 1, 1, 2, 2, 3, 9]) if trace else 0
        state = {name: source.choice([True, None]) if source.randrange(100) < percent else False for name in ATOMS}
        trace.append((time, state))
    monitor = Monitor(formula)
    follow(monitor, trace)
    assert monitor.ended() == VERDICT[holds(formula, trace)]
