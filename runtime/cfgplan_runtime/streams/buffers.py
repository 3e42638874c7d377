"""Memory for large payloads, used again once nobody looks at it: fresh pages cost more than the copy of an image."""

from __future__ import annotations

from collections import deque

_MOST_KEPT = 32


class Buffers:
    """Buffers of one subscription; what is handed out is free again when every view of it is gone."""

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
    """A bytearray can't be resized while a view of it exists."""
    try:
        buffer.append(0)
        buffer.pop()
    except BufferError:
        return False
    return True
