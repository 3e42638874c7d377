"""The automaton of a formula, built while it runs: situations, and the transitions between them.

A situation is the obligation that remains of the formula, with the times at which its operators started as registers.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Iterable, Mapping, Sequence
from operator import attrgetter
from typing import Final, NamedTuple, TypeAlias

from cfgplan.onward import reached
from cfgplan_runtime.reasoning.obligations import Kind, Obligation, Store, TooManyObligationsError
from cfgplan_runtime.reasoning.program import Fixed, Joined, Program, ProgramStep, Proposition
from cfgplan_runtime.reasoning.truth import FALSE, TRUE, VERDICT_OF, Truth, Verdict

NOW: Final = 1 << 62
"""The moment of the state that is progressed through: later than all others."""


class Progression:
    """Progresses obligations through one state, by the truth of each proposition and the time since each moment.

    A formula is true of a sequence of states exactly if its progression through the first state is true of the others.
    A proposition that is unknown in a state is replaced by the value *unknown*. Reference: Bacchus and Kabanza 1996,
    1998; paper, section III.
    """

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
        """The obligation of the whole formula after its first state."""
        return self._of_step(self._program.root)

    def of(self, obligation: Obligation) -> Obligation:
        """The obligation that remains of `obligation` after this state."""
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
        """The obligation that remains of an operator that started `elapsed_ns` ago; None means that its interval has
        started and never ends.
        """
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


QUEUES: Final = {Kind.ALL: -2, Kind.ANY: -3}
"""Special moments of an obligation: each represents the whole queue of an operator, joined by the kind."""


class Registers(NamedTuple):
    """The moments at which an operator of a situation started.

    The first `size` of them are used one by one; for the first `begun` of these, the interval has started. With
    `has_queue`, two or more follow as a queue: their intervals have not started.
    """

    operator: int
    size: int
    begun: int
    has_queue: bool


class Move(NamedTuple):
    """Makes a list of moments from the list `source` of the situation before.

    It takes a slice (`first` to `end`) or the `chosen` ones, then all from `queue_from` on (-1: none), then the present
    moment if it is `with_now`.
    """

    source: int
    first: int
    end: int
    chosen: tuple[int, ...] | None
    queue_from: int
    with_now: bool


class Queue(NamedTuple):
    """An operator's moments from `first` on, and the present `with_now`, joined by one conjunction or disjunction."""

    kind: Kind
    first: int
    with_now: bool


Transition: TypeAlias = "tuple[AutomatonState, tuple[Move, ...] | None]"


class AutomatonState:
    __slots__ = ("begins", "crossing", "obligation", "quiet", "registers", "verdict")

    def __init__(self, obligation: Obligation | None, registers: tuple[Registers, ...]) -> None:
        self.obligation = obligation
        self.registers = registers
        self.quiet: dict[int, Transition] = {}
        self.crossing: dict[tuple[int, ...], Transition] = {}
        is_value = obligation is not None and obligation.kind is Kind.VALUE
        self.verdict = VERDICT_OF[obligation.value] if obligation is not None and is_value else Verdict.OPEN


def registers_of(obligation: Obligation) -> Iterable[tuple[int, int, bool]]:
    """For each pending obligation with a moment: its operator, its moment, and whether its interval has started."""
    for one in reached([obligation], attrgetter("parts")):
        if one.kind is Kind.PENDING and one.moment >= 0:
            yield one.operator, one.moment, one.is_begun


def pending_of(obligation: Obligation | None) -> set[tuple[int, int]]:
    if obligation is None:
        return set()
    if obligation.kind is Kind.PENDING:
        return {(obligation.operator, obligation.moment)}
    return {found for part in obligation.parts for found in pending_of(part)}


def queues_in(obligation: Obligation, lengths: Mapping[int, int], is_endless: Sequence[bool]) -> dict[int, Queue]:
    """Find the operators whose future intervals are all members of one conjunction or disjunction.

    Their moments are the last of the operator's `lengths` moments, and perhaps the present. Progression treats a queue
    the same way at any length, so a situation does not store its length.
    """
    parents: dict[int, set[Obligation]] = {}
    members: dict[int, set[int]] = {}
    seen: set[Obligation] = set()
    ahead = [obligation]
    while ahead:
        one = ahead.pop()
        if one in seen:
            continue
        seen.add(one)
        for part in one.parts:
            if part.kind is Kind.PENDING and not part.is_begun and not is_endless[part.operator]:
                parents.setdefault(part.operator, set()).add(one)
                members.setdefault(part.operator, set()).add(part.moment)
            else:
                ahead.append(part)
    found = {}
    for operator, moments in members.items():
        old = moments - {NOW}
        if len(parents[operator]) == 1 and len(moments) > 1 and old == set(range(min(old), lengths[operator])):
            found[operator] = Queue(next(iter(parents[operator])).kind, min(old), NOW in moments)
    return found


def moves_between(
    before: tuple[Registers, ...], chosen: Mapping[int, list[int]], queues: Mapping[int, Queue]
) -> tuple[Move, ...] | None:
    """The moves that keep only the moments still in use; None if all are."""
    position = {registers.operator: place for place, registers in enumerate(before)}
    moves = []
    for operator, found in chosen.items():
        queue = queues.get(operator)
        old = [moment for moment in found if moment != NOW]
        first, end = (old[0], old[-1] + 1) if old else (0, 0)
        picked = None if end - first == len(old) else tuple(old)
        with_now = len(old) < len(found) or (queue is not None and queue.with_now)
        moves.append(
            Move(position.get(operator, -1), first, end, picked, -1 if queue is None else queue.first, with_now)
        )
    same = [
        Move(place, 0, each.size, None, each.size if each.has_queue else -1, False) for place, each in enumerate(before)
    ]
    return None if moves == same else tuple(moves)


def moved(moments: list[list[int]], moves: tuple[Move, ...], time_ns: int) -> list[list[int]]:
    """The moments after the moves of a transition."""
    after = []
    for source, first, end, chosen, queue_from, with_now in moves:
        if chosen is not None:
            found = [moments[source][number] for number in chosen]
        elif end == queue_from:
            found = moments[source][first:]
            queue_from = -1
        else:
            found = moments[source][first:end] if end else []
        if queue_from >= 0:
            found += moments[source][queue_from:]
        if with_now:
            found.append(time_ns)
        after.append(found)
    return after


MOST_REMEMBERED: Final = 200_000
"""The most obligations and transitions in memory; beyond it all but the present situation are forgotten."""
MOST_MOMENTS: Final = 1_000_000
_TRIED: Final = 3
NEVER_DUE: Final = 1 << 62


class Automaton:
    """The known situations and transitions of a program. A situation is used together with one list of moments for each
    of its registers.
    """

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
        """Whether the memory is full, so that `forget` must be called."""
        return self._remembered > MOST_REMEMBERED

    def learnt(
        self, situation: AutomatonState, moments: list[list[int]], time_ns: int, code: int
    ) -> tuple[Transition, bool]:
        """Progress a situation through a state. Returns the transition, and whether all states with this step's key
        take it.

        Only the first few moments of a queue are progressed; the others follow them.
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
        """The transition from a situation. None if it depends on the length of a queue; `is_exact` progresses all
        moments.
        """
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
        """A situation's obligation with each moment of a queue as a part of its own."""
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
        """The situation of an obligation: its moments get new numbers, or become a queue."""
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
        """The key of a step. Steps from one situation with the same key have the same transition.

        For each operator it has the number of intervals that have started, the number that have ended, and whether
        none, one or more moments are left in its queue.
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
        """The earliest time at which an interval starts or ends."""
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
