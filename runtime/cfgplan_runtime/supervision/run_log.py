"""A run's log: one JSON line per event. A full disk loses lines, and nothing else."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec

from cfgplan_runtime.supervision.events import Event, UnitStatus


class RunLog:
    """Writes events to a file, whatever becomes of that file. Any thread may write."""

    def __init__(self, path: Path) -> None:
        self.lost = 0
        """How many lines could not be written."""
        self._path = path
        self._file = path.open("ab", buffering=0)
        self._unsaid = 0
        self._lock = threading.Lock()

    def write(self, event: Event) -> None:
        """Add an event; signs of life are left out."""
        if not isinstance(event, UnitStatus):
            self.write_line(type(event).__name__, msgspec.to_builtins(event))

    def write_line(self, event: str, says: Mapping[str, Any]) -> None:
        """Add a line: seconds since 1970 as `time`, the `event`'s name, and what it says, which JSON can say."""
        line = {"time": time.time(), "event": event, **says}
        with self._lock:
            if self._unsaid:
                line["lines_lost_before"] = self._unsaid
            try:
                data = msgspec.json.encode(line) + b"\n"
                written = self._file.write(data)
                if written != len(data):
                    raise OSError(f"{self._path} takes no more")
                self._unsaid = 0
            except (OSError, ValueError):
                self.lost += 1
                self._unsaid += 1

    def close(self) -> None:
        self._file.close()
