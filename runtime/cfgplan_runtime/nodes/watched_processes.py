"""Processes of nodes that a backend watches: it reports their output as events, and calls back at their end."""

from __future__ import annotations

from collections.abc import Callable

from cfgplan_runtime.children.exit_status import end_of_process
from cfgplan_runtime.nodes.node_process import NodeProcess
from cfgplan_runtime.streams.ends import Ends
from cfgplan_runtime.supervision import events


class WatchedProcesses:
    """Appends the output of processes to `happened`, as events."""

    def __init__(self, ends: Ends, happened: list[events.Event]) -> None:
        self._ends, self._happened = ends, happened

    def attend(self, process: NodeProcess, end: Callable[[], None], unit: Callable[[], str]) -> None:
        """Report the output of a process as printed by its unit, and call `end` when the process has ended."""
        self._ends.watch(process.ended, end)
        self._ends.watch(process.printed.socket, lambda: self._hear_print(process, unit()))

    def last_words(self, process: NodeProcess, unit: str) -> str:
        """End a process, and report its last lines. Returns how it has ended, as a clause."""
        process.kill()
        self._happened.extend(events.UnitPrinted(unit, line) for line in process.printed.rest())
        self._ends.unwatch(process.ended)
        self._ends.unwatch(process.printed.socket)
        return end_of_process(process.reap())

    def _hear_print(self, process: NodeProcess, unit: str) -> None:
        lines, is_open = process.printed.read()
        self._happened.extend(events.UnitPrinted(unit, line) for line in lines)
        if not is_open:
            self._ends.unwatch(process.printed.socket)
