"""The content of files that users name, pipes among them."""

from __future__ import annotations

import errno
import os
import stat
import time
from pathlib import Path

WRITER_WAIT_S = 5.0
"""How long a pipe may lack a program that writes to it."""
_LOOK_S = 0.02
_FIRST_BYTES = 1 << 16


class NoWriterError(OSError):
    """A pipe to which no program writes."""

    def __init__(self) -> None:
        super().__init__(errno.ENODATA, "it is a pipe, and no program writes to it")


def content_of(path: Path, most: int = -1) -> bytes:
    """Return the content of a file, at most `most` bytes if that is not negative.

    Raises OSError (NoWriterError for a pipe to which no program writes within WRITER_WAIT_S), and ValueError for an
    impossible path. A program that has opened the pipe may take any time.
    """
    with open(path, "rb", opener=_opened_at_once) as stream:
        descriptor = stream.fileno()
        first = _first_of_pipe(descriptor) if stat.S_ISFIFO(os.fstat(descriptor).st_mode) else b""
        os.set_blocking(descriptor, True)
        return first + stream.read(most if most < 0 else max(0, most - len(first)))


def _opened_at_once(path: str, flags: int) -> int:
    """Open a file; a pipe too, though no program writes to it."""
    return os.open(path, flags | os.O_NONBLOCK)


def _first_of_pipe(descriptor: int) -> bytes:
    """Wait until a program writes to a pipe; return the first bytes, which may still be none."""
    end = time.monotonic() + WRITER_WAIT_S
    while True:
        try:
            first = os.read(descriptor, _FIRST_BYTES)
        except BlockingIOError:  # a program has opened the pipe, and has written nothing yet
            return b""
        if first:
            return first
        if time.monotonic() >= end:
            raise NoWriterError
        time.sleep(_LOOK_S)
