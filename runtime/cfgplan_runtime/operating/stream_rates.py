"""How often each output of a unit gives an element, and how long ago it gave the last, as units count."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterable

from cfgplan.domain import Stream
from cfgplan_runtime.lifecycle.reports import Observed, Report, TargetView
from cfgplan_runtime.operating.flows import Flows
from cfgplan_runtime.operating.protocol import Record

RATE_OVER_S, LONGEST_S, ENOUGH = 10.0, 120.0, 3
"""Rates are over the last 10 s, or over as long as it takes for three elements, at most 120 s."""


class StreamRates:
    """Learns from the observations of a manager. Thread-safe."""

    def __init__(self, now_s: Callable[[], float] = time.monotonic) -> None:
        self._now_s = now_s
        self._lock = threading.Lock()
        self._counts: dict[Stream, deque[tuple[float, int]]] = {}
        """For each output of a unit that is observed: when so many elements were counted."""
        self._given_s: dict[Stream, float] = {}
        """When the count of each rose last."""

    def hear(self, report: Report) -> None:
        """Listen to a manager: take in the counts, if the report has some."""
        if not isinstance(report, Observed):
            return
        now_s = self._now_s()
        counts = {
            Stream(seen.unit, port): one.elements for seen in report.observations for port, one in seen.outputs.items()
        }
        with self._lock:
            for gone in self._counts.keys() - counts.keys():
                del self._counts[gone]
                self._given_s.pop(gone, None)
            for stream, elements in counts.items():
                known = self._counts.setdefault(stream, deque())
                if known and elements < known[-1][1]:  # a new unit of the same id counts from 0
                    known.clear()
                if elements > (known[-1][1] if known else 0):
                    self._given_s[stream] = now_s
                known.append((now_s, elements))
                while len(known) > 2 and (
                    now_s - known[0][0] > LONGEST_S
                    or (now_s - known[1][0] >= RATE_OVER_S and elements - known[1][1] >= ENOUGH)
                ):
                    known.popleft()

    def records(self) -> list[Record]:
        """For each output its `stream`, how many `elements` it has given, `rate_hz` (None where it was observed only
        once), and `silent_s` since its last element (None if it gave none).
        """
        now_s = self._now_s()
        with self._lock:
            return [self._record(stream, now_s) for stream in sorted(self._counts)]

    def of_topics(self, flows: Flows, targets: Iterable[TargetView]) -> dict[str, Record]:
        """The flow of each topic, as `Flows.records` gives it. Where nothing has come in the few seconds over which
        topics are measured, the rate is that of the target's stream: 0 only if that has stopped.
        """
        slow_hz = {one["stream"]: one["rate_hz"] for one in self.records()}
        records = flows.records()
        for target in targets:
            record = records.get(target.topic)
            if record is not None and not record["rate_hz"] and target.stream is not None:
                record["rate_hz"] = slow_hz.get(str(target.stream)) or 0.0
        return records

    def _record(self, stream: Stream, now_s: float) -> Record:
        known, given_s = self._counts[stream], self._given_s.get(stream)
        (first_s, first), (last_s, elements) = known[0], known[-1]
        return {
            "stream": str(stream),
            "elements": elements,
            "rate_hz": round((elements - first) / (last_s - first_s), 3) if last_s > first_s else None,
            "silent_s": None if given_s is None else round(now_s - given_s, 3),
        }
