"""Recordings: the elements of the targets' topics, every event and every review, in an MCAP file; and the recorder that
writes it.

Reference: the MCAP specification, https://mcap.dev/spec.
"""

from __future__ import annotations

import os
import queue
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path

import msgspec

from cfgplan.errors import InputError
from cfgplan.extras import needed
from cfgplan_runtime.lifecycle.kinds import level, sentence
from cfgplan_runtime.lifecycle.reports import Observed, Report, Reviewed
from cfgplan_runtime.operating.forms import events_form, known, reviews_form, unit_record, units_form
from cfgplan_runtime.operating.messages import Message, log_message, messages, record_message
from cfgplan_runtime.operating.records import plain, report_record, review_record
from cfgplan_runtime.streams.element import Element
from cfgplan_runtime.streams.payload import decode

MOST_SCHEMAS = 8
"""The most schemas of a topic; elements of yet another form get the schema of any object."""
_CHUNK_BYTES = 1 << 20
_LAST_RECORDS = 16
REVIEWS, EVENTS, UNITS, LOG = "/cfgplan/reviews", "/cfgplan/events", "/cfgplan/units", "/cfgplan/log"
MOST_WAITING_REPORTS = 10_000
FLUSH_S = 5.0
"""A crash of this process loses at most the last FLUSH_S seconds."""
CLOSE_S = 10.0


class Recording:
    """An MCAP file that is being written; all methods may be called from any thread.

    If the disk is full or fails, the recording ends there as a valid file, `failure` says why, and `lost` counts the
    messages after that. Nothing is raised.
    """

    def __init__(self, path: Path) -> None:
        """Raise InputError if the file exists, or can't be made."""
        needed("recordings", "mcap")
        from mcap.writer import Writer

        try:
            self._output = _Output(path)
        except FileExistsError:
            mend = "name another, or remove it"
            raise InputError.of("the file exists already", file=str(path), mend=mend) from None
        except OSError as error:
            raise InputError.unwritable(error, str(path)) from None
        self.path = path
        self.written = 0
        self.lost = 0
        self.failure: str | None = None
        self._waiting = 0
        self._lock = threading.Lock()
        self._is_closed = False
        self._channels: dict[tuple[str, bytes], int] = {}
        self._forms: dict[str, int] = {}
        self._writer = Writer(self._output, chunk_size=_CHUNK_BYTES)  # type: ignore[arg-type]
        self._do(lambda: self._writer.start(profile="", library="cfgplan"))

    def describe(self, facts: Mapping[str, str]) -> None:
        """Write facts about the recording, as the file's metadata `cfgplan`."""
        with self._lock:
            if not self._is_closed and self.failure is None:
                self._do(lambda: self._writer.add_metadata("cfgplan", dict(facts)))

    def attach(self, name: str, text: str) -> None:
        """Attach a text as a file."""
        with self._lock:
            if not self._is_closed and self.failure is None:
                now_ns = time.time_ns()
                self._do(lambda: self._writer.add_attachment(now_ns, now_ns, name, "text/plain", text.encode()))

    def write(self, message: Message, time_ns: int) -> None:
        """Record a message that was made at `time_ns` since the epoch."""
        data = msgspec.json.encode(message.body)
        with self._lock:
            if self._is_closed or self.failure is not None:
                self.lost += 1
                return
            before = self._output.tell()
            self._waiting += 1
            self._do(lambda: self._add(message, data, time_ns))
            if self._output.tell() != before:
                self._reach_disk()

    def flush(self) -> None:
        """Bring everything written so far to the disk, so that a crash does not lose it."""
        with self._lock:
            if not self._is_closed and self.failure is None:
                self._do(self._writer.flush)
                self._reach_disk()

    def close(self) -> None:
        """Finish the file. Does nothing the second time."""
        with self._lock:
            if self._is_closed:
                return
            if self.failure is None:
                self._do(self._writer.finish)
                self._reach_disk()
            self._is_closed = True
            self._output.close()

    def _add(self, message: Message, data: bytes, time_ns: int) -> None:
        stamp = max(0, time_ns)
        self._writer.add_message(self._channel(message), log_time=stamp, publish_time=stamp, data=data)

    def _channel(self, message: Message) -> int:
        name, schema = message.schema_name, msgspec.json.encode(message.schema)
        channel = self._channels.get((message.topic, schema))
        if channel is not None:
            return channel
        forms = self._forms.get(message.topic, 0)
        if forms >= MOST_SCHEMAS:
            schema = b'{"type":"object"}'
        if (message.topic, schema) not in self._channels:
            self._forms[message.topic] = forms + 1
            schema_id = self._writer.register_schema(name, "jsonschema", schema)
            self._channels[message.topic, schema] = self._writer.register_channel(message.topic, "json", schema_id)
        return self._channels[message.topic, schema]

    def _reach_disk(self) -> None:
        """Count the messages that waited in memory as written."""
        self.written += self._waiting
        self._waiting = 0

    def _do(self, work: Callable[[], object]) -> None:
        try:
            work()
        except OSError as error:
            self.failure = error.strerror or str(error)
            self.lost += self._waiting
            self._waiting = 0
            self._output.end_early()


class _Output:
    """A file of records that can be cut after any of the last _LAST_RECORDS."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("xb", buffering=0)
        self._ends: deque[int] = deque(maxlen=_LAST_RECORDS)

    def write(self, data: bytes) -> int:
        rest = memoryview(data)
        while rest:
            rest = rest[self._file.write(rest) :]
        self._ends.append(self._file.tell())
        return len(data)

    def tell(self) -> int:
        return self._file.tell()

    def flush(self) -> None:
        os.fsync(self._file.fileno())

    def end_early(self) -> None:
        """Cut the file after the last record behind which its end still has room on the disk. It then has no index."""
        from mcap.data_stream import RecordBuilder
        from mcap.records import DataEnd, Footer
        from mcap.writer import MCAP0_MAGIC

        end = RecordBuilder()
        DataEnd(0).write(end)
        Footer(summary_start=0, summary_offset_start=0, summary_crc=0).write(end)
        tail: bytes = end.end() + MCAP0_MAGIC  # type: ignore[no-untyped-call]
        while self._ends:
            with suppress(OSError):
                where = self._ends.pop()
                self._file.truncate(where)
                self._file.seek(where)
                if self._file.write(tail) == len(tail):
                    return

    def close(self) -> None:
        with suppress(OSError):
            self._file.close()


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
