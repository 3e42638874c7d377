"""Channels: the two ends of one subscription's stream socket. No other module reads or writes elements on sockets.

Elements that do not fit into the socket wait at the sender in a bounded queue. When the queue is full, `drop_oldest`
drops the oldest, and the receiver sees the gap in the numbers; with `block` the producer has to wait.
"""

from __future__ import annotations

import socket
from collections import deque
from collections.abc import Iterator

from cfgplan_runtime.streams.element import (
    BEFORE_ALL,
    HEADER,
    HEADER_MARK,
    LONGEST_PAYLOAD,
    PAUSE_MARK,
    PLACE_MARK,
    Buffer,
    Element,
    Moment,
    Outgoing,
)

MOST_WAITING_BYTES = 32 << 20
"""The most bytes that may wait for one subscriber, whatever the queue's length."""

SOCKET_BUFFER = 1 << 20
_FIRST_CHUNK, _CHUNK = 1 << 12, 1 << 16
"""Bytes to read at once: until a read has filled the first chunk, and from then on."""
_MOST_PER_READ = 4 << 20
_MOST_SAID = 1 << 16
"""Bytes from a receiver, which has nothing to say, that are discarded at once."""


def socket_pair() -> tuple[socket.socket, socket.socket]:
    """A channel's two ends: the sender's, the receiver's."""
    sender, receiver = socket.socketpair(socket.AF_UNIX, socket.SOCK_STREAM)
    widen(sender)
    return sender, receiver


def widen(sender: socket.socket) -> None:
    """Enlarge a socket's send buffer, as far as the system allows, so that it takes an image at once."""
    sender.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SOCKET_BUFFER)


class Sender:
    """The producer's end of one subscription."""

    def __init__(self, end: socket.socket, *, queue: int, blocks: bool, wire: int | None = None) -> None:
        end.setblocking(False)
        self.socket = end
        self.wire = wire
        """The supervisor's number of the subscription; None for a subscriber from outside."""
        self.blocks = blocks
        self.dropped = 0
        self.is_closed = False
        self._limit = queue
        self._number = 0
        self._waiting: deque[tuple[int, Outgoing]] = deque()
        self._waiting_bytes = 0
        self._rest: memoryview | None = None
        self._is_to_pause = False
        """Whether a pause is announced to the receiver after the elements that wait."""

    @property
    def is_full(self) -> bool:
        """Whether the producer must wait; only with `block`, where elements queue at the receiver."""
        return self.blocks and self.depth > 0

    @property
    def depth(self) -> int:
        return len(self._waiting) + (self._rest is not None)

    def tell_place(self, last: Moment, before: int) -> None:
        """Tell the receiver, before any element, which element is the last that it does not get, and how many there
        were `before`.
        """
        time_ns, turn = last
        self._say(HEADER.pack(PLACE_MARK, 0, max(turn, 0), before, time_ns))

    def pause(self) -> None:
        """Tell the receiver, after all elements so far, that nothing comes until the next element. The rest waits for
        `flush`.
        """
        self._is_to_pause = True
        self.flush()

    def offer(self, element: Outgoing) -> None:
        """Send an element. The rest waits for `flush`."""
        if self.is_closed:
            return
        number = self._number
        self._number += 1
        self._is_to_pause = False
        if self._rest is None and not self._waiting:
            self._send(number, element)
            return
        element.own()
        self._waiting.append((number, element))
        self._waiting_bytes += element.size
        if not self.blocks:
            while len(self._waiting) > 1 and (
                len(self._waiting) > self._limit or self._waiting_bytes > MOST_WAITING_BYTES
            ):
                self._waiting_bytes -= self._waiting.popleft()[1].size
                self.dropped += 1

    def skip(self, count: int) -> None:
        """Leave a gap in the numbers for `count` elements that were dropped before they came here."""
        self._number += count

    def flush(self) -> bool:
        """Send waiting elements. Returns whether none is left."""
        while not self.is_closed and self.depth:
            if self._rest is not None:
                sent = self._try([self._rest])
                self._rest = self._rest[sent:] if sent < len(self._rest) else None
                if self._rest is not None:
                    break
            else:
                number, element = self._waiting.popleft()
                self._waiting_bytes -= element.size
                self._send(number, element)
        if self._is_to_pause and not self.depth and not self.is_closed:
            self._is_to_pause = False
            self._say(HEADER.pack(PAUSE_MARK, 0, 0, 0, 0))
        return self.is_closed or not self.depth

    def attend(self) -> None:
        """Handle a ready socket: discard what the receiver sent, send waiting elements; give up if it is gone."""
        try:
            is_gone = not self.socket.recv(_MOST_SAID, socket.MSG_DONTWAIT)
        except BlockingIOError:
            is_gone = False
        except OSError:
            is_gone = True
        if is_gone:
            self.give_up()
        else:
            self.flush()

    def give_up(self) -> None:
        """Stop sending. The owner closes the socket once it has stopped watching it."""
        self.is_closed = True
        self._waiting.clear()
        self._rest = None

    def _say(self, head: bytes) -> None:
        """Send a header that is no element. It may be called only while no element waits."""
        sent = self._try([head])
        if sent < len(head) and not self.is_closed:
            self._rest = memoryview(head)[sent:]

    def _send(self, number: int, element: Outgoing) -> None:
        parts = [element.header(number), *element.parts]
        sent = self._try(parts)
        if sent < HEADER.size + element.size and not self.is_closed:
            self._rest = memoryview(_after(parts, sent))

    def _try(self, parts: list[Buffer]) -> int:
        try:
            return self.socket.sendmsg(parts)
        except BlockingIOError:
            return 0
        except OSError:
            self.give_up()
            return 0


