"""One child process: its messages, its printed lines, and its CPU time and memory.

Usage comes from its CPU clock where the platform has one, from psutil elsewhere.
"""

from __future__ import annotations

import os
import socket
import sys
import time
from dataclasses import dataclass, field
from functools import cache
from math import inf
from pathlib import Path

from cfgplan.costs import MICROSECONDS
from cfgplan_runtime.children.control import ControlConnection
from cfgplan_runtime.children.messages import FromChild

_LONGEST_LINE = 1 << 16


class PrintedLines:
    """What a process prints into the other end of a socket, line by line."""

    def __init__(self, end: socket.socket) -> None:
        end.setblocking(False)
        self.socket = end
        self._line = bytearray()

    def read(self) -> tuple[list[str], bool]:
        """The lines printed since the last call, and whether more may come."""
        try:
            data = self.socket.recv(1 << 16)
        except BlockingIOError:
            return [], True
        except OSError:
            data = b""
        self._line += data
        lines = self._line.split(b"\n")
        is_cut = not data or len(lines[-1]) > _LONGEST_LINE
        self._line = bytearray() if is_cut else lines.pop()
        return [line.decode(errors="backslashreplace") for line in lines if line or not is_cut], bool(data)


@dataclass(slots=True, eq=False)
class ChildProcess:
    """A child that the nursery was asked for. The outlets' child has no name."""

    serial: int
    name: str
    control: ControlConnection[FromChild]
    printed: PrintedLines
    pid: int | None = None
    labor_us: int | None = None
    """The CPU time of its start, once it is ready."""
    is_stopping: bool = False
    steps: int = 0
    """The number of steps begun, by its last sign of life."""
    trouble: str = ""
    """The cause of its end, as it told it."""
    is_spare: bool = False
    """Whether it waits to be a unit. Until then its name is that of a cold spare."""
    due_s: float = inf
    """When a spare has to be prepared, or has to have said where it hangs; infinite once it is prepared."""
    changed_ns: dict[str, int] = field(default_factory=dict)
    """The files of its code, as far as known, and when each was last changed, as the spare has read it."""

    def changed_file(self) -> str | None:
        """A file of a spare's code that has changed since it was read; None if none has."""
        return next((file for file, at_ns in self.changed_ns.items() if changed_ns(Path(file)) != at_ns), None)


def changed_ns(file: Path) -> int | None:
    """When a file was last changed, in nanoseconds; None if it is not there."""
    try:
        return file.stat().st_mtime_ns
    except OSError:
        return None


def cause_of_end(child: ChildProcess, status: int) -> str:
    """How a child ended, in words."""
    if child.trouble:
        return child.trouble
    end = end_of_process(status)
    return f"{end} (in step {child.steps} or later)" if child.steps else end


def end_of_process(status: int) -> str:
    """What an exit status says, in words."""
    import signal

    return f"killed by {signal.Signals(-status).name}" if status < 0 else f"ended with exit status {status}"


_CLOCK_OF_ALL_THREADS = 2


def cpu_us(pid: int) -> int | None:
    """CPU time (user and system) of a process in microseconds; None if it has ended."""
    if sys.platform == "linux":
        try:
            return time.clock_gettime_ns(~pid << 3 | _CLOCK_OF_ALL_THREADS) // 1000
        except OSError:
            return None
    return cpu_us_by_psutil(pid)


def cpu_us_by_psutil(pid: int) -> int | None:
    """`cpu_us` by psutil: slower, and in the system's ticks of about 10 ms."""
    import psutil

    try:
        times = psutil.Process(pid).cpu_times()
    except psutil.Error:
        return None
    return round(float(times.user + times.system) * MICROSECONDS)


def memory_bytes(pid: int) -> int | None:
    """Resident memory of a process; None if it has ended."""
    if sys.platform == "linux":
        try:
            return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * _page_size()
        except (OSError, IndexError):
            return None
    import psutil

    try:
        return int(psutil.Process(pid).memory_info().rss)
    except psutil.Error:
        return None


@cache
def _page_size() -> int:
    return os.sysconf("SC_PAGE_SIZE")
