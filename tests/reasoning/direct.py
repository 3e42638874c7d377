"""What metric temporal logic means on complete traces, by its definition; shares no code with progression."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from cfgplan_runtime.reasoning.syntax import Always, And, Atom, Constant, Eventually, Formula, Implies, Not, Or, Until

State = tuple[int, Mapping[str, bool | None]]
"""A time in nanoseconds, and the value of each atom; None is unknown."""


def holds(formula: Formula, trace: Sequence[State], at: int = 0) -> bool | None:
    """Strong Kleene truth of a formula in the state `at` of a trace after which nothing comes."""
    match formula:
        case Constant(value):
            return value
        case Atom(condition):
            return trace[at][1][str(condition)]
        case Not(part):
            return negated(holds(part, trace, at))
        case And(left, right):
            return every([holds(left, trace, at), holds(right, trace, at)])
        case Or(left, right):
            return some([holds(left, trace, at), holds(right, trace, at)])
        case Implies(left, right):
            return some([negated(holds(left, trace, at)), holds(right, trace, at)])
        case Always(part, _):
            return every([holds(part, trace, j) for j in reached(formula, trace, at)])
        case Eventually(part, _):
            return some([holds(part, trace, j) for j in reached(formula, trace, at)])
        case Until(left, right, _):
            return some(
                [
                    every([holds(right, trace, j), *(holds(left, trace, k) for k in range(at, j))])
                    for j in reached(formula, trace, at)
                ]
            )


def reached(formula: Always | Eventually | Until, trace: Sequence[State], at: int) -> list[int]:
    begin, end = formula.interval.begin_ns, formula.interval.end_ns
    spans = [(j, trace[j][0] - trace[at][0]) for j in range(at, len(trace))]
    return [j for j, span in spans if begin <= span and (end is None or span <= end)]


def negated(value: bool | None) -> bool | None:
    return None if value is None else not value


def every(values: Sequence[bool | None]) -> bool | None:
    return False if False in values else None if None in values else True


def some(values: Sequence[bool | None]) -> bool | None:
    return True if True in values else None if None in values else False
