"""Fills a recording: elements at once, reports through a queue; flushes it every few seconds."""

from __future__ import annotations

import queue
import threading
import time
from pathlib import Path

from cfgplan_runtime.lifecycle.reports import Observed, Report, Reviewed
from cfgplan_runtime.operating.forms import events_form, known, reviews_form, unit_record, units_form
from cfgplan_runtime.operating.messages import Message, log_message, messages, record_message
from cfgplan_runtime.operating.recording import Recording
from cfgplan_runtime.operating.records import plain, report_record, review_record
from cfgplan_runtime.operating.sentences import level, sentence
from cfgplan_runtime.streams.element import Element
from cfgplan_runtime.streams.payload import decode

REVIEWS, EVENTS, UNITS, LOG = "/cfgplan/reviews", "/cfgplan/events", "/cfgplan/units", "/cfgplan/log"
MOST_WAITING_REPORTS = 10_000
FLUSH_S = 5.0
"""A crash of this process loses at most the last FLUSH_S seconds."""
CLOSE_S = 10.0


class Recorder:
    """Records a run until `close`. Raises InputError for a file that can't be made.

    `element` is called from the threads of the topics, and may take as long as the disk does; `report` returns at once.
    """

    def __init__(self, path: Path) -> None:
        self.recording = Recording(path)
        self.lost_reports = 0
        self._reports: queue.Queue[tuple[int, Report] | None] = queue.Queue(MOST_WAITING_REPORTS)
        self._thread = threading.Thread(target=self._work, name="cfgplan-recorder", daemon=True)
        self._thread.start()

    def element(self, topic: str, element: Element) -> None:
        """Record an element of a target's topic."""
        for message in messages(topic, decode(element.payload), element.time_ns):
            self.recording.write(message, element.time_ns)

    def report(self, report: Report) -> None:
        """Record something that happened, as soon as the disk takes it."""
        try:
            self._reports.put_nowait((time.time_ns(), report))
        except queue.Full:
            self.lost_reports += 1

    @property
    def lost(self) -> int:
        """How many messages were not recorded because the disk was too slow or full."""
        return self.lost_reports + self.recording.lost

    def close(self) -> bool:
        """Record what still waits and finish the file. Returns False, with the file unfinished, if the disk hangs."""
        deadline = time.monotonic() + CLOSE_S
        while True:
            try:
                self._reports.put(None, timeout=max(0.0, deadline - time.monotonic()))
                break
            except queue.Full:
                return False
        self._thread.join(max(0.0, deadline - time.monotonic()))
        return not self._thread.is_alive()

    def _work(self) -> None:
        flushed_s = time.monotonic()
        while True:
            try:
                waiting = self._reports.get(timeout=max(0.0, flushed_s + FLUSH_S - time.monotonic()))
            except queue.Empty:
                self.recording.flush()
                flushed_s = time.monotonic()
                continue
            if waiting is None:
                break
            time_ns, report = waiting
            for message in _messages(report, time_ns):
                self.recording.write(message, time_ns)
        self.recording.close()


def _messages(report: Report, time_ns: int) -> list[Message]:
    match report:
        case Reviewed(review):
            told = record_message(REVIEWS, known(review_record(review)), reviews_form())
        case Observed(observations):
            units = [known(unit_record(plain(seen))) for seen in observations]
            return [record_message(UNITS, {"units": units}, units_form())]
        case _:
            told = record_message(EVENTS, known(report_record(report)), events_form())
    said = sentence(report)
    return [told] if said is None else [told, log_message(LOG, level(report), "cfgplan", said, time_ns)]
