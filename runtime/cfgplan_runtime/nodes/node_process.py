"""The process of a node that the run has started: its start, its output and its end."""

from __future__ import annotations

import os
import shutil
import signal
import socket
import subprocess
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from cfgplan_runtime.processes.child_process import PrintedLines


def with_parent(command: list[str]) -> list[str]:
    """The command, wrapped so that it ends with the thread that starts it. Systems without `setpriv` can't do this."""
    setpriv = shutil.which("setpriv")
    return command if setpriv is None else [setpriv, "--pdeathsig", "KILL", "--", *command]


class NodeProcess:
    """A process in a session of its own, which ends with the thread that made it. Raises OSError if it can't start.

    It inherits the descriptors `passed`. The descriptor `ended` becomes readable when it has ended.
    """

    def __init__(
        self, command: Sequence[str], environment: Mapping[str, str], folder: Path, passed: Sequence[int] = ()
    ) -> None:
        ours, theirs = socket.socketpair()
        try:
            self._process: subprocess.Popen[bytes] = subprocess.Popen(
                with_parent(list(command)),
                env=dict(environment),
                cwd=folder,
                pass_fds=passed,
                stdin=subprocess.DEVNULL,
                stdout=theirs.fileno(),
                stderr=theirs.fileno(),
                start_new_session=True,
            )
        except OSError:
            ours.close()
            raise
        finally:
            theirs.close()
        self.pid = self._process.pid
        self.printed = PrintedLines(ours)
        self.ended = os.pidfd_open(self.pid)

    def has(self, pid: int) -> bool:
        """Whether the process with id `pid` belongs to this node's session."""
        try:
            return os.getsid(pid) == self.pid
        except OSError:
            return False

    def interrupt(self) -> None:
        """Send SIGINT, as Ctrl-C does."""
        self._signal(signal.SIGINT)

    def kill(self) -> None:
        """Kill the process and all processes that it has started."""
        self._signal(signal.SIGKILL)

    def reap(self) -> int:
        """Wait for its end, and kill the processes that it has left behind. Returns its exit status."""
        self.kill()
        status = self._process.wait()
        os.close(self.ended)
        self.printed.socket.close()
        return status

    def _signal(self, number: int) -> None:
        for kill in (os.killpg, os.kill):
            with suppress(OSError):
                kill(self.pid, number)
                return
