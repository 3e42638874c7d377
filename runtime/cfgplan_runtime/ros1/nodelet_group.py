"""A nodelet manager of ROS 1, and the nodelets that a run loads and unloads by the manager's services."""

from __future__ import annotations

import struct
import threading
import time
from collections.abc import Callable, Sequence

from cfgplan.ros.graph import resolved
from cfgplan.ros.node_api import SilentError
from cfgplan_runtime.nodes.node_process import NodeProcess
from cfgplan_runtime.nodes.shared_process import SharedProcess
from cfgplan_runtime.ros1.node_watch import NodeWatch
from cfgplan_runtime.ros1.ros_unit import RosUnit
from cfgplan_runtime.ros1.tcpros import answered, service_end

_MANAGER_START_S = 30.0
_MANAGER_LOOK_S = 0.05
_LOAD_S = 30.0
"""Seconds that loading a nodelet may take, including its constructor."""
_SEE = "can't be loaded: see what it printed"
"""A manager that refuses gives no reason, but prints one."""


class NodeletGroup:
    """The manager `name`. `process` is None if the run has not started it. `units` are those of its nodelets."""

    def __init__(self, name: str, master: str, process: NodeProcess | None) -> None:
        self.name, self.process = name, process
        self.units = SharedProcess(process)
        self.watch: NodeWatch | None = None
        self.address: str | None = None
        """Its address, once it has registered with the master."""
        self._master = master

    def load(self, unit: str, ros: RosUnit, tell: Callable[[str, int], None]) -> None:
        """Load a nodelet once the manager answers. A thread calls `tell` with the cause of a failure, or "", and with
        the labor in microseconds.
        """
        self.units.add(unit)
        namespace = ros.name.rpartition("/")[0]  # the manager would take names for its own
        remaps = sorted((resolved(own, namespace, ros.name), topic) for own, topic in ros.remappings.items())
        request = b"".join(
            (
                *(_text(one) for one in (ros.name, f"{ros.source.package}/{ros.source.name}")),
                *(_texts([pair[place] for pair in remaps]) for place in (0, 1)),
                _texts(ros.source.arguments),
                _text(""),
            )
        )
        before_us = 0 if len(self.units) == 1 else self.units.cpu_us()

        def work() -> None:
            try:
                self._await_services()
                cause = "" if self._asked("load_nodelet", request, _LOAD_S) else _SEE
            except (SilentError, OSError) as error:
                cause = f"can't be loaded: {error}" if str(error) else _SEE
            tell(cause, max(0, self.units.cpu_us() - before_us))

        threading.Thread(target=work, daemon=True).start()

    def unload(self, ros: RosUnit, tell: Callable[[bool], None]) -> None:
        """Unload a nodelet. A thread calls `tell` with whether this succeeded."""
        threading.Thread(target=lambda: tell(self.unloads(ros)), daemon=True).start()

    def unloads(self, ros: RosUnit) -> bool:
        """Unload a nodelet, and wait for it. Returns whether this succeeded."""
        try:
            return self._asked("unload_nodelet", _text(ros.name))
        except (SilentError, OSError):
            return False

    def _await_services(self) -> None:
        """Wait until the manager answers. Before that the master may list the services of a dead one."""
        until = time.monotonic() + _MANAGER_START_S
        while True:
            try:
                service_end(self._master, f"{self.name}/load_nodelet").close()
            except (SilentError, OSError):
                if time.monotonic() > until:
                    raise
                time.sleep(_MANAGER_LOOK_S)
            else:
                return

    def _asked(self, service: str, request: bytes, patience_s: float | None = None) -> bool:
        return answered(self._master, f"{self.name}/{service}", request, patience_s) == b"\x01"


def _text(text: str) -> bytes:
    data = text.encode()
    return struct.pack("<I", len(data)) + data


def _texts(texts: Sequence[str]) -> bytes:
    return struct.pack("<I", len(texts)) + b"".join(map(_text, texts))
