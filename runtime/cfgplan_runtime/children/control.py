"""The supervisor's connections to its children: typed messages, some with open sockets attached."""

from __future__ import annotations

import errno
import os
import socket
import struct
from collections import deque
from collections.abc import Iterator, Sequence
from typing import Any, Generic, TypeVar

import msgspec

Incoming = TypeVar("Incoming")

_MESSAGE_HEAD = struct.Struct("<II")
_MOST_SOCKETS = 64
_MESSAGE_CHUNK = 1 << 16
LONGEST_MESSAGE = 1 << 28
"""The most bytes of a message; the longest ones have the state of a unit, or the elements that wait in it."""


_decoders: dict[int, tuple[object, msgspec.msgpack.Decoder[Any]]] = {}
"""By the id of a type: this type, and the decoder of its messages."""


def decoder(incoming: object) -> msgspec.msgpack.Decoder[Any]:
    """Return the decoder of the messages of a type. Decoders are kept: a child uses those of its nursery.

    The type's id is the key, because the hash of a union uses all its types, and a child would copy their memory.
    """
    found = _decoders.get(id(incoming))
    if found is None:
        found = _decoders[id(incoming)] = incoming, msgspec.msgpack.Decoder(incoming)
    return found[1]


class ControlConnection(Generic[Incoming]):
    """One end of a connection. Sending never blocks: messages wait for `flush` until the socket takes them."""

    def __init__(self, end: socket.socket, incoming: object) -> None:
        end.setblocking(False)
        self.socket = end
        self.has_ended = False
        self.is_garbled = False
        """Whether it has ended because of bytes that were no message."""
        self._decoder: msgspec.msgpack.Decoder[Incoming] = decoder(incoming)
        self._received = bytearray()
        self._descriptors: deque[int] = deque()
        self._waiting: deque[tuple[memoryview, list[socket.socket]]] = deque()

    @property
    def is_waiting(self) -> bool:
        """Whether messages wait for `flush`."""
        return bool(self._waiting)

    def send(self, message: msgspec.Struct, sockets: Sequence[socket.socket] = ()) -> None:
        """Send a message; its sockets go to the receiver and are closed here. Does nothing else once it has ended."""
        if self.has_ended:
            for attached in sockets:
                attached.close()
            return
        body = msgspec.msgpack.encode(message)
        data = memoryview(_MESSAGE_HEAD.pack(len(body), len(sockets)) + body)  # the rest of a long one is not copied
        self._waiting.append((data, list(sockets)))
        self.flush()

    def flush(self) -> bool:
        """Send waiting messages. Returns whether none is left."""
        while self._waiting and not self.has_ended:
            data, sockets = self._waiting[0]
            try:
                if sockets:
                    sent = socket.send_fds(self.socket, [data], [s.fileno() for s in sockets])
                else:
                    sent = self.socket.send(data)
            except BlockingIOError:
                return False
            except OSError as error:
                if error.errno == errno.ETOOMANYREFS:  # sockets that others have still to receive
                    return False
                self._end()
                break
            for attached in sockets:
                attached.close()
            if sent < len(data):
                self._waiting[0] = (data[sent:], [])
            else:
                self._waiting.popleft()
        return True

    def receive(self) -> Iterator[tuple[Incoming, list[socket.socket]]]:
        """Yield the messages that have come, with their sockets. Once `has_ended` is set, no more will come.

        The other end may be a process with foreign code, which may write into any of its descriptors: bytes that are no
        message end the connection. A message has fewer sockets than were sent if this process has no descriptor left
        for them.
        """
        while not self.has_ended:
            try:
                data, descriptors, _, _ = socket.recv_fds(self.socket, _MESSAGE_CHUNK, _MOST_SOCKETS)
            except BlockingIOError:
                return
            except OSError:
                data, descriptors = b"", []
            for descriptor in descriptors:
                os.set_inheritable(descriptor, False)
            self._descriptors.extend(descriptors)
            if not data:
                self._end()
                return
            self._received += data
            yield from self._complete()

    def close(self) -> None:
        self._end()
        self.socket.close()

    def _complete(self) -> Iterator[tuple[Incoming, list[socket.socket]]]:
        while len(self._received) >= _MESSAGE_HEAD.size:
            length, count = _MESSAGE_HEAD.unpack_from(self._received)
            end = _MESSAGE_HEAD.size + length
            if length > LONGEST_MESSAGE or count > _MOST_SOCKETS:
                self._garble()
                return
            if len(self._received) < end:
                return
            try:
                message = self._decoder.decode(bytes(self._received[_MESSAGE_HEAD.size : end]))
            except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
                self._garble()
                return
            del self._received[:end]
            # The system keeps back sockets for which this process has no descriptor left.
            there = min(count, len(self._descriptors))
            yield message, [socket.socket(fileno=self._descriptors.popleft()) for _ in range(there)]

    def _garble(self) -> None:
        self.is_garbled = True
        self._end()

    def _end(self) -> None:
        self.has_ended = True
        for _, sockets in self._waiting:
            for attached in sockets:
                attached.close()
        self._waiting.clear()
        while self._descriptors:
            socket.socket(fileno=self._descriptors.popleft()).close()
