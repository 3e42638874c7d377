"""What another process has used: its CPU clock where the platform has one, psutil elsewhere."""

from __future__ import annotations

import os
import sys
import time
from functools import cache
from pathlib import Path

_US_PER_S = 1_000_000
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
    """The same by psutil: slower, in the system's ticks of about 10 ms."""
    import psutil

    try:
        times = psutil.Process(pid).cpu_times()
    except psutil.Error:
        return None
    return round(float(times.user + times.system) * _US_PER_S)


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
