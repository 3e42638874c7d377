"""Bounded future formulas as past ones, for reelay: what held at a state is said when its horizon is over."""

from __future__ import annotations

from cfgplan_runtime.reasoning.syntax import Always, And, Atom, Eventually, Formula, Implies, Not, Or, Until


def horizon(formula: Formula) -> int:
    """How far ahead a formula looks, in ticks."""
    match formula:
        case Atom():
            return 0
        case Not(part):
            return horizon(part)
        case And(left, right) | Or(left, right) | Implies(left, right):
            return max(horizon(left), horizon(right))
        case Always(part, interval) | Eventually(part, interval):
            return _end(interval.end_ns) + horizon(part)
        case Until(left, right, interval):
            return _end(interval.end_ns) + max(horizon(left), horizon(right))
        case _:
            raise TypeError(formula)


def past(formula: Formula, delay: int) -> str:
    """What `formula` said `delay` ticks ago, which is at least its horizon; a state comes at each tick."""
    match formula:
        case Atom(name):
            return _looked_back("once", delay, delay, f"{{{name}}}")
        case Not(part):
            return f"(not ({past(part, delay)}))"
        case And(left, right):
            return f"({past(left, delay)} and {past(right, delay)})"
        case Or(left, right):
            return f"({past(left, delay)} or {past(right, delay)})"
        case Implies(left, right):
            return f"({past(left, delay)} -> {past(right, delay)})"
        case Always(part, interval) | Eventually(part, interval):
            known = horizon(part)
            word = "historically" if isinstance(formula, Always) else "once"
            first, last = delay - known - _end(interval.end_ns), delay - known - interval.begin_ns
            return _looked_back(word, first, last, past(part, known))
        case Until(left, right, interval):
            ends = range(interval.begin_ns, _end(interval.end_ns) + 1)
            each = [[past(right, delay - j), *(past(left, delay - k) for k in range(j))] for j in ends]
            return _joined("or", [_joined("and", one) for one in each])
        case _:
            raise TypeError(formula)


def _looked_back(word: str, first: int, last: int, what: str) -> str:
    """reelay takes the interval [0:0] for all the past."""
    return what if last == 0 else f"({word}[{first}:{last}]({what}))"


def _joined(word: str, parts: list[str]) -> str:
    return parts[0] if len(parts) == 1 else f"({parts[0]} {word} {_joined(word, parts[1:])})"


def _end(end: int | None) -> int:
    if end is None:
        raise TypeError("the interval has no end")
    return end
