"""Progression against the definition of the logic."""

from __future__ import annotations

from random import Random

from cfgplan_runtime.reasoning.monitor import Monitor
from cfgplan_runtime.reasoning.syntax import Atom, Formula
from cfgplan_runtime.reasoning.truth import Verdict
from direct import State, holds
from following import VERDICT, follow
from hypothesis import given, settings
from hypothesis import strategies as st
from random_formulas import ATOMS, formulas, formulas_that_look_far, three_values, traces

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
