"""Progression against the definition of the logic."""

from __future__ import annotations

from cfgplan_runtime.reasoning.monitor import Monitor
from cfgplan_runtime.reasoning.syntax import Formula
from cfgplan_runtime.reasoning.truth import Verdict
from direct import State, holds
from following import VERDICT, follow
from hypothesis import given, settings
from random_formulas import formulas, three_values, traces

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
