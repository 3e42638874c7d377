"""The output of `cfgplan run` without a live view: lines of text, or JSON lines."""

from __future__ import annotations

import queue
from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, Self

from cfgplan.amounts import core_share, span
from cfgplan.cli.screen import Screen, counted, json_line, printable

if TYPE_CHECKING:
    from cfgplan_runtime.operating.operation import News, Operation


class RunOutput(ABC):
    """Shows a run; entered as long as the run lasts."""

    def __init__(self, screen: Screen, operation: Operation) -> None:
        self._screen = screen
        self._operation = operation

    @abstractmethod
    def __enter__(self) -> Self: ...

    def __exit__(self, *_: object) -> None:  # noqa: B027 - what is shown stays
        pass

    @abstractmethod
    def update(self, wait_s: float) -> None:
        """Show the waiting events and reports; wait at most `wait_s` seconds for the first."""

    def note(self, text: str) -> None:
        """Show a message about the work."""
        self._screen.note(text)

    @abstractmethod
    def sum_up(self) -> None:
        """Print the summary, after the end."""


def running_text(operation: Operation) -> str:
    """The running units, and how to steer them."""
    count = counted(len(operation.runtime.environment.units), "unit")
    metrics = "" if operation.metrics_port is None else f" Metrics: http://127.0.0.1:{operation.metrics_port}/metrics."
    return f"Running {count} as run {operation.id}; Ctrl-C stops, `cfgplan ctl` steers.{metrics}"


class Lines(RunOutput):
    """A line for each thing that happens."""

    def __init__(self, screen: Screen, operation: Operation) -> None:
        super().__init__(screen, operation)
        self._told: set[str] = set()

    def __enter__(self) -> Self:
        self._screen.tell(running_text(self._operation))
        return self

    def update(self, wait_s: float) -> None:
        from cfgplan_runtime.lifecycle.kinds import details, sentence

        for news in fetched(self._operation, wait_s):
            if isinstance(news, str):
                self._screen.warn(news)
                continue
            said, where = sentence(news), details(news)
            if said is not None:
                self._screen.tell(printable(said))
            if where is not None and where not in self._told:
                # A fault of each step says its place only once.
                self._told.add(where)
                for line in where.splitlines():
                    self._screen.tell(printable(line))

    def sum_up(self) -> None:
        for news in fetched(self._operation, 0.0):
            if isinstance(news, str):
                self._screen.warn(news)
        show_ledger(self._operation, self._screen)
        show_files(self._operation, self._screen)


class JsonLines(RunOutput):
    """A JSON object for each thing that happens, and one for each unit at the end."""

    def __enter__(self) -> Self:
        operation = self._operation
        units = len(operation.runtime.environment.units)
        self._say("Running", run=operation.id, units=units, metrics_port=operation.metrics_port)
        return self

    def update(self, wait_s: float) -> None:
        from cfgplan_runtime.operating.records import report_record

        for news in fetched(self._operation, wait_s):
            if isinstance(news, str):
                self._say("Warning", text=news)
            else:
                record = report_record(news)
                self._say(record.pop("kind"), **record)

    def sum_up(self) -> None:
        self.update(0.0)
        for entry in self._operation.ledger.entries():
            seen = entry.seen
            facts = {"unit": seen.unit, "labor_us": seen.labor_us, "upkeep_us": entry.upkeep_us, "steps": seen.steps}
            more = {"memory_bytes": seen.memory_bytes, "dropped": seen.dropped, "errors": seen.errors}
            self._say("Observed", **facts, **more)
        log, recorder = self._operation.log, self._operation.recorder
        if log is not None:
            self._say("Logged", file=str(log.path), failure=log.failure, written=log.written, lost=log.lost)
        if recorder is not None:
            recording = recorder.recording
            counts = {"written": recording.written, "lost": recorder.lost, "dropped": self._operation.dropped}
            self._say("Recorded", file=str(recording.path), failure=recording.failure, **counts)

    def _say(self, event: str, **facts: Any) -> None:
        self._screen.tell(json_line({"event": event, **facts}))


def fetched(operation: Operation, wait_s: float) -> Iterator[News]:
    """Yield the waiting events and reports, at most one full queue; wait at most `wait_s` seconds for the first."""
    try:
        yield operation.news.get(timeout=wait_s) if wait_s > 0 else operation.news.get_nowait()
        for _ in range(operation.news.maxsize):
            yield operation.news.get_nowait()
    except queue.Empty:
        return


def show_ledger(operation: Operation, screen: Screen) -> None:
    """Print the steps and costs of each unit."""
    from rich.table import Table

    entries = operation.ledger.entries()
    if not entries:
        return
    table = Table("unit", "labor", "upkeep", "memory", "steps", "dropped", "errors", box=None)
    for entry in entries:
        seen = entry.seen
        upkeep = "" if entry.upkeep_us is None else core_share(entry.upkeep_us)
        counts = [str(count) for count in (seen.steps, seen.dropped, seen.errors)]
        table.add_row(seen.unit, span(seen.labor_us / 1e6), upkeep, f"{seen.memory_bytes >> 20} MB", *counts)
    screen.show(table)


def show_files(operation: Operation, screen: Screen) -> None:
    """Print the names of the log and the recording, and how much each of them has lost."""
    log, recorder = operation.log, operation.recorder
    if log is not None:
        screen.note(f"Wrote {log.path}: {counted(log.written, 'line')}.")
        if log.lost:
            screen.warn(f"{log.path}: {counted(log.lost, 'line')} could not be written: {log.failure}")
    if recorder is None:
        return
    recording = recorder.recording
    screen.note(f"Wrote {recording.path}: {counted(recording.written, 'message')}.")
    if recording.failure is not None:
        lost = counted(recorder.lost, "message")
        screen.warn(f"{recording.path} ends early: {recording.failure}; {lost} after that were not recorded")
    elif recorder.lost or operation.dropped:
        lost = counted(recorder.lost + operation.dropped, "message")
        screen.warn(f"{lost} were not recorded, because the recorder was too slow")
