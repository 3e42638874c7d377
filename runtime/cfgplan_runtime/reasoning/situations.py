"""Situations of a monitor: what is left of a formula, with the times at which its operators began as registers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Final, NamedTuple, TypeAlias

from cfgplan_runtime.reasoning.obligations import Kind, Obligation
from cfgplan_runtime.reasoning.progression import NOW
from cfgplan_runtime.reasoning.truth import VERDICT_OF, Verdict

QUEUES: Final = {Kind.ALL: -2, Kind.ANY: -3}
"""In place of a moment: all the moments that are not in use by themselves, of which no interval has begun, joined."""


class Registers(NamedTuple):
    """The moments of an operator: how many are in use by themselves, of how many of them the interval has begun, and
    whether a queue follows: two or more of which none has begun.
    """

    operator: int
    size: int
    begun: int
    has_queue: bool


class Move(NamedTuple):
    """How to make one list of moments from those before: a slice or a choice of one, what queues from `queue_from` on
    (-1: nothing), and perhaps the present.
    """

    source: int
    first: int
    end: int
    chosen: tuple[int, ...] | None
    queue_from: int
    with_now: bool


class Queue(NamedTuple):
    """The conjunction or disjunction of an operator's moments from the first on, and whether the present is one."""

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
    """Operator, moment and whether its interval has begun, of each pending obligation that has a moment."""
    seen: set[Obligation] = set()
    ahead = [obligation]
    while ahead:
        one = ahead.pop()
        if one not in seen:
            seen.add(one)
            ahead += one.parts
            if one.kind is Kind.PENDING and one.moment >= 0:
                yield one.operator, one.moment, one.is_begun


def pending_of(obligation: Obligation | None) -> set[tuple[int, int]]:
    if obligation is None:
        return set()
    if obligation.kind is Kind.PENDING:
        return {(obligation.operator, obligation.moment)}
    return {found for part in obligation.parts for found in pending_of(part)}


def queues_in(obligation: Obligation, lengths: Mapping[int, int], is_endless: Sequence[bool]) -> dict[int, Queue]:
    """The operators whose intervals that have not begun are all members of one conjunction or disjunction.

    They are the last of each operator's `lengths` moments, and perhaps the present. What becomes of such a queue is
    the same however long it is, so that situations need not tell its length.
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
    """How the moments that are still used come about; None if they are those before."""
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
    """The moments after a transition."""
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
