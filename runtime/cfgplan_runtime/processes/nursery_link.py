"""The supervisor's side of the nursery: opened when first needed, and again if it has died."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from collections.abc import Iterator, Sequence

from cfgplan_runtime.children.control import ControlConnection
from cfgplan_runtime.children.messages import ChildOrder, Fork, FromNursery, Interrupt, Kill
from cfgplan_runtime.processes.descendants import end_marked, mark_of

_CODE = "import sys; from cfgplan_runtime.processes.nursery import main; main(sys.argv[1:])"
_PATIENCE_AT_CLOSE_S = 5.0


def start_helper(
    code: str, *arguments: str, in_own_session: bool = False
) -> tuple[subprocess.Popen[bytes], socket.socket]:
    """Start a process that runs `code`. Returns it, and the local end of its control connection. Raises OSError.

    Its first arguments are the number of its own end and the id of this process. It is in a process group of its own
    from the beginning, so that Ctrl-C reaches only this process.
    """
    ours, theirs = socket.socketpair()
    number = theirs.fileno()
    try:
        process = subprocess.Popen(
            [sys.executable, "-c", code, str(number), str(os.getpid()), *arguments],
            pass_fds=[number],
            stdin=subprocess.DEVNULL,
            start_new_session=in_own_session,
            process_group=None if in_own_session else 0,
        )
    except OSError:
        ours.close()
        raise
    finally:
        theirs.close()
    return process, ours


class NurseryLink:
    """A nursery and the connection to it. It is made by the thread that calls `open`, and ends with that thread."""

    def __init__(self, run: str, preload: Sequence[str]) -> None:
        self._run = run
        self._preload = tuple(preload)
        self._control: ControlConnection[FromNursery] | None = None
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def is_open(self) -> bool:
        return self._control is not None

    @property
    def is_waiting(self) -> bool:
        """Whether messages wait until the socket can be written."""
        return self._control is not None and self._control.is_waiting

    def open(self) -> socket.socket:
        """Start a nursery. Returns the socket to watch; call `hear` when it is readable, and while messages wait also
        when it can be written. Raises OSError.
        """
        self._process, ours = start_helper(_CODE, self._run, *self._preload)
        self._control = ControlConnection(ours, FromNursery)
        return ours

    def fork(self, serial: int, order: ChildOrder, ends: Sequence[socket.socket]) -> None:
        """Ask for a child, with its ends of the control connection and of the pipe for its output."""
        assert self._control is not None
        self._control.send(Fork(serial, order), ends)

    def kill(self, serial: int, *, dump: bool = False) -> None:
        """Kill a child. Without a nursery there are no children, and this does nothing."""
        if self._control is not None:
            self._control.send(Kill(serial, dump))

    def interrupt(self, serial: int) -> None:
        """Interrupt the code of a child that was told to finish."""
        if self._control is not None:
            self._control.send(Interrupt(serial))

    def hear(self) -> Iterator[FromNursery]:
        """Read the nursery's messages. Sets `has_died` if the connection has ended."""
        assert self._control is not None
        self._control.flush()
        for message, _ in self._control.receive():
            yield message

    def end(self) -> None:
        """Kill a nursery that does not answer, with all its children; `has_died` becomes true."""
        if self._process is not None:
            self._process.kill()

    @property
    def has_died(self) -> bool:
        return self._control is not None and self._control.has_ended

    def close(self) -> None:
        """End the nursery and all its children, and wait for their end."""
        if self._control is None or self._process is None:
            return
        self._control.close()
        self._control = None
        try:
            self._process.wait(_PATIENCE_AT_CLOSE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        if self._process.returncode:  # it was killed, and has ended nothing
            end_marked(mark_of(self._run, self._process.pid))
