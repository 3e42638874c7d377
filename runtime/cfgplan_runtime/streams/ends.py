"""The events that a thread waits for: connections that can be read or written, and calls from other threads."""

from __future__ import annotations

import selectors
import socket
from collections import deque
from collections.abc import Callable
from contextlib import suppress


class Ends:
    """Sockets, or other descriptors, each with the function to call when it is ready."""

    def __init__(self) -> None:
        self._selector = selectors.DefaultSelector()
        self._calls: dict[object, Callable[[], object]] = {}

    def watch(self, end: socket.socket | int, call: Callable[[], object], *, to_write: bool = False) -> None:
        """Call `call` whenever `end` can be read, or written. An end that is watched already keeps its call."""
        if end in self._calls:
            return
        self._selector.register(end, selectors.EVENT_WRITE if to_write else selectors.EVENT_READ)
        self._calls[end] = call

    def write(self, end: socket.socket, *, is_waiting: bool) -> None:
        """Call also when `end` can be written, while data `is_waiting` to be written."""
        events = selectors.EVENT_READ | (selectors.EVENT_WRITE if is_waiting else 0)
        if end in self._calls and self._selector.get_key(end).events != events:
            self._selector.modify(end, events)

    def unwatch(self, end: socket.socket | int) -> None:
        """Stop watching an end, before it is closed. An unknown end is ignored."""
        if self._calls.pop(end, None) is not None:
            self._selector.unregister(end)

    def wait(self, timeout_s: float | None) -> None:
        """Wait at most `timeout_s` seconds until an end is ready, then make the call of each ready end."""
        for key, _ in self._selector.select(timeout_s):
            call = self._calls.get(key.fileobj)
            if call is not None:  # another one's call may have closed the end
                call()

    def close(self) -> None:
        self._selector.close()


class Waker:
    """Lets any thread wake the thread that waits for `socket`."""

    def __init__(self) -> None:
        self.socket, self._rope = socket.socketpair()
        for end in (self.socket, self._rope):
            end.setblocking(False)

    def wake(self) -> None:
        """Wake the waiting thread. Thread-safe."""
        with suppress(OSError):  # it is set already, or closed
            self._rope.send(b"!")

    def hear(self) -> None:
        """Reset, so that the thread waits again."""
        with suppress(BlockingIOError):
            self.socket.recv(4096)

    def close(self) -> None:
        self.socket.close()
        self._rope.close()


class Posted:
    """Calls that any thread posts to the thread that waits at `ends`."""

    def __init__(self, ends: Ends) -> None:
        self._calls: deque[Callable[[], object]] = deque()
        self._waker = Waker()
        ends.watch(self._waker.socket, self._waker.hear)

    def __bool__(self) -> bool:
        return bool(self._calls)

    def post(self, call: Callable[[], object]) -> None:
        """Post a call, and wake the waiting thread. Thread-safe."""
        self._calls.append(call)
        self.wake()

    def wake(self) -> None:
        self._waker.wake()

    def do(self) -> None:
        """Make all posted calls, in order."""
        while self._calls:
            self._calls.popleft()()

    def close(self) -> None:
        self._waker.close()
