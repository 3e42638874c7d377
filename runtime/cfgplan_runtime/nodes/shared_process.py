"""A process that several units run in: each has an equal part of what it uses."""

from __future__ import annotations

from collections.abc import Iterator

from cfgplan_runtime.nodes.node_process import NodeProcess
from cfgplan_runtime.processes.child_process import cpu_us, memory_bytes
from cfgplan_runtime.supervision.backend import Usage


class SharedProcess:
    """The units in `process`, in the order in which they came; None if somebody else runs it."""

    def __init__(self, process: NodeProcess | None = None) -> None:
        self.process = process
        self._used_us: dict[str, int] = {}
        """The CPU time of each unit."""
        self._cpu_us = 0
        """The CPU time that was shared out by now."""

    def __iter__(self) -> Iterator[str]:
        return iter(self._used_us)

    def __len__(self) -> int:
        return len(self._used_us)

    @property
    def last(self) -> str:
        """The unit that came last; "" if there is none."""
        return next(reversed(self._used_us), "")

    def add(self, unit: str) -> None:
        self._share()
        self._used_us[unit] = 0

    def remove(self, unit: str) -> None:
        self._share()
        self._used_us.pop(unit, None)

    def cpu_us(self) -> int:
        """The CPU time of the process; 0 if somebody else runs it."""
        return 0 if self.process is None else cpu_us(self.process.pid) or 0

    def usage(self, unit: str) -> Usage | None:
        """A unit's part; zero if somebody else runs the process. None if it has ended."""
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
