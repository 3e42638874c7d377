"""Processes of nodes that a backend watches: it reports their output as events, and calls back at their end."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from cfgplan_runtime.children.exit_status import end_of_process
from cfgplan_runtime.nodes.node_process import NodeProcess
from cfgplan_runtime.streams.ends import Ends
from cfgplan_runtime.supervision import events

NOT_OURS = "this run has not started its process, and can't end it"
"""The cause for giving up a unit whose process goes on without this run."""


class WatchedProcesses:
    """Appends the output of processes to `happened`, as events.

    `shown` returns the line to report for one that a unit has printed, or None for none.
    """

    def __init__(
        self,
        ends: Ends,
        happened: list[events.Event],
        shown: Callable[[str, str], str | None] = lambda _, line: line,
    ) -> None:
        self._ends, self._happened, self._shown = ends, happened, shown

    def attend(self, process: NodeProcess, end: Callable[[], None], unit: Callable[[], str]) -> None:
        """Report the output of a process as printed by its unit, and call `end` when the process has ended."""
        self._ends.watch(process.ended, end)
        self._ends.watch(process.printed.socket, lambda: self._hear_print(process, unit()))

    def last_words(self, process: NodeProcess, unit: str) -> str:
        """End a process, and report its last lines. Returns how it has ended, as a clause."""
        process.kill()
        self._note(unit, process.printed.rest())
        self._ends.unwatch(process.ended)
        self._ends.unwatch(process.printed.socket)
        return end_of_process(process.reap())

    def _hear_print(self, process: NodeProcess, unit: str) -> None:
        lines, is_open = process.printed.read()
        self._note(unit, lines)
        if not is_open:
            self._ends.unwatch(process.printed.socket)

    def _note(self, unit: str, lines: Iterable[str]) -> None:
        shown = (self._shown(unit, line) for line in lines)
        self._happened.extend(events.UnitPrinted(unit, line) for line in shown if line is not None)
