"""Progression against reelay, a public monitor for past formulas, on formulas that look ahead a bounded time."""

from __future__ import annotations

import pytest
from cfgplan_runtime.reasoning.monitor import Monitor
from cfgplan_runtime.reasoning.syntax import Always, And, Eventually, Formula, Implies, Interval, Not, Or, Until
from following import VERDICT, follow
from hypothesis import given, settings
from hypothesis import strategies as st
from past import horizon, past
from random_formulas import ATOMS, atoms

reelay = pytest.importorskip("reelay", reason="reelay is not installed: pip install reelay")

intervals = st.builds(lambda begin, length: Interval(begin, begin + length), st.integers(0, 2), st.integers(0, 3))


def _larger(parts: st.SearchStrategy[Formula]) -> st.SearchStrategy[Formula]:
    return st.one_of(
        st.builds(Not, parts),
        *(st.builds(kind, parts, parts) for kind in (And, Or, Implies)),
        *(st.builds(kind, parts, intervals) for kind in (Always, Eventually)),
        st.builds(Until, parts, parts, intervals),
    )


@settings(max_examples=150, deadline=None)
@given(st.recursive(atoms, _larger, max_leaves=4), st.data())
def test_the_verdict_is_that_of_reelay_on_the_formula_turned_to_the_past(formula: Formula, data: st.DataObject) -> None:
    ahead = horizon(formula)
    truths = st.fixed_dictionaries({name: st.booleans() for name in ATOMS})
    states = data.draw(st.lists(truths, min_size=ahead + 1, max_size=ahead + 1))
    peer = reelay.discrete_timed_monitor(past(formula, ahead), condense=False)
    said = [peer.update(state)["value"] for state in states]
    assert follow(Monitor(formula), list(enumerate(states))) == VERDICT[said[ahead]]
