"""CPU time and memory of the processes that a process has started."""

from __future__ import annotations

from cfgplan.amounts import MICROSECONDS


def started_usage(pid: int) -> tuple[int, int]:
    """CPU time in microseconds and resident memory in bytes of all descendants of a process.

    Processes that have ended count once their parent has reaped them.
    """
    import psutil

    cpu_s, memory = 0.0, 0
    try:
        started = psutil.Process(pid).children(recursive=True)
    except psutil.Error:
        return 0, 0
    for process in started:
        try:
            times, resident = process.cpu_times(), process.memory_info().rss
        except psutil.Error:
            continue
        cpu_s += times.user + times.system + getattr(times, "children_user", 0) + getattr(times, "children_system", 0)
        memory += int(resident)
    return round(cpu_s * MICROSECONDS), memory
