"""The run's end of the connection to the ROS 2 helper: a process in the user's ROS Python, and lines of JSON.

After the line of a message with a `size` follow `size` bytes, its `data`.
"""

from __future__ import annotations

import os
import selectors
import socket
import subprocess
import tempfile
import time
from collections import deque
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Generic, TypeVar

import msgspec

from cfgplan_runtime.ros2.ros_python import RosPython

MAIN = Path(__file__).with_name("host") / "main.py"
_END_S = 5.0
"""Seconds that its end may take."""

Incoming = TypeVar("Incoming")


class WithData(msgspec.Struct):
    """A message that is followed by bytes on the socket."""

    size: int = 0
    data: bytes = b""


class HostLink(Generic[Incoming]):
    """A helper, which ends with the thread that made it. Raises OSError if it can't be started.

    Messages are tagged msgspec structs; `incoming` is the union of the helper's messages. Sending never blocks:
    messages wait for `flush` or `hear` until the socket takes them. The helper is the node `name`.
    """

    def __init__(self, python: RosPython, name: str, incoming: object) -> None:
        self.socket, theirs = socket.socketpair()
        number = theirs.fileno()
        self._printed = tempfile.TemporaryFile()  # noqa: SIM115
        try:
            self._process = subprocess.Popen(
                [python.program, str(MAIN), str(number), str(os.getpid()), name],
                pass_fds=[number],
                stdin=subprocess.DEVNULL,
                stdout=self._printed,
                stderr=self._printed,
                env=dict(python.environment),
                start_new_session=True,
            )
        except OSError:
            self.socket.close()
            self._printed.close()
            raise
        finally:
            theirs.close()
        self.socket.setblocking(False)
        self.pid = self._process.pid
        self.has_ended = False
        self.last_words = ""
        """The last line that it has printed, once it is closed."""
        self._decoder: msgspec.json.Decoder[Incoming] = msgspec.json.Decoder(incoming)
        self._received = bytearray()
        self._headed: WithData | None = None
        """The message whose data has not come as a whole yet."""
        self._waiting: deque[memoryview] = deque()

    @property
    def is_waiting(self) -> bool:
        """Whether messages wait to be sent."""
        return bool(self._waiting)

    def send(self, message: msgspec.Struct, data: bytes | bytearray = b"") -> None:
        """Send a message; `data` follows one that has its `size`. Does nothing once the helper has ended."""
        self._waiting.append(memoryview(msgspec.json.encode(message) + b"\n"))
        if data:
            self._waiting.append(memoryview(data))
        self.flush()

    def hear(self) -> Iterator[Incoming]:
        """Yield the helper's messages that have come. Once `has_ended` is set, no more will come."""
        self.flush()
        while not self.has_ended:
            try:
                data = self.socket.recv(1 << 18)
            except BlockingIOError:
                return
            except OSError:
                data = b""
            self.has_ended = not data
            self._received += data
            yield from self._whole()

    def await_words(self, patience_s: float) -> Iterator[Incoming]:
        """Yield its messages until it ends, or `patience_s` is over; for callers that do nothing else."""
        until = time.monotonic() + patience_s
        with selectors.DefaultSelector() as selector:
            selector.register(self.socket, selectors.EVENT_READ)
            while not self.has_ended and time.monotonic() < until:
                selector.select(until - time.monotonic())
                yield from self.hear()

    def close(self) -> int:
        """Let the helper leave the graph, and end it. Returns its exit status."""
        with suppress(OSError):
            self.socket.shutdown(socket.SHUT_RDWR)
        self.has_ended = True
        try:
            self._process.wait(_END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
        self.socket.close()
        self._printed.seek(0)
        lines = self._printed.read().decode(errors="replace").split("\n")
        self.last_words = next((line for line in reversed(lines) if line.strip()), "")
        self._printed.close()
        return self._process.wait()

    def _whole(self) -> list[Incoming]:
        """Take the messages that have come as a whole."""
        found: list[Incoming] = []
        at = 0
        while True:
            if self._headed is None:
                end = self._received.find(b"\n", at)
                if end < 0:
                    break
                message = self._decoder.decode(memoryview(self._received)[at:end])
                at = end + 1
                if not (isinstance(message, WithData) and message.size):
                    found.append(message)
                    continue
                self._headed = message
            size = self._headed.size
            if len(self._received) - at < size:
                break
            data = bytes(memoryview(self._received)[at : at + size])
            found.append(msgspec.structs.replace(self._headed, data=data))  # type: ignore[arg-type]
            self._headed, at = None, at + size
        del self._received[:at]
        return found

    def flush(self) -> None:
        """Send waiting messages, as far as the socket takes them."""
        while self._waiting and not self.has_ended:
            data = self._waiting[0]
            try:
                sent = self.socket.send(data)
            except BlockingIOError:
                return
            except OSError:  # its end is heard as well
                self._waiting.clear()
                return
            if sent < len(data):
                self._waiting[0] = data[sent:]
            else:
                self._waiting.popleft()
