"""Processes that wait to be nodes: rclpy imported, and their participants known to all others."""

from __future__ import annotations

import json
import socket
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from cfgplan_runtime.nodes.node_process import NodeProcess
from cfgplan_runtime.ros2.ros_python import RosPython
from cfgplan_runtime.streams.ends import Ends

_MAIN = Path(__file__).with_name("host") / "warm.py"


class WarmNode:
    """A process that can become any node in Python. It can once it `is_ready`. Raises OSError."""

    def __init__(
        self, ends: Ends, python: RosPython, folder: Path, messages: Iterable[str], tell_ready: Callable[[], None]
    ) -> None:
        self._ends, self._tell_ready = ends, tell_ready
        self._socket, theirs = socket.socketpair()
        number = theirs.fileno()
        command = [python.program, str(_MAIN), str(number), ",".join(sorted(messages))]
        try:
            self.process = NodeProcess(command, python.environment, folder, [number])
        except OSError:
            self._socket.close()
            raise
        finally:
            theirs.close()
        self.is_ready = False
        self._ends.watch(self._socket, self._hear)

    def become(self, command: Sequence[str], environment: Mapping[str, str]) -> NodeProcess:
        """Turn it into a node. Returns its process."""
        self._ends.unwatch(self._socket)
        with self._socket, suppress(OSError):  # its end is told
            self._socket.sendall(json.dumps([command, environment]).encode() + b"\n")
        return self.process

    def close(self) -> None:
        """Stop waiting for it."""
        self._ends.unwatch(self._socket)
        self._socket.close()

    def _hear(self) -> None:
        self._ends.unwatch(self._socket)
        if self._socket.recv(16):
            self.is_ready = True
            self._tell_ready()


def is_python(program: str) -> bool:
    """Whether a program's first line names Python, so that a waiting Python can run it."""
    try:
        with Path(program).open("rb") as file:
            first = file.readline(200)
    except OSError:
        return False
    return first.startswith(b"#!") and b"python" in first
