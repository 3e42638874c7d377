"""Progression of metric temporal logic through a state (Bacchus and Kabanza 1996, 1998; paper, section III).

A formula is true of a sequence of states exactly if what it progresses to through the first state is true of the
others. Where a proposition is unknown in a state, its place is taken by the value *unknown*.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

from cfgplan_runtime.reasoning.obligations import Kind, Obligation, Store
from cfgplan_runtime.reasoning.program import Fixed, Joined, Program, ProgramStep, Proposition
from cfgplan_runtime.reasoning.truth import FALSE, TRUE, Truth

NOW: Final = 1 << 62
"""The moment of the state that is progressed through: later than all others."""


class Progression:
    """Progresses obligations through one state, by the truth of each proposition and the time since each moment."""

    def __init__(
        self, program: Program, store: Store, truths: Sequence[Truth], elapsed_ns: Callable[[int, int], int]
    ) -> None:
        self._program = program
        self._store = store
        self._truths = truths
        self._elapsed_ns = elapsed_ns
        self._begun_now: dict[int, Obligation] = {}
        self._progressed: dict[Obligation, Obligation] = {}

    def of_root(self) -> Obligation:
        """What is left of the whole formula if this is its first state."""
        return self._of_step(self._program.root)

    def of(self, obligation: Obligation) -> Obligation:
        """What is left of an obligation after this state."""
        if obligation.kind is Kind.VALUE:
            return obligation
        found = self._progressed.get(obligation)
        if found is None:
            if obligation.kind is Kind.PENDING:
                moment = obligation.moment
                elapsed = self._elapsed_ns(obligation.operator, moment) if moment >= 0 else None
                found = self._of_operator(obligation.operator, moment, elapsed)
            elif obligation.kind is Kind.ALL:
                found = self._store.all([self.of(part) for part in obligation.parts])
            else:
                found = self._store.any([self.of(part) for part in obligation.parts])
            self._progressed[obligation] = found
        return found

    def _of_step(self, step: ProgramStep) -> Obligation:
        match step:
            case Fixed(truth):
                return self._store.values[truth]
            case Proposition(number, is_negated):
                truth = self._truths[number]
                return self._store.values[TRUE - truth if is_negated else truth]
            case Joined(is_and, parts):
                joined = [self._of_step(part) for part in parts]
                return self._store.all(joined) if is_and else self._store.any(joined)
            case _:
                if step.number not in self._begun_now:
                    self._begun_now[step.number] = self._of_operator(step.number, NOW, 0)
                return self._begun_now[step.number]

    def _of_operator(self, number: int, moment: int, elapsed_ns: int | None) -> Obligation:
        """What is left of an operator that began `elapsed_ns` ago; None if its interval has begun and never ends."""
        operator, store = self._program.operators[number], self._store
        begin, end = operator.interval.begin_ns, operator.interval.end_ns
        if elapsed_ns is not None and end is not None and elapsed_ns > end:
            return store.values[FALSE if operator.is_until else TRUE]
        is_begun = elapsed_ns is None or elapsed_ns >= begin
        if elapsed_ns is not None and end is not None and elapsed_ns == end:
            later = store.values[FALSE if operator.is_until else TRUE]
        else:
            later = store.pending(number, -1 if end is None and is_begun else moment, is_begun)
        left = self._of_step(operator.left)
        if operator.is_until:
            again = store.all((left, later))
            return store.any((self._of_step(operator.right), again)) if is_begun else again
        again = store.any((left, later))
        return store.all((self._of_step(operator.right), again)) if is_begun else again
