"""Processes that wait to be nodes: rclpy imported, and their participants known to all others."""

from __future__ import annotations

import json
import socket
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from cfgplan_runtime.nodes.node_process import NodeProcess
from cfgplan_runtime.processes.child_process import cpu_us
from cfgplan_runtime.ros2.ros_python import RosPython
from cfgplan_runtime.streams.ends import Ends
from cfgplan_runtime.supervision import events

_MAIN = Path(__file__).with_name("host") / "warm.py"
_WARM_S = 3.0
"""Seconds without a start before a waiting process is made: starts have priority."""


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


class WarmNodes:
    """The waiting processes of a run: one for each cold spare, and with `keeps_one` another, "", for any node.

    `make(spare, messages, tell_ready)` starts a process; it raises OSError. Events about spares go to `happened`.
    """

    def __init__(
        self,
        make: Callable[[str, Iterable[str], Callable[[], None]], WarmNode],
        happened: list[events.Event],
        now_s: float,
        *,
        keeps_one: bool,
    ) -> None:
        self._make, self._happened, self._keeps_one = make, happened, keeps_one
        self._due_s = now_s + _WARM_S
        self._waiting: dict[str, WarmNode] = {}
        self._unfit: set[str] = set()
        """Transformations whose nodes fail to begin in a process that waited."""

    def __contains__(self, spare: str) -> bool:
        return spare in self._waiting

    def is_ready(self, spare: str) -> bool:
        """Whether a process waits for this spare, or for any node if `spare` is ""."""
        return spare in self._waiting and self._waiting[spare].is_ready

    def process(self, spare: str) -> NodeProcess | None:
        return self._waiting[spare].process if spare in self._waiting else None

    def spare_of(self, process: NodeProcess) -> str:
        """The spare that a process waits for; "" if it is for any node, or does not wait."""
        return next((spare for spare, warm in self._waiting.items() if warm.process is process), "")

    def fits(self, label: str, program: str) -> bool:
        """Whether nodes of a transformation can begin in a process that has waited."""
        return label not in self._unfit and is_python(program)

    def refuse(self, label: str) -> None:
        """Start nodes of a transformation in the usual way from now on: one has failed."""
        self._unfit.add(label)

    def begin(self, spare: str, messages: Iterable[str]) -> None:
        """Let a process wait. Raises OSError."""
        self._waiting[spare] = self._make(spare, messages, lambda: self._note_ready(spare))

    def keep_one(self, messages: Iterable[str], now_s: float) -> None:
        """Let a process wait for any node, once no node has been started for a while."""
        if self._keeps_one and "" not in self._waiting and self._due_s <= now_s and messages:
            self._due_s = now_s + _WARM_S
            with suppress(OSError):
                self.begin("", messages)

    def become(self, spare: str, unit: str, command: Sequence[str], now_s: float) -> NodeProcess:
        """Turn a process that is ready into a unit's node. Returns the process."""
        warm = self._waiting.pop(spare)
        self._due_s = now_s + _WARM_S
        if spare:
            self._happened.append(events.SpareUsed(unit, spare))
        return warm.become(command, {})

    def take(self, spare: str) -> NodeProcess:
        """Let a process wait no longer. Returns the process, which the caller ends."""
        warm = self._waiting.pop(spare)
        warm.close()
        return warm.process

    def take_all(self) -> dict[str, NodeProcess]:
        """Let no process wait any longer. Returns the processes by their spares."""
        return {spare: self.take(spare) for spare in list(self._waiting)}

    def lose(self, spare: str, cause: str) -> None:
        """Forget a process that has ended while it waited."""
        if spare in self._waiting:
            self.take(spare)
        if spare:
            self._happened.append(events.SpareLost(spare, cause))

    def _note_ready(self, spare: str) -> None:
        if spare:
            labor_us = cpu_us(self._waiting[spare].process.pid) or 0
            self._happened.append(events.SparePrepared(spare, labor_us))


def is_python(program: str) -> bool:
    """Whether a program's first line names Python, so that a waiting Python can run it."""
    try:
        with Path(program).open("rb") as file:
            first = file.readline(200)
    except OSError:
        return False
    return first.startswith(b"#!") and b"python" in first
