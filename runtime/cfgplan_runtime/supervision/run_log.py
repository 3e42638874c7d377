"""A run's log: one JSON line per event. A full disk loses lines, and nothing else."""

from __future__ import annotations

import errno
import os
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec

from cfgplan_runtime.supervision.events import SIGNS, Event


class RunLog:
    """Writes events to a file; a failed write is counted, not raised. Any thread may write."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.written = 0
        self.lost = 0
        """How many lines could not be written."""
        self.failure: str | None = None
        """Why the first lost line could not be written."""
        self._file = path.open("ab", buffering=0)
        self._unsaid = 0
        self._is_cut = False
        self._lock = threading.Lock()

    def write(self, event: Event) -> None:
        """Add an event; signs of life are left out."""
        if not isinstance(event, SIGNS):
            self.write_line(type(event).__name__, msgspec.to_builtins(event))

    def write_line(self, event: str, says: Mapping[str, Any]) -> None:
        """Add a line: seconds since 1970 as `time`, the `event`'s name, and the entries of `says`, plain data."""
        line = {"time": time.time(), "event": event, **says}
        with self._lock:
            if self._unsaid:
                line["lines_lost_before"] = self._unsaid
            try:
                self._append(msgspec.json.encode(line) + b"\n")
                self.written += 1
                self._unsaid = 0
            except (OSError, ValueError) as error:
                self.failure = self.failure or getattr(error, "strerror", None) or str(error)
                self.lost += 1
                self._unsaid += 1

    def _append(self, line: bytes) -> None:
        """Write a whole line, after a line break if the last one was cut short. Raises OSError if it is too."""
        data = b"\n" + line if self._is_cut else line
        written = self._file.write(data)
        self._is_cut = not data[:written].endswith(b"\n")
        if written != len(data):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def close(self) -> None:
        self._file.close()
