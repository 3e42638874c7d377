"""The last lines that each unit has printed, for `cfgplan ctl logs`."""

from __future__ import annotations

import re
import threading
import time
from collections import OrderedDict, deque
from collections.abc import Callable
from dataclasses import dataclass

from cfgplan_runtime.lifecycle.kinds import Shown, details, kind_of
from cfgplan_runtime.lifecycle.reports import Report, UnitEvent
from cfgplan_runtime.operating.protocol import Record
from cfgplan_runtime.supervision.events import UnitPrinted

LINES_KEPT = 1000
"""The last lines of each unit that are kept."""
UNITS_KEPT = 300
MOST_CHARACTERS = 1 << 24
"""Units, and characters of all their lines, that are kept. Beyond that the unit that was silent for longest goes."""
_LONGEST_KEPT = 4096


@dataclass(frozen=True, slots=True)
class PrintedLine:
    """A line of a unit; `number` counts the lines of all units, `time_s` is in seconds since 1970 (UTC)."""

    number: int
    time_s: float
    unit: str
    line: str

    def record(self) -> Record:
        return {"number": self.number, "time_s": round(self.time_s, 3), "unit": self.unit, "line": self.line}


class Printed:
    """Keeps the last lines of each unit, also of units that have ended, and how those that died did. Thread-safe."""

    def __init__(self, now_s: Callable[[], float] = time.time) -> None:
        self._now_s = now_s
        self._lock = threading.Lock()
        self._of: OrderedDict[str, deque[PrintedLine]] = OrderedDict()
        self._number = self._characters = 0

    def hear(self, report: Report) -> None:
        """Listen to a manager: keep the line, if the report is of one."""
        match report:
            case UnitEvent(UnitPrinted(unit, line)):
                self._keep(unit, line)
            case UnitEvent(event) if Shown.AS_LINE in kind_of(event).shown:
                said, unit = f"cfgplan: {kind_of(event).says(event)}", getattr(event, "unit", "")
                for line in (said, *(details(report) or "").splitlines()):
                    self._keep(unit, line)

    def lines(self, name: str, after: int = 0) -> list[PrintedLine]:
        """The lines after number `after` of the unit with this id, or of all units of the transformation with this
        label (`camera` has `camera.1`, `camera.2`, ...), in the order in which they came.
        """
        of_label = re.compile(re.escape(name) + r"(\.\d+)?")
        with self._lock:
            kept = [one for unit, lines in self._of.items() if of_label.fullmatch(unit) for one in lines]
        return sorted((one for one in kept if one.number > after), key=lambda one: one.number)

    def _keep(self, unit: str, line: str) -> None:
        with self._lock:
            self._number += 1
            lines = self._of.setdefault(unit, deque())
            lines.append(PrintedLine(self._number, self._now_s(), unit, line[:_LONGEST_KEPT]))
            self._characters += len(lines[-1].line)
            if len(lines) > LINES_KEPT:
                self._characters -= len(lines.popleft().line)
            self._of.move_to_end(unit)
            while len(self._of) > UNITS_KEPT or self._characters > MOST_CHARACTERS:
                _, forgotten = self._of.popitem(last=False)
                self._characters -= sum(len(one.line) for one in forgotten)
