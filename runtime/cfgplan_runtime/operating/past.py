"""The last events of a run, for `cfgplan ctl events --last` and `--since`."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable

import msgspec

from cfgplan_runtime.lifecycle.kinds import Shown, Urgency, kind_of, level, sentence, subject
from cfgplan_runtime.lifecycle.reports import Report
from cfgplan_runtime.operating.protocol import Record
from cfgplan_runtime.operating.records import report_record

EVENTS_KEPT = 1000
MOST_BYTES = 8 << 20
"""Events, and bytes of all of them as JSON, that are kept. Beyond that the oldest go."""


class Past:
    """Keeps the last events of a run as records. Thread-safe.

    Signs, such as the observations of each second, are no events. Lines that units print are, but `Printed` keeps them.
    """

    def __init__(self, now_s: Callable[[], float] = time.time) -> None:
        self._now_s = now_s
        self._lock = threading.Lock()
        self._kept: deque[tuple[float, bytes]] = deque()
        """The time and JSON of each event."""
        self._number = self._bytes = 0

    def take(self, report: Report) -> Record | None:
        """The record of a report, with its level, number, time in seconds since 1970 and sentence, which is kept.

        None for signs.
        """
        row = kind_of(subject(report))
        if row.urgency is Urgency.SIGN:
            return None
        with self._lock:
            self._number += 1
            record = {
                **report_record(report),
                "says": sentence(report),
                "level": level(report).name.lower(),
                "number": self._number,
                "time_s": round(self._now_s(), 3),
            }
            if Shown.LATER in row.shown:
                self._keep(record)
        return record

    def events(self, last: int | None = None, since_s: float | None = None) -> list[Record]:
        """The kept events that have happened within the last `since_s` seconds, of these the `last` ones."""
        with self._lock:
            kept = list(self._kept)
        earliest_s = 0.0 if since_s is None else self._now_s() - since_s
        told = [data for time_s, data in kept if time_s >= earliest_s]
        return [msgspec.json.decode(data) for data in (told if last is None else told[max(0, len(told) - last) :])]

    def _keep(self, record: Record) -> None:
        data = msgspec.json.encode(record)
        self._kept.append((record["time_s"], data))
        self._bytes += len(data)
        while len(self._kept) > EVENTS_KEPT or (self._bytes > MOST_BYTES and len(self._kept) > 1):
            self._bytes -= len(self._kept.popleft()[1])
