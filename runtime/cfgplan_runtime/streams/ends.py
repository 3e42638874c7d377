"""What a thread waits for: ends of connections that can be read or written, and calls that other threads hand to it."""

from __future__ import annotations

import selectors
import socket
from collections import deque
from collections.abc import Callable
from contextlib import suppress


class Ends:
    """Sockets, or other descriptors, each with the call that its readiness causes."""

    def __init__(self) -> None:
        self._selector = selectors.DefaultSelector()
        self._calls: dict[object, Callable[[], object]] = {}

    def watch(self, end: socket.socket | int, call: Callable[[], object], *, to_write: bool = False) -> None:
        """Call whenever `end` can be read, or written, if it is not watched already."""
        if end in self._calls:
            return
        self._selector.register(end, selectors.EVENT_WRITE if to_write else selectors.EVENT_READ)
        self._calls[end] = call

    def write(self, end: socket.socket, *, is_waiting: bool) -> None:
        """Call also when `end` can be written, as long as something `is_waiting` for that."""
        events = selectors.EVENT_READ | (selectors.EVENT_WRITE if is_waiting else 0)
        if end in self._calls and self._selector.get_key(end).events != events:
            self._selector.modify(end, events)

    def unwatch(self, end: socket.socket | int) -> None:
        """Forget an end, if it is known, before it is closed."""
        if self._calls.pop(end, None) is not None:
            self._selector.unregister(end)

    def wait(self, timeout_s: float | None) -> None:
        """Wait at most `timeout_s` until an end is ready, then do what is to be done at each that is."""
        for key, _ in self._selector.select(timeout_s):
            call = self._calls.get(key.fileobj)
            if call is not None:  # another one's call may have closed the end
                call()

    def close(self) -> None:
        self._selector.close()


class Bell:
    """Lets any thread wake the one that waits for `socket`."""

    def __init__(self) -> None:
        self.socket, self._rope = socket.socketpair()
        for end in (self.socket, self._rope):
            end.setblocking(False)

    def ring(self) -> None:
        """Wake it; for any thread."""
        with suppress(OSError):  # it rings already, or is closed
            self._rope.send(b"!")

    def hear(self) -> None:
        """Have it wait again."""
        with suppress(BlockingIOError):
            self.socket.recv(4096)

    def close(self) -> None:
        self.socket.close()
        self._rope.close()


class Posted:
    """Calls that any thread hands to the one that waits at `ends`."""

    def __init__(self, ends: Ends) -> None:
        self._calls: deque[Callable[[], object]] = deque()
        self._bell = Bell()
        ends.watch(self._bell.socket, self._bell.hear)

    def __bool__(self) -> bool:
        return bool(self._calls)

    def post(self, call: Callable[[], object]) -> None:
        """Hand on a call, and wake who waits; for any thread."""
        self._calls.append(call)
        self.wake()

    def wake(self) -> None:
        self._bell.ring()

    def do(self) -> None:
        """Do all that was handed on, in order."""
        while self._calls:
            self._calls.popleft()()

    def close(self) -> None:
        self._bell.close()
