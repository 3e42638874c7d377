"""What every output of a run shares: fetching news, and the summary at the end."""

from __future__ import annotations

import queue
import re
from collections.abc import Iterator
from typing import TYPE_CHECKING

from cfgplan.cli.screen import Screen, counted

if TYPE_CHECKING:
    from cfgplan_runtime.operating.operation import News, Operation

_ESCAPE = re.compile(r"\x1b(?:\[[0-?]*[ -/]*[@-~]|\][^\x07\x1b]*(?:\x07|\x1b\\)|.)")
"""A terminal's control sequence."""


def fetched(operation: Operation, wait_s: float) -> Iterator[News]:
    """The waiting news, at most one queue full; waits at most `wait_s` for the first."""
    try:
        yield operation.news.get(timeout=wait_s) if wait_s > 0 else operation.news.get_nowait()
        for _ in range(operation.news.maxsize):
            yield operation.news.get_nowait()
    except queue.Empty:
        return


def printable(text: str) -> str:
    """The text without control sequences and other characters that a terminal would obey."""
    return "".join(c if c.isprintable() else " " for c in _ESCAPE.sub("", text).expandtabs())


def show_ledger(operation: Operation, screen: Screen) -> None:
    """What each unit did and cost."""
    from rich.table import Table

    entries = operation.ledger.entries()
    if not entries:
        return
    table = Table("unit", "labor", "upkeep", "memory", "steps", "dropped", "errors", box=None)
    for entry in entries:
        seen = entry.seen
        upkeep = "" if entry.upkeep_us is None else f"{entry.upkeep_us / 1e6:.4f} s/s"
        counts = [str(count) for count in (seen.steps, seen.dropped, seen.errors)]
        table.add_row(seen.unit, f"{seen.labor_us / 1e6:.3f} s", upkeep, f"{seen.memory_bytes >> 20} MB", *counts)
    screen.show(table)


def show_files(operation: Operation, screen: Screen) -> None:
    """What was logged and recorded, and what was not."""
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
