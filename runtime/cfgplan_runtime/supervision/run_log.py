"""A run's log: one JSON line per event. A full disk loses lines, and nothing else."""

from __future__ import annotations

import time
from pathlib import Path

import msgspec

from cfgplan_runtime.supervision.events import Event, UnitStatus


class RunLog:
    """Writes events to a file, whatever becomes of that file."""

    def __init__(self, path: Path) -> None:
        self.lost = 0
        """How many lines could not be written."""
        self._path = path
        self._file = path.open("ab", buffering=0)
        self._unsaid = 0

    def write(self, event: Event) -> None:
        """Add an event; signs of life are left out."""
        if isinstance(event, UnitStatus):
            return
        line = {"time": time.time(), "event": type(event).__name__, **msgspec.to_builtins(event)}
        if self._unsaid:
            line["lines_lost_before"] = self._unsaid
        try:
            data = msgspec.json.encode(line) + b"\n"
            written = self._file.write(data)
            if written != len(data):
                raise OSError(f"{self._path} takes no more")
            self._unsaid = 0
        except OSError:
            self.lost += 1
            self._unsaid += 1

    def close(self) -> None:
        self._file.close()
