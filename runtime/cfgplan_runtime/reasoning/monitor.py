"""Progression of one formula through a stream of states, as an automaton that is built while it runs.

What a state does to the obligations depends on the truth of the propositions and on which intervals have begun or
ended, not on the times themselves. Each such step is progressed once and remembered as a transition between
*situations*: an obligation, and for each operator in it the times at which it began, as registers. On regular and
on irregular streams alike a known step is one look-up.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from cfgplan.errors import InvalidValueError
from cfgplan_runtime.reasoning.compiling import Program, compiled
from cfgplan_runtime.reasoning.obligations import Kind, Obligation, Store, TooManyObligationsError, bound
from cfgplan_runtime.reasoning.progression import NOW, Progression
from cfgplan_runtime.reasoning.situations import (
    QUEUES,
    Queue,
    Registers,
    Situation,
    Transition,
    moved,
    moves_between,
    pending_of,
    queues_in,
    registers_of,
)
from cfgplan_runtime.reasoning.syntax import Formula
from cfgplan_runtime.reasoning.truth import FALSE, TRUE, VERDICT_OF, Truth, Verdict

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

MOST_REMEMBERED: Final = 200_000
"""How many obligations and transitions are remembered before all but the present situation are forgotten."""
MOST_MOMENTS: Final = 1_000_000
_TRIED: Final = 3
_NEVER: Final = 1 << 62
_MOST_PACKED: Final = 39


@dataclass(frozen=True, slots=True)
class Waiting:
    """An operator that is not decided yet. `since_ns` and `until_ns` are missing where they make no difference."""

    text: str
    since_ns: int | None
    until_ns: int | None


class Monitor:
    """Follows a formula through states whose times rise; the formula is about the first of them."""

    def __init__(self, formula: Formula | Program) -> None:
        self.program = formula if isinstance(formula, Program) else compiled(formula)
        self.states = 0
        self.time_ns: int | None = None
        """The time of the last state that was looked at; of a final verdict, the state that decided."""
        self._intervals = [operator.interval for operator in self.program.operators]
        self._is_endless = [interval.end_ns is None for interval in self._intervals]
        self._store = self._new_store()
        self._remembered = 0
        self._situations: dict[Obligation, Situation] = {}
        self._situation = Situation(None, ())
        self._moments: list[list[int]] = []
        self._quiet_until = _NEVER
        self._expired: list[Waiting] = []

    @property
    def verdict(self) -> Verdict:
        """What is known by now."""
        return self._situation.verdict

    @property
    def possible(self) -> frozenset[Verdict]:
        """The final verdicts that are not ruled out."""
        obligation = self._situation.obligation
        if obligation is None:
            return frozenset(VERDICT_OF.values())
        low, high = bound(obligation, FALSE), bound(obligation, TRUE)
        return frozenset(VERDICT_OF[truth] for truth in range(low, high + 1))

    @property
    def size(self) -> int:
        """How many nodes the present obligation has, and moments."""
        obligation = self._situation.obligation
        return 1 if obligation is None else obligation.size + sum(map(len, self._moments))

    @property
    def remembered(self) -> int:
        """How many obligations and transitions are held in memory; at most about `MOST_REMEMBERED`."""
        return self._remembered + len(self._store)

    def step(self, time_ns: int, truths: Sequence[Truth | bool]) -> Verdict:
        """Progress through one state; `truths` has FALSE, UNKNOWN or TRUE (or a bool) for each proposition.

        Does nothing once the verdict is final. Raises InvalidValueError if time does not rise.
        """
        code = 0
        for truth in reversed(truths):
            code = 3 * code + (2 * truth if truth is True or truth is False else truth)
        return self._follow((time_ns,), (code,))

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
        """The verdict if no state comes any more: what had to happen did not, and nothing went wrong any more.

        A formula of which no state was seen is open.
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

    def _waiting(self, situation: Situation, moments: list[list[int]]) -> list[Waiting]:
        position = {registers.operator: place for place, registers in enumerate(situation.registers)}
        found: dict[Waiting, None] = {}
        for operator, moment in sorted(pending_of(situation.obligation)):
            if moment < -1:
                moment = situation.registers[position[operator]].size
            since = None if moment < 0 else moments[position[operator]][moment]
            end = self._intervals[operator].end_ns
            until = None if since is None or end is None else since + end
            found[Waiting(self.program.operators[operator].text, since, until)] = None
        return list(found)

    def _follow(self, times_ns: Iterable[int], codes: Iterable[int]) -> Verdict:
        situation, moments, quiet_until = self._situation, self._moments, self._quiet_until
        last = -_NEVER if self.time_ns is None else self.time_ns
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
                        transition, is_general = self._learnt(situation, moments, time_ns, code)
                        if is_general:
                            situation.quiet[code] = transition
                else:
                    key = self._crossed(situation, moments, time_ns, code)
                    transition = situation.crossing.get(key)
                    if transition is None:
                        transition, is_general = self._learnt(situation, moments, time_ns, code)
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
                    quiet_until = self._next_crossing(situation, moments)
                elif not is_quiet:
                    quiet_until = self._next_crossing(situation, moments)
                if situation.verdict is not Verdict.OPEN:
                    break
                if self._remembered > MOST_REMEMBERED:
                    situation = self._forget(situation)
            return situation.verdict
        finally:
            self._situation, self._moments, self._quiet_until = situation, moments, quiet_until
            self.states += count
            if count:
                self.time_ns = last

    def _learnt(
        self, situation: Situation, moments: list[list[int]], time_ns: int, code: int
    ) -> tuple[Transition, bool]:
        """Progress through a state, and whether every state like this one leads to the same.

        What becomes of a queue of moments is tried out on its first few.
        """
        few = []
        for registers, found in zip(situation.registers, moments, strict=True):
            begun = bisect_right(found, time_ns - self._intervals[registers.operator].begin_ns)
            few.append(found[: max(registers.size, begun) + _TRIED] if registers.has_queue else found)
        found_transition = self._progressed(situation, few, time_ns, code)
        if found_transition is not None:
            return found_transition, True
        exact = self._progressed(situation, moments, time_ns, code, is_exact=True)
        assert exact is not None
        return exact, False

    def _progressed(
        self, situation: Situation, moments: list[list[int]], time_ns: int, code: int, *, is_exact: bool = False
    ) -> Transition | None:
        """The transition from a situation; None if it depends on how long a queue is, and is not asked to be exact."""
        truths = []
        for _ in self.program.propositions:
            code, truth = divmod(code, 3)
            truths.append(truth)
        place = {registers.operator: number for number, registers in enumerate(situation.registers)}

        def elapsed_ns(operator: int, moment: int) -> int:
            return time_ns - moments[place[operator]][moment]

        progression = Progression(self.program, self._store, truths, elapsed_ns)
        try:
            before = self._unqueued(situation, moments)
            after = progression.of_root() if before is None else progression.of(before)
        except RecursionError:
            raise TooManyObligationsError("obligations are nested too deep: nest fewer temporal operators") from None
        used: dict[int, dict[int, bool]] = {}
        for operator, moment, is_begun in registers_of(after):
            used.setdefault(operator, {})[moment] = is_begun
        lengths = {operator: len(moments[place[operator]]) if operator in place else 0 for operator in used}
        queues = queues_in(after, lengths, self._is_endless)
        if not is_exact:
            for registers, found in zip(situation.registers, moments, strict=True):
                operator = registers.operator
                waits = max(registers.size, bisect_right(found, time_ns - self._intervals[operator].begin_ns))
                in_use = [moment for moment in used.get(operator, ()) if waits <= moment < NOW]
                queue = queues.get(operator)
                if registers.has_queue and in_use and (queue is None or queue.first != waits):
                    return None
        chosen = {
            operator: sorted(m for m, is_begun in used[operator].items() if is_begun or operator not in queues)
            for operator in sorted(used)
        }
        return self._situated(after, chosen, queues, used), moves_between(situation.registers, chosen, queues)

    def _unqueued(self, situation: Situation, moments: list[list[int]]) -> Obligation | None:
        """A situation's obligation with every moment of its queues by itself."""
        if situation.obligation is None or not any(registers.has_queue for registers in situation.registers):
            return situation.obligation
        ranges = {
            registers.operator: range(registers.size, len(found))
            for registers, found in zip(situation.registers, moments, strict=True)
        }

        def by_itself(one: Obligation) -> Obligation:
            if one.moment >= -1:
                return one
            each = [self._store.pending(one.operator, moment, False) for moment in ranges[one.operator]]
            return self._store.all(each) if one.moment == QUEUES[Kind.ALL] else self._store.any(each)

        return self._store.replaced(situation.obligation, by_itself)

    def _situated(
        self,
        after: Obligation,
        chosen: dict[int, list[int]],
        queues: dict[int, Queue],
        used: dict[int, dict[int, bool]],
    ) -> Situation:
        """The situation that an obligation is, with its moments numbered anew, or in a queue."""
        number = {operator: {moment: at for at, moment in enumerate(found)} for operator, found in chosen.items()}

        def named(one: Obligation) -> Obligation:
            if one.moment < 0:
                return one
            if one.operator in queues and not one.is_begun:
                return self._store.pending(one.operator, QUEUES[queues[one.operator].kind], False)
            return self._store.pending(one.operator, number[one.operator][one.moment], one.is_begun)

        obligation = self._store.renamed(after, named)
        self._remembered += 1
        found = self._situations.get(obligation)
        if found is None:
            registers = tuple(
                Registers(operator, len(moments), sum(used[operator][each] for each in moments), operator in queues)
                for operator, moments in chosen.items()
            )
            found = self._situations[obligation] = Situation(obligation, registers)
            self._remembered += obligation.size
        if len(self._store) > MOST_REMEMBERED:
            self._remembered += MOST_REMEMBERED
        return found

    def _crossed(self, situation: Situation, moments: list[list[int]], time_ns: int, code: int) -> tuple[int, ...]:
        """What makes two steps from a situation the same: how many intervals of each operator have begun and ended,
        and whether none, one or more are left in its queue.
        """
        key = [code]
        for registers, found in zip(situation.registers, moments, strict=True):
            interval = self._intervals[registers.operator]
            begun = bisect_right(found, time_ns - interval.begin_ns)
            key.append(begun)
            if registers.has_queue:
                key.append(min(2, len(found) - max(begun, registers.size)))
            if interval.end_ns is not None:
                ended = bisect_right(found, time_ns - interval.end_ns)
                key += (ended, bisect_right(found, time_ns - interval.end_ns - 1, 0, ended))
        return tuple(key)

    def _next_crossing(self, situation: Situation, moments: list[list[int]]) -> int:
        """The least time at which an interval begins or ends."""
        least = _NEVER
        for registers, found in zip(situation.registers, moments, strict=True):
            interval, begun = self._intervals[registers.operator], registers.begun
            if interval.end_ns is not None and found[0] + interval.end_ns < least:
                least = found[0] + interval.end_ns
            if len(found) > MOST_MOMENTS:
                raise TooManyObligationsError(
                    f"more than {MOST_MOMENTS:,} intervals are ahead at once: shorten them, or take fewer states"
                )
            if begun < len(found) and found[begun] + interval.begin_ns < least:
                least = found[begun] + interval.begin_ns
        return least

    def _forget(self, situation: Situation) -> Situation:
        """Begin anew with nothing but the present situation, so that memory is bounded."""
        self._store = self._new_store()
        obligation = situation.obligation
        assert obligation is not None
        store = self._store

        def same(one: Obligation) -> Obligation:
            return store.pending(one.operator, one.moment, one.is_begun)

        kept = Situation(store.renamed(obligation, same), situation.registers)
        assert kept.obligation is not None
        self._situations = {kept.obligation: kept}
        self._remembered = kept.obligation.size
        return kept

    def _new_store(self) -> Store:
        return Store([operator.is_until for operator in self.program.operators], self._is_endless)

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
