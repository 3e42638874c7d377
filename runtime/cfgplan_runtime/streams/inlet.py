"""Inputs that change their source without losing, repeating or reordering an element.

An inlet has an active source and, while it is rewired, a standby. The standby's elements wait until
the active source has given everything before the first of them; then the inlet switches, and skips those
of the standby that are not newer. So the moments of the elements that it hands on always rise. If it has to switch
before that, the former source is read on: what it gives from before the first element of the new one is handed on as
long as that has given none, and counted as dropped from then on.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

from cfgplan_runtime.streams.element import Element, Moment

_BEFORE_ALL: Moment = (-(1 << 63), -1)


def slot(port: str, number: int) -> str:
    """The name of the inlet for one of the streams, from 1, of an input that takes several."""
    return f"{port}/{number}"


def port_of(inlet: str) -> str:
    """The input port that the inlet of a unit belongs to: no port's name has a slash."""
    return inlet.partition("/")[0]


@dataclass(slots=True)
class InputQueue:
    """One input. Sources are numbers of wires; sockets are handled elsewhere. `limit` is for a standby's elements."""

    limit: int
    active: int | None = None
    standby: int | None = None
    dropped: int = 0
    stale: int = 0
    """How many elements were not newer than the last one handed on."""
    last: Moment = _BEFORE_ALL
    _held: deque[Element] = field(default_factory=deque)
    _next_number: dict[int, int] = field(default_factory=dict)
    _former: dict[int, Moment] = field(default_factory=dict)
    """The sources that were left too early, until they have given everything from before a moment."""

    @property
    def sources(self) -> set[int]:
        """The wires to read."""
        return {wire for wire in (self.active, self.standby, *self._former) if wire is not None}

    def attach(self, wire: int) -> bool:
        """Add a source. Returns whether it is active at once; otherwise it replaces the standby, if there is one."""
        if self.active is None:
            self.active = wire
            return True
        self._forget_standby()
        self.standby = wire
        return False

    def accept(self, wire: int, element: Element) -> list[Element]:
        """Take an element from `wire`. Returns the elements to hand on now."""
        if wire == self.active:
            self._count_drops(wire, element)
            handed_on = self._from_new([element])
            return handed_on + self._switch_when_due()
        if wire == self.standby:
            self._count_drops(wire, element)
            self._held.append(element)
            # More would have no room where they are handed on.
            is_full = len(self._held) >= max(self.limit, 2)
            return self.switch() if is_full else self._switch_when_due()
        if wire in self._former:
            self._count_drops(wire, element)
            if element.moment >= self._former[wire]:
                self._forget_former(wire)
            elif element.moment > self.last:
                return self._newer([element])
            else:
                self.dropped += 1
        return []

    def end(self, wire: int) -> list[Element]:
        """Note the end of `wire`. Returns the elements to hand on now."""
        if wire == self.standby:
            self._forget_standby()
        elif wire in self._former:
            self._forget_former(wire)
        elif wire == self.active:
            self.active = None
            self._next_number.pop(wire, None)
            if self.standby is not None:
                return self.switch()
        return []

    def switch(self, now: Moment = _BEFORE_ALL) -> list[Element]:
        """Make the standby the active source at once. Returns the elements to hand on now.

        If it has given nothing yet, the former source still counts for what it has given before `now`.
        """
        if self.standby is None:
            return []
        held, self._held = self._held, deque()
        if self.active is not None:
            self._former[self.active] = held[0].moment if held else now
            if self._former[self.active] <= self.last:
                self._forget_former(self.active)
        self.active, self.standby = self.standby, None
        return self._from_new(held)

    def _switch_when_due(self) -> list[Element]:
        if self._held and self.last >= self._held[0].moment:
            return self.switch()
        return []

    def _from_new(self, elements: deque[Element] | list[Element]) -> list[Element]:
        """The newer elements of the active source. What former sources give from after that is not needed."""
        newer = self._newer(elements)
        if newer and self._former:
            self._former = {wire: min(until, newer[0].moment) for wire, until in self._former.items()}
        return newer

    def _newer(self, elements: deque[Element] | list[Element]) -> list[Element]:
        newer = []
        for element in elements:
            if element.moment > self.last:
                self.last = element.moment
                newer.append(element)
            else:
                self.stale += 1
        return newer

    def _count_drops(self, wire: int, element: Element) -> None:
        self.dropped += element.number - self._next_number.get(wire, 0)
        self._next_number[wire] = element.number + 1

    def _forget_former(self, wire: int) -> None:
        del self._former[wire]
        self._next_number.pop(wire, None)

    def _forget_standby(self) -> None:
        if self.standby is not None:
            self._next_number.pop(self.standby, None)
        self.standby = None
        self._held.clear()
