"""Crossings: what goes from one computer to another, in order and once, over links that may lose or repeat it.

The sender numbers pieces and keeps each until the receiver has told that it came. It sends at most so much beyond
that, and no more than the receiver has room for: what waits meanwhile is bounded, and drops, or makes the producer
wait. So a cut, a full link and a slow receiver look the same, and each crossing has a fate of its own.
"""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from math import inf
from typing import NamedTuple, TypeAlias
from urllib.parse import quote

from cfgplan_runtime.streams.channel import MOST_WAITING_BYTES
from cfgplan_runtime.streams.element import Buffer

KEYS = "cfgplan"
"""What every key of a fleet begins with."""
PIECES_UNDER_WAY = 256
"""The most pieces on their way."""
BYTES_UNDER_WAY = 1 << 20
"""The most bytes on their way, but two pieces always: more would delay what else goes over a slow link."""
MOST_PIECES = 4096
"""The most pieces that wait to be sent: two seconds (a lease) at 2,000 Hz."""
_TOLD_EVERY, _TOLD_EVERY_BYTES = PIECES_UNDER_WAY // 8, BYTES_UNDER_WAY // 8
_LATEST_CREDIT_S = 0.05
"""A piece that came is acknowledged so much later at most."""
_RESEND_S, _MOST_RESEND_S = 0.25, 0.5
"""Seconds without any acknowledgement until a piece is sent again, doubled each time up to the second value."""
_FIRST_ASK_S = 0.01
"""Seconds until a sender asks for its first credit, doubled each time: what was told before it was there is lost."""
_ASK_AGAIN_S = 0.1
_MOST_MISSING = 64

Put: TypeAlias = Callable[[bytes, bytes], None]
"""Puts a head and a payload into the network."""

_HEAD = struct.Struct("<QQqIB")
_CREDIT = struct.Struct("<QQ")
_MISSING_NUMBER = struct.Struct("<Q")


class Piece(NamedTuple):
    """An element on its way between hosts; with `is_last`, the end of its stream, which has no payload.

    With `is_mark` it tells whoever is named in it that everything that was given before has come.
    """

    time_ns: int
    turn: int
    payload: Buffer
    is_last: bool = False
    is_mark: bool = False

    @property
    def is_element(self) -> bool:
        return not (self.is_last or self.is_mark)


LAST_PIECE = Piece(0, 0, b"", is_last=True)
_ELEMENT, _LAST, _QUESTION, _MARKER = range(4)
"""Kinds of frames."""


class Frame(NamedTuple):
    """A piece with its number; `dropped` pieces had no room, of all before it. Without a piece it asks for a credit."""

    number: int
    dropped: int
    piece: Piece | None

    def head(self) -> bytes:
        """All but the payload."""
        piece = self.piece
        if piece is None:
            return _HEAD.pack(self.number, self.dropped, 0, 0, _QUESTION)
        kind = _LAST if piece.is_last else _MARKER if piece.is_mark else _ELEMENT
        return _HEAD.pack(self.number, self.dropped, piece.time_ns, piece.turn, kind)


def read_frame(head: bytes, payload: bytes) -> Frame | None:
    """A frame as it came; None if it is none."""
    if len(head) != _HEAD.size:
        return None
    number, dropped, time_ns, turn, kind = _HEAD.unpack(head)
    return Frame(
        number, dropped, None if kind == _QUESTION else Piece(time_ns, turn, payload, kind == _LAST, kind == _MARKER)
    )


@dataclass(frozen=True, slots=True)
class Credit:
    """What a receiver tells: all before `expected` has come, numbers below `limit` have room, some are `missing`."""

    expected: int
    limit: int
    missing: tuple[int, ...] = ()

    def packed(self) -> bytes:
        return _CREDIT.pack(self.expected, self.limit) + b"".join(map(_MISSING_NUMBER.pack, self.missing))


def read_credit(data: bytes) -> Credit | None:
    """A credit as it came; None if it is none."""
    if len(data) < _CREDIT.size or (len(data) - _CREDIT.size) % _MISSING_NUMBER.size:
        return None
    expected, limit = _CREDIT.unpack_from(data)
    return Credit(expected, limit, tuple(number for (number,) in _MISSING_NUMBER.iter_unpack(data[_CREDIT.size :])))


