"""Progression of one formula through a stream of states, as an automaton that is built while it runs.

The effect of a state depends only on the truth of the propositions and on the intervals that have started or ended, not
on the times themselves. Each different step is progressed once and stored as a transition between *situations*: an
obligation, and for each operator in it the times at which it started, as registers. A known step is one look-up, on
regular and on irregular streams.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from cfgplan.errors import InvalidValueError
from cfgplan_runtime.reasoning.automaton import NEVER_DUE, Automaton, AutomatonState, moved, pending_of
from cfgplan_runtime.reasoning.obligations import Kind, Obligation, bound
from cfgplan_runtime.reasoning.program import Program, compiled
from cfgplan_runtime.reasoning.syntax import Formula
from cfgplan_runtime.reasoning.truth import FALSE, TRUE, UNKNOWN, VERDICT_OF, Truth, Verdict

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

_MOST_PACKED: Final = 39


@dataclass(frozen=True, slots=True)
class Waiting:
    """An operator that is not decided yet. `since_ns` and `until_ns` are None if they do not matter."""

    text: str
    since_ns: int | None
    until_ns: int | None


class Monitor:
    """Follows a formula through states with rising times; the formula is evaluated at the first of them."""

    def __init__(self, formula: Formula | Program) -> None:
        self.program = formula if isinstance(formula, Program) else compiled(formula)
        self.states = 0
        self.time_ns: int | None = None
        """The time of the last state; with a final verdict, of the state that decided."""
        self._automaton = Automaton(self.program)
        self._situation = self._automaton.start
        self._moments: list[list[int]] = []
        self._quiet_until = NEVER_DUE
        self._expired: list[Waiting] = []

    @property
    def verdict(self) -> Verdict:
        """The verdict so far."""
        return self._situation.verdict

    @property
    def possible(self) -> frozenset[Verdict]:
        """The final verdicts that are still possible."""
        obligation = self._situation.obligation
        if obligation is None:
            return frozenset(VERDICT_OF.values())
        low, high = bound(obligation, FALSE), bound(obligation, TRUE)
        return frozenset(VERDICT_OF[truth] for truth in range(low, high + 1))

    @property
    def size(self) -> int:
        """The number of nodes and moments of the present obligation."""
        obligation = self._situation.obligation
        return 1 if obligation is None else obligation.size + sum(map(len, self._moments))

    @property
    def remembered(self) -> int:
        """The number of obligations and transitions in memory; at most about `automaton.MOST_REMEMBERED`."""
        return self._automaton.remembered

    def step(self, time_ns: int, truths: Sequence[Truth | bool]) -> Verdict:
        """Progress through one state. `truths` has FALSE, UNKNOWN or TRUE (or a bool) for each proposition, in order.

        Does nothing once the verdict is final. Raises InvalidValueError if time does not rise, or if the number of
        truths differs from that of propositions.
        """
        count = len(self.program.propositions)
        if len(truths) != count:
            raise InvalidValueError(f"{len(truths)} truths, but there are {count} propositions in each state")
        code = 0
        for truth in reversed(truths):
            code = 3 * code + (2 * truth if truth is True or truth is False else truth)
        return self._follow((time_ns,), (code,))

    def step_by_names(self, time_ns: int, truths: Mapping[str, Truth | bool]) -> Verdict:
        """Progress through one state with `truths` by the propositions' texts; absent propositions are UNKNOWN.

        Raises InvalidValueError for a text that is no proposition, and as `step` does.
        """
        names = [str(proposition) for proposition in self.program.propositions]
        strange = sorted(truths.keys() - set(names))
        if strange:
            known = ", ".join(names)
            raise InvalidValueError(
                f"{strange[0]!r} is not a proposition of the formula; its propositions are {known or 'none'}"
            )
        return self.step(time_ns, [truths.get(name, UNKNOWN) for name in names])

    def feed(self, times_ns: npt.NDArray[np.int64], truths: npt.NDArray[np.int8 | np.bool_]) -> Verdict:
        """Progress through many states: `times_ns` of shape (states,), `truths` of shape (states, propositions).

        Stops at the state that decides. Raises InvalidValueError if time does not rise.
        """
        import numpy as np

        count = len(self.program.propositions)
        values = np.asarray(truths)
        if values.shape != (len(times_ns), count):
            raise InvalidValueError(f"truths of shape {values.shape}, but there are {count} propositions in each state")
        if values.dtype == np.bool_:
            values = values * np.int8(TRUE)
        if count <= _MOST_PACKED:
            codes = (values.astype(np.int64) @ (3 ** np.arange(count, dtype=np.int64))).tolist()
        else:
            codes = [sum(truth * 3**number for number, truth in enumerate(row)) for row in values.tolist()]
        return self._follow(np.asarray(times_ns, np.int64).tolist(), codes)

    def ended(self) -> Verdict:
        """The verdict if the stream ends here: open *eventually* parts become false, and open *always* parts true.

        OPEN without any state.
        """
        if self._situation.obligation is None:
            return Verdict.OPEN
        return VERDICT_OF[self._at_end(self._situation.obligation)]

    def waiting(self) -> list[Waiting]:
        """The operators that are not decided yet."""
        return self._waiting(self._situation, self._moments)

    @property
    def expired(self) -> list[Waiting]:
        """The operators whose intervals had ended when the verdict became final."""
        return self._expired

    def _waiting(self, situation: AutomatonState, moments: list[list[int]]) -> list[Waiting]:
        position = {registers.operator: place for place, registers in enumerate(situation.registers)}
        found: dict[Waiting, None] = {}
        for operator, moment in sorted(pending_of(situation.obligation)):
            if moment < -1:
                moment = situation.registers[position[operator]].size
            since = None if moment < 0 else moments[position[operator]][moment]
            end = self.program.operators[operator].interval.end_ns
            until = None if since is None or end is None else since + end
            found[Waiting(self.program.operators[operator].text, since, until)] = None
        return list(found)

    def _follow(self, times_ns: Iterable[int], codes: Iterable[int]) -> Verdict:
        situation, moments, quiet_until = self._situation, self._moments, self._quiet_until
        last = -NEVER_DUE if self.time_ns is None else self.time_ns
        count = 0
        try:
            if situation.verdict is not Verdict.OPEN:
                return situation.verdict
            for time_ns, code in zip(times_ns, codes, strict=True):
                if time_ns <= last:
                    raise InvalidValueError(f"a state of time {time_ns} ns after one of {last} ns: times must rise")
                is_quiet = time_ns < quiet_until
                if is_quiet:
                    transition = situation.quiet.get(code)
                    if transition is None:
                        transition, is_general = self._automaton.learnt(situation, moments, time_ns, code)
                        if is_general:
                            situation.quiet[code] = transition
                else:
                    key = self._automaton.crossed(situation, moments, time_ns, code)
                    transition = situation.crossing.get(key)
                    if transition is None:
                        transition, is_general = self._automaton.learnt(situation, moments, time_ns, code)
                        if is_general:
                            situation.crossing[key] = transition
                last = time_ns
                count += 1
                before = situation
                situation, moves = transition
                if situation.verdict is not Verdict.OPEN:
                    waited = self._waiting(before, moments)
                    self._expired = [each for each in waited if each.until_ns is not None and each.until_ns <= time_ns]
                if moves is not None:
                    moments = moved(moments, moves, time_ns)
                    quiet_until = self._automaton.next_crossing(situation, moments)
                elif not is_quiet:
                    quiet_until = self._automaton.next_crossing(situation, moments)
                if situation.verdict is not Verdict.OPEN:
                    break
                if self._automaton.is_full:
                    situation = self._automaton.forget(situation)
            return situation.verdict
        finally:
            self._situation, self._moments, self._quiet_until = situation, moments, quiet_until
            self.states += count
            if count:
                self.time_ns = last

    def _at_end(self, obligation: Obligation) -> Truth:
        match obligation.kind:
            case Kind.VALUE:
                return obligation.value
            case Kind.PENDING:
                return FALSE if self.program.operators[obligation.operator].is_until else TRUE
            case Kind.ALL:
                return min(self._at_end(part) for part in obligation.parts)
            case _:
                return max(self._at_end(part) for part in obligation.parts)
