"""The guard of a nursery: if the nursery and its supervisor are killed together, it kills the processes of units.

The guard descends from neither and has its own session. A kill of their process tree or group spares it. It knows the
processes by their mark. If the system allows control groups (cgroup v2, also beside v1 on hybrid systems), it kills the
nursery's whole group, including code that forks faster than single kills.
"""

from __future__ import annotations

import os
import signal
import time
from contextlib import suppress
from pathlib import Path

from setproctitle import setproctitle

from cfgplan_runtime.processes.descendants import end_marked

_GROUP_ROUNDS, _GROUP_ROUND_S = 100, 0.01
"""A group can be removed once the kernel has ended its processes: tried so many times."""


class NurseryGroup:
    """A control group below that of this process, by its folder. Raises OSError if the system does not allow one."""

    def __init__(
        self, name: str, *, mounts: Path = Path("/proc/self/mounts"), told: Path = Path("/proc/self/cgroup")
    ) -> None:
        roots = [line.split()[1] for line in mounts.read_text().splitlines() if line.split()[2] == "cgroup2"]
        own = [line[3:] for line in told.read_text().splitlines() if line.startswith("0::")]
        if not roots or not own:
            raise FileNotFoundError("there are no control groups (cgroup v2)")
        self.path = Path(roots[0]) / own[0].strip("/") / name
        self.path.mkdir()
        if not (self.path / "cgroup.kill").exists():  # before Linux 5.14
            self.path.rmdir()
            raise FileNotFoundError(f"{self.path} can't be killed as a whole")

    def enter(self) -> None:
        """Move this process into the group. Its later children begin there. Raises OSError."""
        (self.path / "cgroup.procs").write_text("0")

    def end(self) -> None:
        """Kill all processes of the group, and remove it."""
        with suppress(OSError):
            (self.path / "cgroup.kill").write_text("1")
        for _ in range(_GROUP_ROUNDS):
            with suppress(OSError):
                self.path.rmdir()
            if not self.path.exists():
                return
            time.sleep(_GROUP_ROUND_S)


def post_guard(run: str, mark: str) -> int:
    """Start a guard for this process, and move this process into a control group if that is allowed.

    Returns a descriptor that only this process may hold: its children have to close it. When it is closed, the guard
    kills the marked processes.
    """
    try:
        group = NurseryGroup(f"cfgplan-{run}-{os.getpid()}")
    except OSError:
        group = None
    watched, held = os.pipe()
    first = os.fork()
    if first == 0:
        # The guard is the child of a process that has ended, so that it is no descendant of this one.
        try:
            if os.fork() == 0:
                _guard(watched, run, mark, group)
        finally:
            os._exit(0)
    os.waitpid(first, 0)
    os.close(watched)
    if group is not None:
        with suppress(OSError):
            group.enter()
    return held


def _guard(watched: int, run: str, mark: str, group: NurseryGroup | None) -> None:
    os.setsid()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    setproctitle(f"cfgplan {run} guard")
    null = os.open(os.devnull, os.O_RDWR)
    for standard in range(3):
        os.dup2(null, standard)
    os.closerange(3, watched)
    os.closerange(watched + 1, os.sysconf("SC_OPEN_MAX"))
    while os.read(watched, 1):
        pass
    if group is not None:
        group.end()
    end_marked(mark)
