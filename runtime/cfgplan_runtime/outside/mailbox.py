"""Messages that wait until they are taken."""

from __future__ import annotations

import threading
from collections import deque
from typing import Generic, TypeVar

Letter = TypeVar("Letter")


class Mailbox(Generic[Letter]):
    """Messages that wait. If there are too many the oldest is dropped. Thread-safe."""

    def __init__(self, depth: int) -> None:
        self.dropped = 0
        self._depth = depth
        self._waiting: deque[Letter] = deque()
        self._changed = threading.Condition()

    def put(self, letter: Letter) -> None:
        with self._changed:
            if len(self._waiting) == self._depth:
                self._waiting.popleft()
                self.dropped += 1
            self._waiting.append(letter)
            self._changed.notify()

    def take(self, timeout_s: float) -> Letter | None:
        """The oldest message; None if none comes in time."""
        with self._changed:
            self._changed.wait_for(lambda: bool(self._waiting), timeout_s)
            return self._waiting.popleft() if self._waiting else None
