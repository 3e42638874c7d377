"""Formulas compiled for progression: negations are pushed to the atoms, and each part about one state becomes one
proposition.

Every temporal operator becomes an *until* or its dual, *release*: `eventually p` is `true until p`, `always p` is
`false release p`. These equations and De Morgan's laws hold in Kleene's logic as in that of two values.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

from cfgplan_runtime.reasoning.syntax import (
    Always,
    And,
    Atom,
    Connected,
    Constant,
    Eventually,
    Formula,
    Implies,
    Interval,
    Not,
    Or,
    Until,
)
from cfgplan_runtime.reasoning.truth import FALSE, TRUE, Truth, negation


@dataclass(frozen=True, slots=True)
class Fixed:
    """A truth value."""

    truth: Truth


@dataclass(frozen=True, slots=True)
class Proposition:
    """A proposition, by its number, or its negation."""

    number: int
    is_negated: bool


@dataclass(frozen=True, slots=True)
class Joined:
    """A conjunction or a disjunction of two or more."""

    is_and: bool
    parts: tuple[ProgramStep, ...]


@dataclass(frozen=True, slots=True)
class Operated:
    """The temporal operator of this number, started in the present state."""

    number: int


ProgramStep: TypeAlias = Fixed | Proposition | Joined | Operated


@dataclass(frozen=True, slots=True)
class Operator:
    """`left until right` in an interval; or `left release right`: `right` holds throughout it, or until `left` holds
    too.
    """

    is_until: bool
    left: ProgramStep
    right: ProgramStep
    interval: Interval
    text: str = field(compare=False)


@dataclass(frozen=True)
class Program:
    """A compiled formula.

    `propositions` are its largest parts about a single state; progression needs the truth of each in every state.
    """

    text: str
    propositions: tuple[Formula, ...]
    operators: tuple[Operator, ...]
    root: ProgramStep


def compiled(formula: Formula) -> Program:
    """Compile a formula for progression."""
    compiler = _Compiler()
    root = compiler.step(folded(formula), False)
    return Program(str(formula), tuple(compiler.propositions), tuple(compiler.operators), root)


def folded(formula: Formula) -> Formula:
    """The formula without constants that decide a part of it or add nothing; it means the same in every trace.

    An interval with a delayed start may hold no state, so that `eventually[1s,2s] true` is no constant.
    """
    match formula:
        case Not(part):
            inner = folded(part)
            return Constant(not inner.value) if isinstance(inner, Constant) else Not(inner)
        case And(left, right):
            return _joined_of(And, folded(left), folded(right), Constant(True))
        case Or(left, right):
            return _joined_of(Or, folded(left), folded(right), Constant(False))
        case Implies(left, right):
            premise, conclusion = folded(left), folded(right)
            if conclusion == Constant(True) or premise == Constant(False):
                return Constant(True)
            if conclusion == Constant(False):
                return folded(Not(premise))
            return conclusion if premise == Constant(True) else Implies(premise, conclusion)
        case Always(part, interval) | Eventually(part, interval):
            inner, neutral = folded(part), Constant(isinstance(formula, Always))
            is_now = interval.begin_ns == 0 and isinstance(inner, Constant)
            return inner if inner == neutral or is_now else type(formula)(inner, interval)
        case Until(left, right, interval):
            before, goal = folded(left), folded(right)
            is_now = interval.begin_ns == 0
            if goal == Constant(False) or (before == Constant(False) and not is_now):
                return Constant(False)
            if is_now and (before == Constant(False) or goal == Constant(True)):
                return goal
            return Eventually(goal, interval) if before == Constant(True) else Until(before, goal, interval)
    return formula


def _joined_of(kind: type[And | Or], left: Formula, right: Formula, neutral: Constant) -> Formula:
    dominant = Constant(not neutral.value)
    if dominant in (left, right):
        return dominant
    if neutral in (left, right):
        return right if left == neutral else left
    return kind(left, right)


def truth_of(proposition: Formula, atom: Callable[[object], Truth]) -> Truth:
    """The truth of a proposition in a state. `atom` gives the truth of an atom's condition."""
    match proposition:
        case Constant(value):
            return TRUE if value else FALSE
        case Atom(condition):
            return atom(condition)
        case Not(part):
            return negation(truth_of(part, atom))
        case And(left, right):
            return min(truth_of(left, atom), truth_of(right, atom))
        case Or(left, right):
            return max(truth_of(left, atom), truth_of(right, atom))
        case Implies(left, right):
            return max(negation(truth_of(left, atom)), truth_of(right, atom))
        case _:
            raise TypeError(f"{proposition} is about more than one state")


class _Compiler:
    def __init__(self) -> None:
        self.propositions: dict[Formula, int] = {}
        self.operators: dict[Operator, int] = {}

    def step(self, formula: Formula, negated: bool) -> ProgramStep:
        match formula:
            case Constant(value):
                return Fixed(TRUE if value != negated else FALSE)
            case Not(part):
                return self.step(part, not negated)
            case _ if _is_of_one_state(formula):
                return Proposition(self.propositions.setdefault(formula, len(self.propositions)), negated)
            case And(left, right):
                return self._joined(not negated, [(left, negated), (right, negated)])
            case Or(left, right):
                return self._joined(negated, [(left, negated), (right, negated)])
            case Implies(left, right):
                return self._joined(negated, [(left, not negated), (right, negated)])
            case Always(part, interval):
                return self._operated(negated, Fixed(TRUE if negated else FALSE), part, interval, negated, formula)
            case Eventually(part, interval):
                return self._operated(not negated, Fixed(FALSE if negated else TRUE), part, interval, negated, formula)
            case Until(left, right, interval):
                return self._operated(not negated, self.step(left, negated), right, interval, negated, formula)
            case _:
                raise TypeError(f"{formula!r} is not a formula")

    def _joined(self, is_and: bool, parts: Sequence[tuple[Formula, bool]]) -> ProgramStep:
        flat: dict[ProgramStep, None] = {}
        for part, negated in parts:
            step = self.step(part, negated)
            flat.update(dict.fromkeys(step.parts if isinstance(step, Joined) and step.is_and == is_and else [step]))
        return Joined(is_and, tuple(flat)) if len(flat) > 1 else next(iter(flat))

    def _operated(
        self, is_until: bool, left: ProgramStep, right: Formula, interval: Interval, negated: bool, formula: Formula
    ) -> ProgramStep:
        text = f"not ({formula})" if negated else str(formula)
        operator = Operator(is_until, left, self.step(right, negated), interval, text)
        return Operated(self.operators.setdefault(operator, len(self.operators)))


def _is_of_one_state(formula: Formula) -> bool:
    match formula:
        case Not(part):
            return _is_of_one_state(part)
        case Connected(left, right):
            return _is_of_one_state(left) and _is_of_one_state(right)
    return isinstance(formula, Constant | Atom)
