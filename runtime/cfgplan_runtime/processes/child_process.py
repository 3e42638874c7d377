"""The supervisor's side of one child process."""

from __future__ import annotations

import socket
from dataclasses import dataclass, field

from cfgplan_runtime.children.control import ControlConnection
from cfgplan_runtime.children.messages import FromChild

_LONGEST_LINE = 1 << 16


@dataclass(slots=True, eq=False)
class ChildProcess:
    """A child that the nursery was asked for. The outlets' child has no name."""

    serial: int
    name: str
    control: ControlConnection[FromChild]
    printed: socket.socket
    pid: int | None = None
    labor_us: int | None = None
    """The CPU time of its start, once it is ready."""
    is_stopping: bool = False
    steps: int = 0
    """The number of steps begun, by its last sign of life."""
    trouble: str = ""
    """The cause of its end, as it told it."""
    _line: bytearray = field(default_factory=bytearray)

    def printed_lines(self) -> tuple[list[str], bool]:
        """The lines that it has printed since the last call, and whether there will be more."""
        try:
            data = self.printed.recv(1 << 16)
        except BlockingIOError:
            return [], True
        except OSError:
            data = b""
        self._line += data
        lines = self._line.split(b"\n")
        is_cut = not data or len(lines[-1]) > _LONGEST_LINE
        self._line = bytearray() if is_cut else lines.pop()
        return [line.decode(errors="backslashreplace") for line in lines if line or not is_cut], bool(data)


def cause_of_end(child: ChildProcess, status: int) -> str:
    """How a child ended, in words."""
    import signal

    if child.trouble:
        return child.trouble
    end = f"killed by {signal.Signals(-status).name}" if status < 0 else f"ended with exit status {status}"
    return f"{end} (in step {child.steps} or later)" if child.steps else end
