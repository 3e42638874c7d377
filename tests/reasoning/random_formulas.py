"""Formulas and traces for Hypothesis."""

from __future__ import annotations

from collections.abc import Sequence

from cfgplan_runtime.reasoning.syntax import (
    ALL_TIME,
    Always,
    And,
    Atom,
    Constant,
    Eventually,
    Formula,
    Implies,
    Interval,
    Not,
    Or,
    Until,
)
from direct import State
from hypothesis import strategies as st

ATOMS = ("p", "q", "r")


def _interval(begin: int, length: int | None) -> Interval:
    return Interval(begin, None if length is None else begin + length)


intervals = st.one_of(
    st.just(ALL_TIME),
    st.builds(_interval, st.integers(0, 4), st.integers(0, 6)),
    st.builds(_interval, st.just(0), st.integers(0, 8)),
    st.builds(_interval, st.integers(1, 4), st.none()),
)


def _larger(parts: st.SearchStrategy[Formula]) -> st.SearchStrategy[Formula]:
    return st.one_of(
        st.builds(Not, parts),
        *(st.builds(kind, parts, parts) for kind in (And, Or, Implies)),
        *(st.builds(kind, parts, intervals) for kind in (Always, Eventually)),
        st.builds(Until, parts, parts, intervals),
    )


late_intervals = st.builds(_interval, st.integers(4, 12), st.one_of(st.none(), st.integers(0, 12)))


def formulas_that_look_far(parts: Sequence[Formula]) -> st.SearchStrategy[Formula]:
    """Small formulas, about every state, with intervals that begin late."""
    least = st.sampled_from(parts)
    late = st.one_of(
        *(st.builds(kind, least, late_intervals) for kind in (Always, Eventually)),
        st.builds(Until, least, least, late_intervals),
    )
    both = st.one_of(late, late, least, st.builds(Not, late))
    joined = st.one_of(*(st.builds(kind, both, both) for kind in (And, Or, Implies)), st.builds(Until, both, both))
    return st.one_of(*(st.builds(kind, st.one_of(both, joined), intervals) for kind in (Always, Eventually)))


def formulas_over(parts: Sequence[Formula]) -> st.SearchStrategy[Formula]:
    """Formulas with these as their smallest parts, and constants."""
    least = st.sampled_from(parts)
    return st.recursive(st.one_of(least, least, least, st.builds(Constant, st.booleans())), _larger, max_leaves=7)


atoms: st.SearchStrategy[Formula] = st.sampled_from([Atom(name) for name in ATOMS])
formulas = formulas_over([Atom(name) for name in ATOMS])


def traces(values: st.SearchStrategy[bool | None], most: int = 12) -> st.SearchStrategy[list[State]]:
    """Traces with one state or more, at times that rise by 1 to 5."""
    states = st.tuples(st.integers(1, 5), st.fixed_dictionaries(dict.fromkeys(ATOMS, values)))

    def timed(steps: list[State]) -> list[State]:
        time = 0
        trace = []
        for step, state in steps:
            time += step
            trace.append((time, state))
        return trace

    return st.lists(states, min_size=1, max_size=most).map(timed)


three_values = st.sampled_from([False, True, None])