def host_key(host: str | None) -> str:
    """The key below which a host, or any (None), writes."""
    return f"{KEYS}/{_named(host)}"


def crossing_key(sender: str | None, kind: str, receiver: str, crossing: str) -> str:
    """The key of what `sender`, or any (None), tells `receiver`. Of crossings "*" stands for any."""
    return f"{host_key(sender)}/{kind}/{_named(receiver)}/{crossing}"


def _named(host: str | None) -> str:
    return "*" if host is None else quote(host, safe="")


class Sending:
    """The sender's end. `blocks`: `is_full` tells the producer to wait; otherwise the oldest are dropped.

    `granted` pieces may be sent before anything is heard of the receiver.
    """

    def __init__(self, *, blocks: bool = False, most: int = MOST_PIECES, granted: int = 0) -> None:
        self.dropped = 0
        self._blocks = blocks
        self._most = most
        self._waiting: deque[Piece] = deque()
        self._waiting_bytes = 0
        self._under_way: dict[int, Frame] = {}
        self._under_way_bytes = 0
        self._next = 0
        self._dropped_before = 0
        """How many were dropped before the last piece that arrived: the receiver knows of them."""
        self._limit = granted
        self._missing: set[int] = set()
        self._again_s: float | None = None
        """When to send again if nothing is heard; None if nothing waits for an acknowledgement."""
        self._patience_s = _RESEND_S if granted else _FIRST_ASK_S

    @property
    def depth(self) -> int:
        """How many pieces have not arrived, as far as is known."""
        return len(self._waiting) + len(self._under_way)

    @property
    def lost(self) -> int:
        """How many elements are lost if no more is sent: those that have not arrived, and drops after the last one."""
        pieces = [*self._waiting, *(frame.piece for frame in self._under_way.values() if frame.piece is not None)]
        return sum(piece.is_element for piece in pieces) + self.dropped - self._dropped_before

    @property
    def is_full(self) -> bool:
        return self._blocks and (len(self._waiting) >= self._most or self._waiting_bytes > MOST_WAITING_BYTES)

    def offer(self, piece: Piece) -> None:
        """Have a piece sent."""
        self._waiting.append(piece)
        self._waiting_bytes += len(piece.payload)
        while not self._blocks and len(self._waiting) > 1 and self._has_too_many:
            elements = (number for number, one in enumerate(self._waiting) if one.is_element)
            oldest, newer = next(elements, None), next(elements, None)
            if oldest is None or newer is None:
                return
            self._waiting_bytes -= len(self._waiting[oldest].payload)
            del self._waiting[oldest]
            self.dropped += 1

    def hear(self, credit: Credit) -> None:
        """Note what the receiver tells; what it told before may come later."""
        arrived = [number for number in self._under_way if number < credit.expected]
        for number in arrived:
            frame = self._under_way.pop(number)
            self._under_way_bytes -= self._size(frame)
            self._dropped_before = frame.dropped
        if arrived or credit.limit > self._limit:
            self._patience_s, self._again_s = _RESEND_S, None
        self._limit = max(self._limit, credit.limit)
        self._missing.update(credit.missing)

    def due(self, now_s: float) -> list[Frame]:
        """The frames to send now."""
        frames = [self._under_way[number] for number in sorted(self._missing) if number in self._under_way]
        self._missing.clear()
        while self._waiting and self._next < self._limit and self._has_window:
            piece = self._waiting.popleft()
            self._waiting_bytes -= len(piece.payload)
            frame = self._under_way[self._next] = Frame(self._next, self.dropped, piece)
            self._under_way_bytes += self._size(frame)
            self._next += 1
            frames.append(frame)
        if self.depth and self._again_s is not None and now_s >= self._again_s:
            # By the last one the receiver sees what else is missing.
            known = list(self._under_way.values())
            frames += known[:1] + known[1:][-1:] or [Frame(self._next, self.dropped, None)]
            self._patience_s, self._again_s = min(2 * self._patience_s, _MOST_RESEND_S), None
        if not self.depth:
            self._again_s = None
        elif self._again_s is None:
            self._again_s = now_s + self._patience_s
        return frames

    @property
    def due_s(self) -> float | None:
        """The time of the next repetition, if no answer comes before."""
        return self._again_s

    @property
    def _has_window(self) -> bool:
        return self._under_way_bytes < BYTES_UNDER_WAY or len(self._under_way) < 2

    @property
    def _has_too_many(self) -> bool:
        return len(self._waiting) > self._most or self._waiting_bytes > MOST_WAITING_BYTES

    @staticmethod
    def _size(frame: Frame) -> int:
        return 0 if frame.piece is None else len(frame.piece.payload)


