"""The automaton of a formula: its situations, and the transitions between them, made as they are met."""

from __future__ import annotations

from bisect import bisect_right
from typing import Final

from cfgplan_runtime.reasoning.obligations import Kind, Obligation, Store, TooManyObligationsError
from cfgplan_runtime.reasoning.program import Program
from cfgplan_runtime.reasoning.progression import NOW, Progression
from cfgplan_runtime.reasoning.situations import (
    QUEUES,
    AutomatonState,
    Queue,
    Registers,
    Transition,
    moves_between,
    queues_in,
    registers_of,
)

MOST_REMEMBERED: Final = 200_000
"""How many obligations and transitions are remembered before all but the present situation are forgotten."""
MOST_MOMENTS: Final = 1_000_000
_TRIED: Final = 3
NEVER_DUE: Final = 1 << 62


class Automaton:
    """What is known of a program's progression. A situation goes with a list of moments for each of its registers."""

    def __init__(self, program: Program) -> None:
        self.program = program
        self.start = AutomatonState(None, ())
        self._intervals = [operator.interval for operator in program.operators]
        self._is_endless = [interval.end_ns is None for interval in self._intervals]
        self._store = self._new_store()
        self._remembered = 0
        self._situations: dict[Obligation, AutomatonState] = {}

    @property
    def remembered(self) -> int:
        """The number of obligations and transitions in memory."""
        return self._remembered + len(self._store)

    @property
    def is_full(self) -> bool:
        """Whether it is time to forget."""
        return self._remembered > MOST_REMEMBERED

    def learnt(
        self, situation: AutomatonState, moments: list[list[int]], time_ns: int, code: int
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
        self, situation: AutomatonState, moments: list[list[int]], time_ns: int, code: int, *, is_exact: bool = False
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

    def _unqueued(self, situation: AutomatonState, moments: list[list[int]]) -> Obligation | None:
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
    ) -> AutomatonState:
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
            found = self._situations[obligation] = AutomatonState(obligation, registers)
            self._remembered += obligation.size
        if len(self._store) > MOST_REMEMBERED:
            self._remembered += MOST_REMEMBERED
        return found

    def crossed(self, situation: AutomatonState, moments: list[list[int]], time_ns: int, code: int) -> tuple[int, ...]:
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

    def next_crossing(self, situation: AutomatonState, moments: list[list[int]]) -> int:
        """The least time at which an interval begins or ends."""
        least = NEVER_DUE
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

    def forget(self, situation: AutomatonState) -> AutomatonState:
        """Forget everything but the present situation, so that memory stays bounded."""
        self._store = self._new_store()
        obligation = situation.obligation
        assert obligation is not None
        store = self._store

        def same(one: Obligation) -> Obligation:
            return store.pending(one.operator, one.moment, one.is_begun)

        kept = AutomatonState(store.renamed(obligation, same), situation.registers)
        assert kept.obligation is not None
        self._situations = {kept.obligation: kept}
        self._remembered = kept.obligation.size
        return kept

    def _new_store(self) -> Store:
        return Store([operator.is_until for operator in self.program.operators], self._is_endless)
