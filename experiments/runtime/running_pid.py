"""The process of a unit that has to have one: a default of 0 would send signals to the whole process group."""

from __future__ import annotations

from cfgplan_runtime import Runtime


def running_pid(runtime: Runtime, unit: str) -> int:
    """The number of a unit's process. Raises LookupError if it has none."""
    pid = runtime.pid(unit)
    if not pid:
        raise LookupError(f"{unit} has no process")
    return pid
