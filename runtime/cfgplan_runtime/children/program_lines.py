"""A program's standard output, line by line."""

from __future__ import annotations

import os
from collections import deque

LONGEST_LINE = 1 << 26
"""Bytes of a line."""
_SHOWN = 200
"""Bytes of a wrong line that are told."""
PIPE_BYTES = 1 << 20
"""The most that the system allows a pipe of most users to hold."""


class Line:
    """A line of a program's output; of one that is too large only the beginning is kept."""

    def __init__(self, text: bytes, *, is_too_large: bool) -> None:
        self.text = text
        self.is_too_large = is_too_large

    @property
    def shown(self) -> str:
        text = self.text[:_SHOWN].decode(errors="backslashreplace")
        return f"{text}..." if len(self.text) > _SHOWN or self.is_too_large else text


class Lines:
    """A program's output, line by line."""

    def __init__(self) -> None:
        self.complete: deque[Line] = deque()
        self.has_ended = False
        self._rest = bytearray()
        self._is_too_large = False

    def read(self, end: int) -> bool:
        """Read some of the available output. Returns whether something was, or the end."""
        if self.has_ended:
            return True
        try:
            data = os.read(end, PIPE_BYTES)
        except BlockingIOError:
            return False
        first, *others = data.split(b"\n")
        self._add(first)
        for each in others:
            self._complete()
            self._add(each)
        if not data:
            self.has_ended = True
            self._complete()
        return True

    def _add(self, piece: bytes) -> None:
        self._rest += piece
        if len(self._rest) > LONGEST_LINE or self._is_too_large:
            self._is_too_large = True
            del self._rest[_SHOWN:]

    def _complete(self) -> None:
        if self._rest.strip():
            self.complete.append(Line(bytes(self._rest), is_too_large=self._is_too_large))
        self._rest, self._is_too_large = bytearray(), False
