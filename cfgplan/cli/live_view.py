"""The live view of a run in the terminal: fetches what there is, and has it drawn a few times a second."""

from __future__ import annotations

import time
from collections import deque
from dataclasses import replace
from typing import TYPE_CHECKING, Self

from rich.console import Console
from rich.live import Live

from cfgplan.cli.plan_text import with_the_stream
from cfgplan.cli.run_output import RunOutput, fetched, show_files, show_ledger
from cfgplan.cli.run_picture import LogLine, RunPicture
from cfgplan.cli.screen import Screen, counted

if TYPE_CHECKING:
    from cfgplan_runtime.lifecycle.reports import Snapshot, UnitView
    from cfgplan_runtime.operating.operation import Operation

_REFRESH_S = 0.25
_LARGEST_SHARE = 0.1
"""Of the time that is spent on drawing; a system of thousands of units is drawn less often."""
_MOST_LINES = 200
_LINES_AFTERWARDS = 8


class LiveView(RunOutput):
    """Fills the terminal while a run is held; what matters is printed again when it is over."""

    def __init__(self, screen: Screen, operation: Operation, console: Console | None = None) -> None:
        super().__init__(screen, operation)
        self._live = Live(
            console=console or Console(highlight=False, markup=False, emoji=False),
            screen=True,
            auto_refresh=False,
            redirect_stdout=False,
            redirect_stderr=False,
        )
        self._lines: deque[LogLine] = deque(maxlen=_MOST_LINES)
        self._since_s = time.monotonic()
        self._draw_at_s = 0.0
        self._note = ""
        self._reviews = 0

    def __enter__(self) -> Self:
        self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._live.stop()

    def update(self, wait_s: float) -> None:
        from cfgplan_runtime.lifecycle.reports import Reviewed
        from cfgplan_runtime.operating.sentences import WARNING, level, sentence

        for news in fetched(self._operation, wait_s):
            said = news if isinstance(news, str) else sentence(news)
            is_review = isinstance(news, Reviewed)
            self._reviews += is_review
            if said is not None:
                grade = WARNING if isinstance(news, str) else level(news)
                self._lines += (LogLine(time.time(), grade, text, is_review) for text in said.splitlines())
        if time.monotonic() >= self._draw_at_s:
            self._draw()

    def note(self, text: str) -> None:
        self._note = text
        self._draw()

    def sum_up(self) -> None:
        self.update(0.0)
        took = time.strftime("%H:%M:%S", time.gmtime(time.monotonic() - self._since_s))
        operation, screen = self._operation, self._screen
        screen.note(
            f"Run {operation.id} of {operation.environment} ended after {took}; {counted(self._reviews, 'review')}."
        )
        for line in list(self._lines)[-_LINES_AFTERWARDS:]:
            screen.show(line.text_with_time())
        show_ledger(operation, screen)
        show_files(operation, screen)

    def _draw(self) -> None:
        from cfgplan_runtime.operating.records import snapshot_record

        began_s = time.monotonic()
        operation = self._operation
        snapshot = operation.manager.snapshot()
        picture = RunPicture(
            run=operation.id,
            environment=operation.environment,
            elapsed_s=time.monotonic() - self._since_s,
            state=snapshot_record(replace(snapshot, units=_with_the_stream(snapshot)), operation.flows.records()),
            lines=tuple(self._lines),
            recorded=operation.recorder.recording.written if operation.recorder else None,
            note=self._note,
        )
        if self._live.is_started:
            self._live.update(picture, refresh=True)
        now_s = time.monotonic()
        self._draw_at_s = now_s + max(_REFRESH_S, (now_s - began_s) / _LARGEST_SHARE)


def _with_the_stream(snapshot: Snapshot) -> tuple[UnitView, ...]:
    """The units from sources to targets."""
    views = {view.unit.id: view for view in snapshot.units}
    return tuple(views[unit.id] for unit in with_the_stream(snapshot.environment) if unit.id in views)
