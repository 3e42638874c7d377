"""Connections of ROS 1 topics (TCPROS): their headers, and messages, each with its length before it."""

from __future__ import annotations

import socket
import struct
from collections import deque
from collections.abc import Iterator, Mapping
from typing import TypeAlias
from urllib.parse import urlparse

from cfgplan.errors import InputError
from cfgplan.ros.node_api import ANSWER_LIMIT_S, LARGEST_HEADER, SilentError, asked, fields_of_header, header_of, peer
from cfgplan_runtime.streams.channel import MOST_WAITING_BYTES

_LENGTH = struct.Struct("<I")
_READ_BYTES = 1 << 16
_MOST_BYTES_PER_READ = 4 << 20
_LONGEST_MESSAGE = 1 << 30
_SERVICE_CALLER = "/cfgplan"

Header: TypeAlias = Mapping[str, str]
Framed: TypeAlias = bytes | bytearray
"""A message's length, then the message."""
LENGTH_BYTES = _LENGTH.size
"""Bytes of a framed message before the message itself."""


def subscribed(address: str, caller: str, topic: str) -> tuple[socket.socket, Header]:
    """A connection on which the node at `address` sends a topic's messages, with its header.

    Waits for the node. Raises SilentError or OSError.
    """
    try:
        node = peer(address)
    except InputError as error:
        raise SilentError(str(error)) from None
    answer = asked(node, caller, "requestTopic", topic, [["TCPROS"]])
    if not isinstance(answer, list) or len(answer) != 3 or answer[0] != "TCPROS":
        raise SilentError(f"{topic} is not available by TCPROS from {address}")
    end = socket.create_connection((answer[1], answer[2]), ANSWER_LIMIT_S)
    try:
        fields = {"callerid": caller, "topic": topic, "md5sum": "*", "type": "*", "tcp_nodelay": "1"}
        end.sendall(header_of(fields))
        header = read_header(end)
        if "error" in header or "md5sum" not in header or "type" not in header:
            raise SilentError(header.get("error", f"{address} does not say what it sends"))
    except BaseException:
        end.close()
        raise
    return end, header


def answered(master: str, service: str, request: bytes, patience_s: float | None = None) -> bytes:
    """The answer of a service to a request, at most `patience_s` later. Raises SilentError or OSError."""
    with service_end(master, service) as end:
        end.sendall(header_of({"callerid": _SERVICE_CALLER, "service": service, "md5sum": "*"}))
        header = read_header(end)
        if "error" in header:
            raise SilentError(header["error"])
        end.settimeout(patience_s or ANSWER_LIMIT_S)
        end.sendall(_LENGTH.pack(len(request)) + request)
        is_well = _exactly(end, 1) == b"\x01"
        answer = _exactly(end, _LENGTH.unpack(_exactly(end, _LENGTH.size))[0])
    if not is_well:
        raise SilentError(answer.decode(errors="replace"))
    return answer


def service_end(master: str, service: str) -> socket.socket:
    """A connection to the node that offers a service. Raises SilentError or OSError."""
    place = urlparse(str(asked(peer(master), _SERVICE_CALLER, "lookupService", service)))
    return socket.create_connection((place.hostname or "", place.port or 0), ANSWER_LIMIT_S)


def read_header(end: socket.socket) -> Header:
    """Read the header that begins a connection. Waits for it. Raises SilentError or OSError."""
    end.settimeout(ANSWER_LIMIT_S)
    (size,) = _LENGTH.unpack(_exactly(end, _LENGTH.size))
    if size > LARGEST_HEADER:
        raise SilentError("this is not the header of a connection")
    try:
        return dict(fields_of_header(_exactly(end, size)))
    except struct.error:
        raise SilentError("this is not the header of a connection") from None


def _exactly(end: socket.socket, size: int) -> bytes:
    data = b""
    while len(data) < size:
        more = end.recv(size - len(data))
        if not more:
            raise SilentError("the connection has ended")
        data += more
    return data


class MessageReader:
    """A subscriber's end."""

    def __init__(self, end: socket.socket) -> None:
        end.setblocking(False)
        self.socket = end
        self.has_ended = False
        self._chunk = memoryview(bytearray(_READ_BYTES))
        self._pending = b""
        self._large = bytearray()
        """The received part of a message that is longer than a chunk."""
        self._filled = 0

    def read(self) -> Iterator[Framed]:
        """Yield the messages that have come, in order. Once `has_ended` is set, no more will come."""
        budget = _MOST_BYTES_PER_READ
        while budget > 0 and not self.has_ended:
            if self._large:
                got = self._receive(memoryview(self._large)[self._filled :])
                self._filled += got
                if self._filled == len(self._large):
                    whole, self._large = self._large, bytearray()
                    yield whole
            else:
                got = self._receive(self._chunk)
                yield from self._complete(self._pending + self._chunk[:got])
            if got == 0:
                return
            budget -= got

    def _complete(self, data: bytes) -> Iterator[Framed]:
        start = 0
        while len(data) - start >= _LENGTH.size:
            size = _LENGTH.size + _LENGTH.unpack_from(data, start)[0]
            if size > _LONGEST_MESSAGE:
                self.has_ended = True
                return
            if len(data) - start < size:
                if size > _READ_BYTES:
                    self._large, self._filled = bytearray(size), len(data) - start
                    self._large[: self._filled] = data[start:]
                    start = len(data)
                break
            yield data[start : start + size]
            start += size
        self._pending = data[start:]

    def _receive(self, into: memoryview) -> int:
        try:
            got = self.socket.recv_into(into)
        except BlockingIOError:
            return 0
        except OSError:
            got = 0
        self.has_ended = got == 0
        return got


class MessageWriter:
    """A publisher's end. Messages wait until the socket takes them; beyond `queue` messages, the oldest are dropped."""

    def __init__(self, end: socket.socket, queue: int) -> None:
        end.setblocking(False)
        self.socket = end
        self.has_ended = False
        self.dropped = 0
        self._queue = queue
        self._waiting: deque[Framed] = deque()
        self._bytes = 0
        self._rest: memoryview | None = None

    @property
    def is_waiting(self) -> bool:
        """Whether messages wait for `flush`."""
        return self._rest is not None and not self.has_ended

    def offer(self, message: Framed) -> None:
        """Send a message."""
        self._waiting.append(message)
        self._bytes += len(message)
        if self._rest is None:
            self.flush()
        while len(self._waiting) > 1 and (len(self._waiting) > self._queue or self._bytes > MOST_WAITING_BYTES):
            self._bytes -= len(self._waiting.popleft())
            self.dropped += 1

    def flush(self) -> None:
        """Send waiting messages, as far as the socket takes them."""
        while not self.has_ended and (self._rest is not None or self._waiting):
            if self._rest is None:
                message = self._waiting.popleft()
                self._bytes -= len(message)
                self._rest = memoryview(message)
            try:
                sent = self.socket.send(self._rest)
            except BlockingIOError:
                return
            except OSError:
                self.has_ended = True
                return
            self._rest = self._rest[sent:] if sent < len(self._rest) else None
