"""Inputs that change their source without losing, repeating or reordering an element.

An inlet has an active source and, while it is rewired, a standby. The standby's elements wait until the active source
has sent everything before the first of them. Then the inlet switches, and skips elements of the standby that are not
newer. So the moments of the elements that it delivers always rise. If it has to switch early, it still reads the former
source: elements before the first one of the new source are delivered until the new source has sent one, and counted as
dropped from then on.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

from cfgplan_runtime.streams.element import BEFORE_ALL, Element, Moment


def slot(port: str, number: int) -> str:
    """The name of the inlet for stream `number`, from 1, of an input that takes several."""
    return f"{port}/{number}"


def port_of(inlet: str) -> str:
    """The input port of a unit's inlet: a port's name has no slash."""
    return inlet.partition("/")[0]


@dataclass(slots=True)
class InputQueue:
    """One input. Sources are numbers of wires; other modules handle the sockets. `limit` bounds a standby's
    elements.
    """

    limit: int
    active: int | None = None
    standby: int | None = None
    dropped: int = 0
    stale: int = 0
    """The number of elements that were not newer than the last delivered one."""
    last: Moment = BEFORE_ALL
    _held: deque[Element] = field(default_factory=deque)
    _next_number: dict[int, int] = field(default_factory=dict)
    _former: dict[int, Moment] = field(default_factory=dict)
    """Sources from which the inlet switched early, each with the moment up to which it is still read."""

    @property
    def sources(self) -> set[int]:
        """The wires to read."""
        return {wire for wire in (self.active, self.standby, *self._former) if wire is not None}

    def attach(self, wire: int) -> bool:
        """Add a source. Returns whether it is active at once; otherwise it becomes the standby, in place of an earlier
        one.
        """
        if self.active is None:
            self.active = wire
            return True
        self._forget_standby()
        self.standby = wire
        return False

    def accept(self, wire: int, element: Element) -> list[Element]:
        """Take an element from `wire`. Returns the elements to deliver now."""
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
        """Record the end of `wire`. Returns the elements to deliver now."""
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

    def switch(self, now: Moment = BEFORE_ALL) -> list[Element]:
        """Make the standby the active source at once. Returns the elements to deliver now.

        If the standby has sent nothing yet, elements of the former source from before `now` are still delivered.
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
        """The newer elements of the active source. Later elements of former sources are not needed."""
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
