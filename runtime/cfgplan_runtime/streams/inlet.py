"""Inputs that change their source without losing, repeating or reordering an element.

An inlet has an active source and, while it is rewired, a standby. The standby's elements wait until the active source
has sent everything before the first of them. Then the inlet switches, and skips elements of the standby that are not
newer. So the moments of the elements that it delivers always rise. A unit that has given its state to the next one
pauses, and so does a unit that it feeds; both announce it. By then, every element before the standby's first one has
come.

If an inlet has to switch early, it still reads the former source: elements before the first one of the new source are
delivered until the new source has sent one, and counted as dropped from then on.

If it is rewired again before it has switched, it reads the earlier standbys too: the active source may have ended, and
only they send the elements between its last one and the first one of the latest standby.
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
    dropped: int = 0
    stale: int = 0
    """The number of elements that were not newer than the last delivered one."""
    last: Moment = BEFORE_ALL
    _standbys: dict[int, deque[Element]] = field(default_factory=dict)
    """The waiting elements of each standby; the latest standby is last."""
    _ended: set[int] = field(default_factory=set)
    """Earlier standbys that have ended and have waiting elements."""
    _next_number: dict[int, int] = field(default_factory=dict)
    _former: dict[int, Moment] = field(default_factory=dict)
    """Sources from which the inlet switched early, each with the moment up to which it is still read."""
    _paused: set[int] = field(default_factory=set)
    """Sources that have paused after their last element."""

    @property
    def sources(self) -> set[int]:
        """The wires to read."""
        wires = {*self._standbys, *self._former} - self._ended
        if self.active is not None:
            wires.add(self.active)
        return wires

    @property
    def standby(self) -> int | None:
        """The latest standby."""
        return next(reversed(self._standbys), None)

    @property
    def is_paused(self) -> bool:
        """Whether the active source pauses."""
        return self.active in self._paused

    def attach(self, wire: int) -> bool:
        """Add a source. Returns whether it is active at once; otherwise it becomes the latest standby."""
        if self.active is None:
            self.active = wire
            return True
        self._standbys[wire] = deque()
        return False

    def accept(self, wire: int, element: Element) -> list[Element]:
        """Take an element from `wire`. Returns the elements to deliver now."""
        self._paused.discard(wire)
        if wire == self.active:
            self._count_drops(wire, element)
            handed_on = self._from_new([element])
            return handed_on + self._switch_when_due()
        if wire in self._standbys:
            self._count_drops(wire, element)
            held = self._standbys[wire]
            held.append(element)
            # More would have no room where they are handed on.
            is_full = len(held) >= max(self.limit, 2)
            return (self._switch_to(wire, BEFORE_ALL) if is_full else []) + self._switch_when_due()
        if wire in self._former:
            self._count_drops(wire, element)
            if element.moment >= self._former[wire]:
                self._forget_former(wire)
            elif element.moment > self.last:
                return self._newer([element])
            else:
                self.dropped += 1
        return []

    def pause(self, wire: int) -> list[Element]:
        """Record that `wire` pauses until its next element. Returns the elements to deliver now."""
        self._paused.add(wire)
        return self._switch_when_due()

    def end(self, wire: int) -> list[Element]:
        """Record the end of `wire`. Returns the elements to deliver now."""
        if wire == self.active:
            self.active = None
            self._forget_wire(wire)
            return self._next_active()
        if wire in self._former:
            self._forget_former(wire)
        elif wire == self.standby or not self._standbys.get(wire):
            self._forget_standby(wire)
        else:
            self._ended.add(wire)
        return []

    def switch(self, now: Moment = BEFORE_ALL) -> list[Element]:
        """Make the latest standby the active source at once. Returns the elements to deliver now.

        If the standby has sent nothing yet, elements of the former sources from before `now` are still delivered.
        """
        return [] if self.standby is None else self._switch_to(self.standby, now)

    def _switch_to(self, wire: int, now: Moment) -> list[Element]:
        """Make a standby the active source. Earlier sources are read up to its first element, or up to `now`."""
        held = self._standbys[wire]
        until = held[0].moment if held else now
        left = [] if self.active is None else [self.active]
        earlier = list[Element]()
        for other in list(self._standbys)[: list(self._standbys).index(wire)]:
            earlier += (one for one in self._standbys[other] if one.moment < until)
            left += [other] * (other not in self._ended)
            self._forget_standby(other, is_read=other not in self._ended)
        del self._standbys[wire]
        delivered = self._newer(sorted(earlier, key=lambda one: one.moment))
        for other in left:
            self._former[other] = until
            if until <= self.last:
                self._forget_former(other)
        self.active = wire
        return delivered + self._from_new(held)

    def _next_active(self) -> list[Element]:
        """Make the earliest standby the active source that has not ended, after the elements of those that have."""
        delivered = list[Element]()
        while self.active is None and self._standbys:
            wire = next(iter(self._standbys))
            held, has_ended = self._standbys[wire], wire in self._ended
            self._forget_standby(wire, is_read=not has_ended)
            self.active = None if has_ended else wire
            delivered += self._from_new(held)
        return delivered + self._switch_when_due()

    def _switch_when_due(self) -> list[Element]:
        """Switch to the latest standby whose first element the active source has sent, too. If that source pauses,
        switch to the earliest standby.
        """
        for wire in reversed(self._standbys):
            held = self._standbys[wire]
            if held and wire not in self._ended and self.last >= held[0].moment:
                return self._switch_to(wire, BEFORE_ALL) + self._switch_when_due()
        for wire, held in self._standbys.items() if self.is_paused else ():
            if held and wire not in self._ended:
                return self._switch_to(wire, BEFORE_ALL) + self._switch_when_due()
            if wire not in self._ended | self._paused:
                break  # what it still sends comes before the elements of later standbys
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
        self._forget_wire(wire)

    def _forget_standby(self, wire: int, *, is_read: bool = False) -> None:
        """Forget the waiting elements of a standby, and their numbers unless the wire `is_read` on."""
        self._standbys.pop(wire, None)
        self._ended.discard(wire)
        if not is_read:
            self._forget_wire(wire)

    def _forget_wire(self, wire: int) -> None:
        """Forget the numbers and the pause of a wire that is not read any more."""
        self._next_number.pop(wire, None)
        self._paused.discard(wire)
