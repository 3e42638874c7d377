"""Signals for the processes of units: never for a process group, as a number of 0 would have it."""

from __future__ import annotations

import os
import signal
from typing import Protocol


class HasPids(Protocol):
    """A runtime, as far as a signal needs one."""

    def pid(self, unit: str) -> int | None: ...


def unit_pid(runtime: HasPids, unit: str) -> int:
    """Return the process id of a unit, which has to have one."""
    pid = runtime.pid(unit)
    assert pid, f"{unit} has no process"
    return pid


def signal_unit(runtime: HasPids, unit: str, number: int = signal.SIGKILL) -> None:
    """Send a signal to the process of a unit, which has to have one."""
    os.kill(unit_pid(runtime, unit), number)