class Receiver:
    """The consumer's end of one subscription."""

    def __init__(self, end: socket.socket) -> None:
        end.setblocking(False)
        self.socket = end
        self.has_ended = False
        self.place: Moment | None = None
        """The moment after which it gets every element; None until the sender has told it."""
        self.before = 0
        """How many elements the sender had given by then."""
        self.is_paused = False
        """Whether the sender has announced a pause after its last element."""
        self._chunk = memoryview(bytearray(_FIRST_CHUNK))
        self._pending = b""
        self._header: tuple[int, int, int, int] | None = None
        self._payload: memoryview | None = None
        self._filled = 0
        self._buffers = Buffers()
        self._wanted = _FIRST_CHUNK
        """The bytes to read at once: after a large payload only a header, so that the next payload is not copied."""

    def read(self) -> Iterator[Element]:
        """Yield the elements that have come, in order. Once `has_ended` is set, no more will come."""
        budget = _MOST_PER_READ
        while budget > 0 and not self.has_ended:
            if self._payload is not None:
                got = self._receive(self._payload[self._filled :])
                if got == 0:
                    return
                self._filled += got
                if self._filled == len(self._payload):
                    self._wanted = HEADER.size
                    yield self._complete(self._payload)
            else:
                wanted = self._wanted
                got = self._receive(self._chunk[:wanted])
                if got == 0:
                    return
                data = self._pending + self._chunk[:got]
                if got == _FIRST_CHUNK and len(self._chunk) < _CHUNK:
                    self._chunk = memoryview(bytearray(_CHUNK))
                self._wanted = len(self._chunk)
                yield from self._parse(data)
                if got < wanted and self._payload is None:
                    return
            budget -= got

    def close(self) -> None:
        self.has_ended = True
        self.socket.close()

    def _parse(self, data: bytes) -> Iterator[Element]:
        start = 0
        while True:
            if self._header is None:
                if len(data) - start < HEADER.size:
                    break
                mark, length, turn, number, time_ns = HEADER.unpack_from(data, start)
                self._header = length, turn, number, time_ns
                start += HEADER.size
                if mark == PLACE_MARK:
                    self.place = BEFORE_ALL if time_ns == BEFORE_ALL[0] else (time_ns, turn)
                    self.before, self._header = number, None
                    continue
                if mark == PAUSE_MARK:
                    self.is_paused, self._header = True, None
                    continue
                if mark != HEADER_MARK or length > LONGEST_PAYLOAD:
                    self.has_ended = True
                    return
            length = self._header[0]
            if len(data) - start >= length:
                payload = data[start : start + length]
                start += length
                yield self._complete(payload)
            elif length > _CHUNK:
                self._payload = self._buffers.take(length)
                self._filled = len(data) - start
                self._payload[: self._filled] = data[start:]
                start = len(data)
                break
            else:
                break
        self._pending = data[start:]

    def _complete(self, payload: Buffer) -> Element:
        assert self._header is not None
        _, turn, number, time_ns = self._header
        self._header = self._payload = None
        self.is_paused = False
        return Element(time_ns, turn, number, payload)

    def _receive(self, into: memoryview) -> int:
        try:
            got = self.socket.recv_into(into)
        except BlockingIOError:
            return 0
        except OSError:
            got = 0
        if got == 0:
            self.has_ended = True
        return got


def _after(parts: list[Buffer], start: int) -> bytes:
    """A copy of the bytes after the first `start` of all parts together."""
    left: list[Buffer] = []
    for part in parts:
        if start < len(part):
            left.append(memoryview(part)[start:])
        start = max(0, start - len(part))
    return b"".join(left)


_MOST_KEPT = 32


class Buffers:
    """Buffers of one subscription. A buffer is reused when every view of it is gone."""

    def __init__(self) -> None:
        self._used: deque[bytearray] = deque()

    def take(self, length: int) -> memoryview:
        """A writable view of `length` bytes with any content."""
        if self._used and len(self._used[0]) == length and _is_free(self._used[0]):
            buffer = self._used.popleft()
        else:
            buffer = bytearray(length)
            if len(self._used) == _MOST_KEPT or (self._used and len(self._used[0]) != length):
                self._used.popleft()
        self._used.append(buffer)
        return memoryview(buffer)


def _is_free(buffer: bytearray) -> bool:
    """Whether no view of a bytearray exists: while one does, it can't be resized."""
    try:
        buffer.append(0)
        buffer.pop()
    except BufferError:
        return False
    return True
