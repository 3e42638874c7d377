"""Limits on the total CPU time of a host's units: control groups of Linux, on systems that allow them."""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from cfgplan_runtime.errors import RuntimeFaultError

_PERIOD_US = 100_000
_LEAST_US = 1_000
"""The kernel's smallest share of a period."""
_MEND = "start it alone in a group that it may divide, as by systemd-run --user --scope -p Delegate=yes"


class CpuGroup:
    """A control group (cgroup v2) by its folder; it limits the total CPU time of its processes."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def take(self, pid: int) -> None:
        """Put a process and its later children into the group. A process that has ended is ignored."""
        with suppress(OSError):
            (self.path / "cgroup.procs").write_text(str(pid))

    def close(self) -> None:
        """Remove the group once its processes have ended."""
        with suppress(OSError):
            self.path.rmdir()


def cpu_groups(
    limits_us: Mapping[str, int], *, root: Path = Path("/sys/fs/cgroup"), told: Path = Path("/proc/self/cgroup")
) -> dict[str, CpuGroup]:
    """Make a control group for each name, whose processes together get at most the given microseconds of CPU time a
    second.

    The groups are made below the group of this process, which moves to another one below: the kernel limits no groups
    below one that has processes itself. Raises RuntimeFaultError if that is not allowed; then nothing is changed.
    """
    here, me = _group_of_this_process(root, told), str(os.getpid())
    own = here / f"cfgplan-{me}"
    groups = {name: here / f"cfgplan-{me}-{number}" for number, name in enumerate(limits_us)}
    try:
        own.mkdir()
        (own / "cgroup.procs").write_text(me)
        (here / "cgroup.subtree_control").write_text("+cpu")
        for name, path in groups.items():
            path.mkdir()
            share_us = max(_LEAST_US, limits_us[name] * _PERIOD_US // 1_000_000)
            (path / "cpu.max").write_text(f"{share_us} {_PERIOD_US}")
    except OSError as error:
        with suppress(OSError):
            (here / "cgroup.procs").write_text(me)
        for made in (*groups.values(), own):
            with suppress(OSError):
                made.rmdir()
        raise RuntimeFaultError(f"no control group can be made in {here}: {error.strerror}; {_MEND}") from None
    return {name: CpuGroup(path) for name, path in groups.items()}


def _group_of_this_process(root: Path, told: Path) -> Path:
    """The group of this process. Raises RuntimeFaultError if it can't limit CPU time."""
    try:
        (path,) = (line[3:] for line in told.read_text().splitlines() if line.startswith("0::"))
        here = root / path.lstrip("/")
        if "cpu" in (here / "cgroup.controllers").read_text().split():
            return here
    except (OSError, ValueError):
        pass
    raise RuntimeFaultError("this system has no control groups (cgroup v2) here that limit CPU time")
