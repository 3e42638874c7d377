"""One child process: its messages, its printed lines, and its CPU time and memory.

Usage is read from its CPU clock if the platform has one, else by psutil.
"""

from __future__ import annotations

import os
import signal
import socket
import sys
import time
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache
from math import inf
from pathlib import Path

from cfgplan.amounts import MICROSECONDS
from cfgplan_runtime.children.control import ControlConnection
from cfgplan_runtime.children.exit_status import end_of_process
from cfgplan_runtime.children.messages import FromChild
from cfgplan_runtime.children.started_usage import started_usage
from cfgplan_runtime.supervision.events import End

_LONGEST_LINE = 1 << 16
_MOST_BYTES = 1 << 22
"""The most bytes of output that are read in a second. Beyond it the process is blocked while it prints, as at a slow
terminal.
"""
_MOST_READS_AT_THE_END = 64
"""The most pieces of 64 kB that are read after a process has ended."""
MOST_LINES = 500
"""The most lines of a process that are reported in a second. The others are counted."""


class PrintedLines:
    """The output of a process into the other end of a socket, line by line: at most MOST_LINES a second."""

    def __init__(self, end: socket.socket) -> None:
        end.setblocking(False)
        self.socket = end
        self._line = bytearray()
        self._second_s = 0.0
        """The beginning of the present second."""
        self._bytes = 0
        """The bytes read in this second."""
        self._told = self._left_out = 0
        """The number of lines reported in this second, and the number left out since the last report of that."""

    def read(self) -> tuple[list[str], bool]:
        """Some of the lines printed since the last call, and whether more may come."""
        note = self.left_out()
        lines, is_open = self._read()
        return [*filter(None, [note]), *self._told_of(lines or [])], is_open

    @property
    def is_enough(self) -> bool:
        """Whether the limit of this second is reached, so that the process has to wait."""
        return self._bytes >= _MOST_BYTES and time.monotonic() - self._second_s < 1.0

    def rest(self) -> list[str]:
        """The last lines of a process that has ended; a process that it has left behind may continue to print."""
        told: list[str] = []
        for _ in range(_MOST_READS_AT_THE_END):
            lines, is_open = self._read()
            if lines is None:
                break
            told += self._told_of(lines)
            if not is_open:
                break
        return [*told, *filter(None, [self.left_out(is_over=True)])]

    def left_out(self, *, is_over: bool = False) -> str:
        """A note of the lines that were left out, once their second is over or the process is; else nothing."""
        now_s = time.monotonic()
        if not is_over and now_s - self._second_s < 1.0:
            return ""
        self._second_s, self._told, self._bytes = now_s, 0, 0
        number, self._left_out = self._left_out, 0
        return f"cfgplan: {number:,} more lines are left out: at most {MOST_LINES} a second are shown" if number else ""

    def _told_of(self, lines: list[bytes]) -> list[str]:
        """The text of the lines within this second's limit; the others are counted."""
        told = lines[: MOST_LINES - self._told]
        self._told += len(told)
        self._left_out += len(lines) - len(told)
        return [line.decode(errors="backslashreplace") for line in told]

    def _read(self) -> tuple[list[bytes] | None, bool]:
        """The next lines, None if no data came, and whether more may come."""
        try:
            data = self.socket.recv(1 << 16)
        except BlockingIOError:
            return None, True
        except OSError:
            data = b""
        self._line += data
        self._bytes += len(data)
        lines = [bytes(line) for line in self._line.split(b"\n")]
        is_cut = not data or len(lines[-1]) > _LONGEST_LINE
        self._line = bytearray() if is_cut else bytearray(lines.pop())
        return [line for line in lines if line or not is_cut], bool(data)


@dataclass(slots=True, eq=False)
class ChildProcess:
    """A child that the nursery was asked to fork. The outlets' child has no name."""

    serial: int
    name: str
    control: ControlConnection[FromChild]
    printed: PrintedLines
    is_printing: bool = False
    """Whether it has printed something and may print more."""
    pid: int | None = None
    labor_us: int | None = None
    """The CPU time of its start, once it is ready."""
    is_stopping: bool = False
    steps: int = 0
    """The number of started steps, by its last sign of life."""
    trouble: str = ""
    """The cause of its end, as reported by the child."""
    how: End = "died"
    is_program: bool = False
    """Whether it hosts a program, whose CPU time and memory are its own."""
    is_spare: bool = False
    """Whether it is a cold spare, with the spare's name, until a unit starts in it."""
    due_s: float = inf
    """The deadline for preparing a spare, or for printing where it hangs; infinite once it is prepared."""
    changed_ns: dict[str, int] = field(default_factory=dict)
    """The known files of a spare's code, with the times of their last changes when the spare read them."""

    _cpu_us: int = -1
    _memory_bytes: int = 0
    """The last usage."""

    def usage(self) -> tuple[int, int] | None:
        """CPU time in microseconds and memory in bytes; None before its start and after its end."""
        if self.pid is None:
            return None
        cpu = cpu_us(self.pid)
        if cpu is not None and cpu == self._cpu_us:
            return cpu, self._memory_bytes  # it has not run since: its memory is the same
        memory = memory_bytes(self.pid)
        if cpu is None or memory is None:
            return None
        if not self.is_program:
            self._cpu_us, self._memory_bytes = cpu, memory
        more_cpu, more_memory = started_usage(self.pid) if self.is_program else (0, 0)
        return cpu + more_cpu, memory + more_memory

    def changed_file(self) -> str | None:
        """A file of a spare's code that has changed since it was read; None if none has."""
        return next((file for file, at_ns in self.changed_ns.items() if changed_ns(Path(file)) != at_ns), None)


def changed_ns(file: Path) -> int | None:
    """The time of a file's last change, in nanoseconds; None if the file does not exist."""
    try:
        return file.stat().st_mtime_ns
    except OSError:
        return None


def cause_of_end(child: ChildProcess, status: int) -> str:
    """How a child ended, in words."""
    if child.trouble:
        return child.trouble
    if child.control.is_garbled:
        return "it sent bytes that are not a message: its code writes to file descriptors that are not its own"
    end = end_of_process(status)
    return f"{end} (in step {child.steps} or later)" if child.steps else end


def kill_group(pid: int) -> None:
    """Kill a child and all processes that it has started."""
    for kill in (os.killpg, os.kill):
        with suppress(OSError):
            kill(pid, signal.SIGKILL)


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
            file = os.open(
                f"/proc/{pid}/statm", os.O_RDONLY
            )  # Path takes five times as long, for each unit each second
            try:
                return int(os.read(file, 256).split()[1]) * _page_size()
            finally:
                os.close(file)
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
