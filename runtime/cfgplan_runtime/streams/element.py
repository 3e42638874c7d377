"""Elements of streams (Definition 1) on their way: a header and a payload."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

Buffer: TypeAlias = "bytes | bytearray | memoryview"

Moment: TypeAlias = tuple[int, int]
"""An element's time in nanoseconds, and its turn among elements of that time. Moments rise along a stream."""

BEFORE_ALL: Moment = (-(1 << 63), -1)
"""The moment before every element."""

HEADER = struct.Struct("<IIIQq")
"""HEADER_MARK, length of the payload, turn, sequence number within the subscription, time in nanoseconds."""
HEADER_MARK = 0x9E3779B9
"""The first bytes of a header: what a faulty unit writes into a channel is not taken for the length of an element."""

PLACE_MARK = 0x9E3779BA
"""The first bytes of a header that is no element, but tells the moment after which a subscription has every element;
its sequence number is the number of elements before.
"""

PAUSE_MARK = 0x9E3779BB
"""The first bytes of a header that is no element, but tells that the sender pauses: the next element that it gives, if
any, ends the pause.
"""

LONGEST_PAYLOAD = 1 << 31


class Element(NamedTuple):
    """A received element. `number` counts the elements offered to the subscription, so a gap in the numbers
    is a drop.
    """

    time_ns: int
    turn: int
    number: int
    payload: Buffer

    @property
    def moment(self) -> Moment:
        return (self.time_ns, self.turn)


@dataclass(slots=True)
class Outgoing:
    """An element to be sent to any number of subscribers. Its parts may share the memory of user code."""

    time_ns: int
    turn: int
    parts: list[Buffer]
    size: int = 0

    def __post_init__(self) -> None:
        self.size = sum(map(len, self.parts))

    def header(self, number: int) -> bytes:
        return HEADER.pack(HEADER_MARK, self.size, self.turn, number, self.time_ns)

    def own(self) -> None:
        """Copy the parts, once, so that user code may change its arrays while this waits."""
        if len(self.parts) != 1 or not isinstance(self.parts[0], bytes):
            self.parts = [b"".join(self.parts)]
