"""Situations of a monitor: what is left of a formula, with the times at which its operators began as registers."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple, TypeAlias

from cfgplan_runtime.reasoning.obligations import Kind, Obligation
from cfgplan_runtime.reasoning.progression import NOW
from cfgplan_runtime.reasoning.truth import VERDICT_OF, Verdict


class Registers(NamedTuple):
    """The moments of an operator: how many there are, and of how many the interval has begun."""

    operator: int
    size: int
    begun: int


class Move(NamedTuple):
    """How to make one list of moments from those before: a slice or a choice of one, and perhaps the present."""

    source: int
    first: int
    end: int
    chosen: tuple[int, ...] | None
    with_now: bool


Transition: TypeAlias = "tuple[Situation, tuple[Move, ...] | None]"


class Situation:
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


def moves_between(
    before: tuple[Registers, ...], chosen: dict[int, list[int]], position: dict[int, int]
) -> tuple[Move, ...] | None:
    """How the moments that are still used come about; None if they are those before."""
    moves = []
    for operator, found in chosen.items():
        with_now = found[-1] == NOW
        old = found[:-1] if with_now else found
        first, end = (old[0], old[-1] + 1) if old else (0, 0)
        is_slice = end - first == len(old)
        moves.append(Move(position.get(operator, -1), first, end, None if is_slice else tuple(old), with_now))
    same = [Move(place, 0, registers.size, None, False) for place, registers in enumerate(before)]
    return None if moves == same else tuple(moves)


def moved(moments: list[list[int]], moves: tuple[Move, ...], time_ns: int) -> list[list[int]]:
    after = []
    for source, first, end, chosen, with_now in moves:
        if chosen is not None:
            found = [moments[source][number] for number in chosen]
        else:
            found = moments[source][first:end] if end else []
        if with_now:
            found.append(time_ns)
        after.append(found)
    return after
