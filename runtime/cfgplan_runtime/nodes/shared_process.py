"""A process that several units run in; they share its CPU time and memory equally."""

from __future__ import annotations

from collections.abc import Iterator

from cfgplan_runtime.nodes.node_process import NodeProcess
from cfgplan_runtime.processes.child_process import cpu_us, memory_bytes
from cfgplan_runtime.supervision.backend import Usage


class SharedProcess:
    """A process with its units, in the order in which they were added.

    `process` is None if the run has not started the process; its usage is then zero.
    """

    def __init__(self, process: NodeProcess | None = None) -> None:
        self.process = process
        self._used_us: dict[str, int] = {}
        """The CPU time of each unit, in microseconds."""
        self._cpu_us = 0
        """The CPU time that has been distributed to units so far."""

    def __iter__(self) -> Iterator[str]:
        return iter(self._used_us)

    def __len__(self) -> int:
        return len(self._used_us)

    @property
    def last(self) -> str:
        """The unit that was added last; "" without units."""
        return next(reversed(self._used_us), "")

    def add(self, unit: str) -> None:
        self._share()
        self._used_us[unit] = 0

    def remove(self, unit: str) -> None:
        self._share()
        self._used_us.pop(unit, None)

    def cpu_us(self) -> int:
        """The CPU time of the process in microseconds; 0 if the run has not started it."""
        return 0 if self.process is None else cpu_us(self.process.pid) or 0

    def usage(self, unit: str) -> Usage | None:
        """A unit's equal share of the usage, zero if the run has not started the process. None if the process has
        ended.
        """
        if self.process is None:
            return Usage(0, 0)
        self._share()
        memory = memory_bytes(self.process.pid)
        return None if memory is None else Usage(self._used_us[unit], memory // len(self), self.process.pid)

    def _share(self) -> None:
        now_us = self.cpu_us()
        if self._used_us:
            part_us = max(0, now_us - self._cpu_us) // len(self)
            self._used_us = {unit: used_us + part_us for unit, used_us in self._used_us.items()}
        self._cpu_us = now_us