class Receiving:
    """The receiver's end: puts frames in order and tells the sender what has come."""

    def __init__(self) -> None:
        self.dropped = 0
        """How many pieces had no room before the last one that was handed on."""
        self._expected = 0
        self._held: dict[int, Frame] = {}
        self._untold = self._untold_bytes = 0
        self._tell_s: float | None = None
        self._asked_s = 0.0
        self._asked_to = 0
        """Of the numbers before this one those that are missing were asked for."""
        self._limit = 0

    def take(self, frame: Frame, now_s: float) -> list[Piece]:
        """Take a frame. Returns the pieces to hand on now, in order."""
        if frame.piece is None or frame.number < self._expected or frame.number in self._held:
            self._tell_s = now_s  # the sender does not know what has come
            return []
        if frame.number >= self._expected + 2 * PIECES_UNDER_WAY:
            return []
        self._held[frame.number] = frame
        pieces = []
        while (next_one := self._held.pop(self._expected, None)) is not None:
            self._expected += 1
            self.dropped = next_one.dropped
            assert next_one.piece is not None
            pieces.append(next_one.piece)
            self._untold_bytes += len(next_one.piece.payload)
        self._untold += len(pieces)
        is_much = self._untold >= _TOLD_EVERY or self._untold_bytes >= _TOLD_EVERY_BYTES
        due_s = now_s if is_much or self._held else now_s + _LATEST_CREDIT_S
        self._tell_s = due_s if self._tell_s is None else min(self._tell_s, due_s)
        return pieces

    def credit(self, now_s: float, *, has_room: bool = True) -> Credit | None:
        """What is to be told now; None if that is nothing new, or was told just now."""
        limit = self._expected + PIECES_UNDER_WAY if has_room else self._limit
        has_new_room = limit - self._limit >= PIECES_UNDER_WAY // 2
        is_due = self._tell_s is not None and now_s >= self._tell_s
        if not (is_due or has_new_room):
            return None
        self._limit = max(self._limit, limit)
        self._untold = self._untold_bytes = 0
        self._tell_s = now_s + _ASK_AGAIN_S if self._held else None
        missing: tuple[int, ...] = ()
        if self._held:
            first = max(self._expected, self._asked_to)
            if now_s - self._asked_s >= _ASK_AGAIN_S:
                first, self._asked_s = self._expected, now_s
            missing = tuple(n for n in range(first, max(self._held)) if n not in self._held)[:_MOST_MISSING]
            self._asked_to = max(missing, default=self._asked_to - 1) + 1
        return Credit(self._expected, self._limit, missing)

    @property
    def due_s(self) -> float | None:
        """When something is to be told; None if nothing is."""
        return self._tell_s


class Conversation:
    """One end of what goes both ways: what is offered goes on until it has come, and what comes is acknowledged."""

    def __init__(self, sending: Sending) -> None:
        self.sending = sending
        self.receiving = Receiving()

    def take(self, is_credit: bool, head: bytes, payload: bytes, now_s: float) -> list[Piece]:
        """Take what came: a credit, or a frame. Returns the pieces to hand on now, in order."""
        if is_credit:
            credit = read_credit(payload)
            if credit is not None:
                self.sending.hear(credit)
            return []
        frame = read_frame(head, payload)
        return [] if frame is None else self.receiving.take(frame, now_s)

    def pump(self, put: Put, put_credit: Put, now_s: float, *, has_room: bool = True) -> None:
        """Put the pieces that are due. Without room the other end is told not to go on."""
        for frame in self.sending.due(now_s):
            put(frame.head(), b"" if frame.piece is None else bytes(frame.piece.payload))
        credit = self.receiving.credit(now_s, has_room=has_room)
        if credit is not None:
            put_credit(b"", credit.packed())

    @property
    def due_s(self) -> float:
        """When `pump` has something to do, if nothing comes before; infinite if it has not."""
        times = [due_s for due_s in (self.sending.due_s, self.receiving.due_s) if due_s is not None]
        return min(times, default=inf)
