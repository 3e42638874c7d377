"""The processes that units start, also those that begin a session of their own or outlive their parents. Only on Linux.

Each child of a nursery has a mark that all its descendants inherit: a limit (RLIMIT_RTTIME) that no process reaches.
The nursery adopts orphans, so it is told of the end of each. On other systems the functions here find nothing.
"""

from __future__ import annotations

import ctypes
import os
import resource
import signal
import sys
import time
import zlib
from contextlib import suppress
from functools import cache
from pathlib import Path

_PR_SET_CHILD_SUBREAPER = 36
_IS_MARKED = 1 << 61
"""Microseconds: 73,000 years of uninterrupted CPU time. The bits below are the nursery's (32) and the child's (24)."""
_SERIALS = 1 << 24
_LIMIT = "Max realtime timeout"
_ROUNDS, _ROUND_S = 100, 0.01
"""Processes are looked for again, since they fork: at most so many times. Children end within some of these times."""


def adopt_orphans() -> None:
    """Become the parent of all descendants whose parents end."""
    if sys.platform == "linux":
        control_process(_PR_SET_CHILD_SUBREAPER, 1)


def control_process(option: int, value: int) -> None:
    """Set an option of this process (`prctl`). Only on Linux."""
    _system_library().prctl(option, value)


@cache
def _system_library() -> ctypes.CDLL:
    return ctypes.CDLL(None)


def mark_of(run: str, nursery: int) -> str:
    """The mark of the children of a nursery, given by its process id: a run may have one after another."""
    return f"{run} {nursery}"


def put_mark(mark: str, serial: int) -> None:
    """Mark this process as a child of a nursery, and everything that it starts from now on."""
    if sys.platform == "linux":
        with suppress(OSError, ValueError):  # the system has a lower limit: process groups have to do
            _, most = resource.getrlimit(resource.RLIMIT_RTTIME)
            resource.setrlimit(resource.RLIMIT_RTTIME, (_first(mark) + serial % _SERIALS, most))


def serial_of(pid: int, mark: str) -> int | None:
    """The serial number of the child that a process descends from; None if it is of no child with this mark."""
    try:
        limits = Path(f"/proc/{pid}/limits").read_text()
        number = int(next(line for line in limits.splitlines() if line.startswith(_LIMIT)).split()[3])
    except (OSError, StopIteration, ValueError):  # it has ended, or has no limit
        return None
    serial = number - _first(mark)
    return serial if 0 <= serial < _SERIALS else None


def children() -> list[int]:
    """The children of this process that are alive or wait to be reaped, adopted ones too."""
    found = list[int]()
    for thread in _folders("/proc/self/task"):
        with suppress(OSError):
            found += map(int, Path(f"/proc/self/task/{thread}/children").read_text().split())
    return found


def end_children() -> None:
    """Kill and reap all children of this process, and their descendants, which it adopts."""
    for _ in range(_ROUNDS):
        left = children()
        for pid in left:
            _kill(pid)
        with suppress(ChildProcessError):
            while os.waitpid(-1, os.WNOHANG)[0]:
                pass
        if not left:
            return
        time.sleep(_ROUND_S)


def end_marked(mark: str) -> None:
    """Kill all processes that have a mark, also those that another process has adopted."""
    killed = set[int]()
    for _ in range(_ROUNDS):  # until none is found that was started before its parent was killed
        found = {pid for pid in _folders("/proc") if serial_of(pid, mark) is not None} - killed
        for pid in found:
            _kill(pid)
        killed |= found
        if not found:
            return


def _first(mark: str) -> int:
    return _IS_MARKED + zlib.crc32(mark.encode()) * _SERIALS


def _folders(place: str) -> list[int]:
    """The names in a folder that are numbers."""
    with suppress(OSError):
        return [int(entry.name) for entry in Path(place).iterdir() if entry.name.isdigit()]
    return []


def _kill(pid: int) -> None:
    with suppress(OSError):
        os.kill(pid, signal.SIGKILL)
