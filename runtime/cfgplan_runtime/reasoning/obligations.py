"""Obligations, the parts of a formula that later states must satisfy: hash-consed, and simplified by the laws of
distributive lattices.

An obligation is a truth value, a conjunction, a disjunction, or *pending*: a temporal operator that started at an
earlier state. Kleene's three values in the order false < unknown < true are a distributive lattice, and progressed
formulas have no negation above their propositions. So two simplifications change no value: absorption, and replacing
inside of a conjunction a part that another member implies.

The intervals of one operator end in the order in which they started. Therefore, once their intervals have started, an
earlier *until* implies a later one, and a later *release* an earlier one. If the interval has no end, the order is
reversed, and holds before its start, too. So a conjunction or disjunction keeps one of each: `always[0,10s] p` inside
`always` is one obligation.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from enum import IntEnum
from typing import Final, NamedTuple

from cfgplan.errors import CfgplanError
from cfgplan_runtime.reasoning.truth import FALSE, TRUE, UNKNOWN, Truth

MOST_MEMBERS: Final = 50_000
_MOST_PARTS_COMPARED: Final = 24


class TooManyObligationsError(CfgplanError):
    """The obligations of a formula would take too much memory."""


class Kind(IntEnum):
    """The kinds of obligations."""

    VALUE = 0
    PENDING = 1
    ALL = 2
    ANY = 3


class Obligation:
    """One node. Equal nodes of one store are the same object.

    A pending node has the number of its operator. The moments at which this operator started and that still matter are
    numbered from the earliest, 0; `moment` is -1 if it does not matter. `is_begun` is true if its interval has started.
    """

    __slots__ = ("is_begun", "kind", "moment", "operator", "parts", "serial", "size", "value")

    def __init__(
        self,
        serial: int,
        kind: Kind,
        *,
        parts: tuple[Obligation, ...] = (),
        value: Truth = UNKNOWN,
        operator: int = -1,
        moment: int = -1,
        is_begun: bool = False,
    ) -> None:
        self.serial = serial
        self.kind = kind
        self.parts = parts
        self.value = value
        self.operator = operator
        self.moment = moment
        self.is_begun = is_begun
        self.size: int = 1 + sum(part.size for part in parts)


class _Context(NamedTuple):
    """The members of a conjunction or disjunction; `chains` has for each operator the pending member that decides its
    other ones.
    """

    kind: Kind
    simple: dict[Obligation, None]
    nested: dict[Obligation, None]
    chains: dict[int, Obligation]
    done: dict[Obligation, Obligation]


class Store:
    """Makes the obligations of one program.

    For each operator `is_until` tells an until from a release, and `is_endless` whether its interval has no end.
    """

    def __init__(self, is_until: Sequence[bool], is_endless: Sequence[bool]) -> None:
        self._is_endless = tuple(is_endless)
        self._rises = tuple(until != endless for until, endless in zip(is_until, is_endless, strict=True))
        """For each operator, whether one that started later is at least as true."""
        self._pending: dict[tuple[int, int, bool], Obligation] = {}
        self._joined: dict[tuple[int, ...], Obligation] = {}
        self._implied: dict[tuple[int, int], bool] = {}
        self._serial = 2
        self.values = tuple(Obligation(value, Kind.VALUE, value=value) for value in (FALSE, UNKNOWN, TRUE))

    def __len__(self) -> int:
        """The number of obligations and comparisons in memory."""
        return len(self._pending) + len(self._joined) + len(self._implied)

    def pending(self, operator: int, moment: int, is_begun: bool) -> Obligation:
        """An operator that started at one of its moments."""
        key = (operator, moment, is_begun)
        found = self._pending.get(key)
        if found is None:
            self._serial += 1
            found = Obligation(self._serial, Kind.PENDING, operator=operator, moment=moment, is_begun=is_begun)
            self._pending[key] = found
        return found

    def all(self, parts: Iterable[Obligation]) -> Obligation:
        """The conjunction."""
        return self._join(Kind.ALL, parts)

    def any(self, parts: Iterable[Obligation]) -> Obligation:
        """The disjunction."""
        return self._join(Kind.ANY, parts)

    def renamed(self, obligation: Obligation, name: Callable[[Obligation], Obligation]) -> Obligation:
        """The obligation in which `name` replaces each pending part. Equal members become one; nothing else is
        simplified.
        """
        if obligation.kind is Kind.VALUE:
            return self.values[obligation.value]
        if obligation.kind is Kind.PENDING:
            return name(obligation)
        parts = list(dict.fromkeys(self.renamed(part, name) for part in obligation.parts))
        return parts[0] if len(parts) == 1 else self._node(obligation.kind, parts)

    def replaced(self, obligation: Obligation, other: Callable[[Obligation], Obligation]) -> Obligation:
        """The obligation in which `other` replaces each pending part, simplified."""
        if obligation.kind is Kind.VALUE:
            return obligation
        if obligation.kind is Kind.PENDING:
            return other(obligation)
        return self._join(obligation.kind, [self.replaced(part, other) for part in obligation.parts])

    def _join(self, kind: Kind, parts: Iterable[Obligation]) -> Obligation:
        dominant = self.values[FALSE if kind is Kind.ALL else TRUE]
        neutral = self.values[TRUE if kind is Kind.ALL else FALSE]
        simple: dict[Obligation, None] = {}
        nested: dict[Obligation, None] = {}
        ahead = list(parts)
        ahead.reverse()
        while ahead:
            part = ahead.pop()
            if part is dominant:
                return dominant
            if part.kind is kind:
                ahead.extend(reversed(part.parts))
            elif part.kind is Kind.VALUE or part.kind is Kind.PENDING:
                if part is not neutral:
                    simple[part] = None
            else:
                nested[part] = None
        chains = self._thinned(kind, simple)
        if nested and len(simple) + len(nested) > 1:
            context = _Context(kind, simple, nested, chains, {})
            reduced = [self._reduced(context, part) for part in nested]
            if any(new is not old for new, old in zip(reduced, nested, strict=True)):
                return self._join(kind, [*simple, *reduced])
        if len(nested) > 1:
            nested = self._absorbed(kind, list(nested))
        members = [*simple, *nested]
        if len(members) < 2:
            return members[0] if members else neutral
        return self._node(kind, members)

    def _node(self, kind: Kind, members: list[Obligation]) -> Obligation:
        members.sort(key=_serial)
        key = (kind, *(member.serial for member in members))
        found = self._joined.get(key)
        if found is None:
            self._serial += 1
            found = Obligation(self._serial, kind, parts=tuple(members))
            if found.size > MOST_MEMBERS:
                raise TooManyObligationsError(
                    f"more than {MOST_MEMBERS:,} obligations are open at once: shorten the intervals, nest fewer "
                    "of them, or take fewer states a second"
                )
            self._joined[key] = found
        return found

    def _thinned(self, kind: Kind, simple: dict[Obligation, None]) -> dict[int, Obligation]:
        """Remove pending obligations that another one of their operator decides. Returns the kept one of
        each operator.
        """
        kept: dict[int, Obligation] = {}
        for part in list(simple):
            if self._is_comparable(part):
                other = kept.get(part.operator)
                if other is None:
                    kept[part.operator] = part
                    continue
                if self._orders(kind, part, other):
                    kept[part.operator] = part
                    del simple[other]
                else:
                    del simple[part]
        return kept

    def _reduced(self, context: _Context, part: Obligation) -> Obligation:
        """A member without the parts that other members imply (conjunction) or are implied by (disjunction)."""
        parts = [self._within(context, each) for each in part.parts]
        same = all(new is old for new, old in zip(parts, part.parts, strict=True))
        return part if same else self._join(part.kind, parts)

    def _within(self, context: _Context, part: Obligation) -> Obligation:
        if part.kind is Kind.VALUE or part.kind is Kind.PENDING:
            chain = context.chains.get(part.operator) if self._is_comparable(part) else None
            decided = part in context.simple or (chain is not None and self._orders(context.kind, chain, part))
            return self.values[TRUE if context.kind is Kind.ALL else FALSE] if decided else part
        found = context.done.get(part)
        if found is None:
            decided = part in context.nested
            found = (
                self.values[TRUE if context.kind is Kind.ALL else FALSE] if decided else self._reduced(context, part)
            )
            context.done[part] = found
        return found

    def _orders(self, kind: Kind, member: Obligation, part: Obligation) -> bool:
        """Whether `member` implies `part` (in a conjunction), or is implied by it (in a disjunction)."""
        earlier = (kind is Kind.ALL) == self._rises[part.operator]
        return member.moment <= part.moment if earlier else member.moment >= part.moment

    def _is_comparable(self, part: Obligation) -> bool:
        return part.kind is Kind.PENDING and (part.is_begun or self._is_endless[part.operator])

    def _absorbed(self, kind: Kind, nested: list[Obligation]) -> dict[Obligation, None]:
        """The members that no other member makes redundant. If there are many members, each is compared only with near
        ones.
        """
        kept: dict[Obligation, None] = {}
        for position, part in enumerate(nested):
            others = nested if len(nested) <= _MOST_PARTS_COMPARED else nested[max(0, position - 2) : position + 3]
            if not any(self._makes_needless(kind, other, part) for other in others if other is not part):
                kept[part] = None
        return kept

    def _makes_needless(self, kind: Kind, other: Obligation, part: Obligation) -> bool:
        low, high = (other, part) if kind is Kind.ALL else (part, other)
        if not self.implies(low, high):
            return False
        return other.serial < part.serial or not self.implies(high, low)

    def implies(self, low: Obligation, high: Obligation) -> bool:
        """Whether `low` is at most as true as `high` in every continuation. False if this is not known."""
        if low is high:
            return True
        if low.kind is Kind.VALUE and low.value != UNKNOWN:
            return low.value == FALSE
        if high.kind is Kind.VALUE and high.value != UNKNOWN:
            return high.value == TRUE
        if low.kind is Kind.PENDING and high.kind is Kind.PENDING:
            if low.operator != high.operator or not (self._is_comparable(low) and self._is_comparable(high)):
                return False
            return self._orders(Kind.ALL, low, high)
        key = (low.serial, high.serial)
        found = self._implied.get(key)
        if found is None:
            if low.kind is Kind.ANY:
                found = all(self.implies(part, high) for part in low.parts)
            elif high.kind is Kind.ALL:
                found = all(self.implies(low, part) for part in high.parts)
            else:
                found = (low.kind is Kind.ALL and any(self.implies(part, high) for part in low.parts)) or (
                    high.kind is Kind.ANY and any(self.implies(low, part) for part in high.parts)
                )
            self._implied[key] = found
        return found


def bound(obligation: Obligation, pending: Truth) -> Truth:
    """The truth of an obligation if all pending ones had the truth `pending`: with FALSE the least possible, with TRUE
    the greatest.
    """
    match obligation.kind:
        case Kind.VALUE:
            return obligation.value
        case Kind.PENDING:
            return pending
        case Kind.ALL:
            return min(bound(part, pending) for part in obligation.parts)
        case _:
            return max(bound(part, pending) for part in obligation.parts)


def _serial(obligation: Obligation) -> int:
    return obligation.serial
