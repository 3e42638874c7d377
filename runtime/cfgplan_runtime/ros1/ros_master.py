"""The ROS 1 master of a run: one that already answers, or one that is started for the run and ends with it."""

from __future__ import annotations

import os
import select
import shutil
import socket
import subprocess
import time
from collections.abc import Mapping
from contextlib import suppress
from typing import Any
from urllib.parse import urlparse

from cfgplan.errors import InputError
from cfgplan.ros.master import MASTER_VARIABLE, USUAL_MASTER
from cfgplan.ros.node_api import SilentError, asked, peer
from cfgplan_runtime.errors import RuntimeFaultError
from cfgplan_runtime.nodes.node_process import with_parent

_CALLED_BY = "/cfgplan"
_MASTER_START_S = 30.0
_MASTER_LOOK_S = 0.02
_HOST_VARIABLES = ("ROS_IP", "ROS_HOSTNAME")


def master_address() -> str:
    """The address of the master, as ROS_MASTER_URI says it."""
    return os.environ.get(MASTER_VARIABLE) or USUAL_MASTER


def own_host(master: str) -> str:
    """The name under which nodes that know the master at an address reach nodes on this computer."""
    named = next((os.environ[name] for name in reversed(_HOST_VARIABLES) if os.environ.get(name)), None)
    return named or ("127.0.0.1" if _is_local(master) else socket.gethostname())


def _is_local(master: str) -> bool:
    return urlparse(master).hostname in ("localhost", "127.0.0.1", "::1", socket.gethostname())


class RosMaster:
    """The master at ROS_MASTER_URI. If none answers there, one is started as by `roslaunch`, without `rosout`.

    A master that it starts ends with the thread that made it. Not thread-safe. Raises InputError if no master can be
    reached or started.
    """

    def __init__(self) -> None:
        self.address = master_address()
        self._process: subprocess.Popen[bytes] | None = None
        self._peer = peer(self.address)
        self.is_local = _is_local(self.address)
        self._port = urlparse(self.address).port or 11311
        self.ended: int | None = None
        """A descriptor that becomes readable when the run's own master has ended; None without one."""
        if not self.answers():
            self._start()

    @property
    def host(self) -> str:
        """The name under which other nodes reach nodes on this computer."""
        return own_host(self.address)

    @property
    def environment(self) -> Mapping[str, str]:
        """The environment of nodes. If the master is on this computer, only this computer reaches them, unless ROS_IP
        or ROS_HOSTNAME is set.
        """
        is_said = any(os.environ.get(name) for name in _HOST_VARIABLES)
        host = {} if is_said or not self.is_local else {"ROS_IP": self.host}
        inherited = {name: value for name, value in os.environ.items() if name != "ROS_NAMESPACE"}
        return {**inherited, MASTER_VARIABLE: self.address, "PYTHONUNBUFFERED": "1", **host}

    def answers(self) -> bool:
        """Whether the master answers."""
        try:
            self.ask("getPid")
        except SilentError:
            return False
        return True

    def ask(self, method: str, *arguments: object) -> Any:
        """Call a method of the master, and return its answer. Raises SilentError."""
        return asked(self._peer, _CALLED_BY, method, *arguments)

    def unpublish(self, node: str, topic: str, address: str) -> None:
        """Tell the master that a node at an address no longer publishes a topic. Raises SilentError."""
        asked(self._peer, node, "unregisterPublisher", topic, address)

    def ask_node(self, node: str) -> None:
        """Check that a node answers. Raises SilentError if the master does not know it, or if it misses two calls.

        A second node of the same name would end it, so one missed call, as on a busy computer, is not enough.
        """
        address = str(self.ask("lookupNode", node))
        try:
            asked(peer(address), _CALLED_BY, "getPid")
        except SilentError:
            asked(peer(address), _CALLED_BY, "getPid")

    def set_parameters(self, node: str, parameters: Mapping[str, object]) -> None:
        """Replace all parameters of a node by these, under their full names. Raises SilentError."""
        with suppress(SilentError):  # it has none
            self.ask("deleteParam", node)
        for name, value in parameters.items():
            self.ask("setParam", name, value)

    def restart(self) -> None:
        """Start the run's own master again, empty."""
        self.close()
        self._start()

    def close(self) -> None:
        """End the master, if it is this run's own."""
        if self._process is not None and self.ended is not None:
            self._process.kill()
            self._process.wait()
            os.close(self.ended)
            self._process = self.ended = None

    def _start(self) -> None:
        program = shutil.which("rosmaster")
        if program is None or not self.is_local:
            mend = (
                "name one that runs in ROS_MASTER_URI, or install one (Debian, Ubuntu: apt install python3-rosmaster)"
            )
            raise InputError.of(f"no ROS 1 master answers at {self.address}", mend=mend)
        command = with_parent([program, "--core", "-p", str(self._port)])
        null = subprocess.DEVNULL
        self._process = subprocess.Popen(
            command, stdin=null, stdout=null, stderr=null, env=self.environment, start_new_session=True
        )
        self.ended = os.pidfd_open(self._process.pid)
        until = time.monotonic() + _MASTER_START_S
        while not self.answers():
            if select.select([self.ended], [], [], 0)[0] or time.monotonic() > until:
                self.close()
                raise RuntimeFaultError(f"{program} does not start at {self.address}")
            time.sleep(_MASTER_LOOK_S)


def forget_node(master: str, node: str, address: str) -> None:
    """Unregister a node that has died and could not do so itself. Raises SilentError."""
    of = peer(master)
    publishers, subscribers, servers = asked(of, node, "getSystemState")
    for method, rows in (("unregisterPublisher", publishers), ("unregisterSubscriber", subscribers)):
        for topic in [topic for topic, nodes in rows if node in nodes]:
            asked(of, node, method, topic, address)
    for service in [service for service, nodes in servers if node in nodes]:
        asked(of, node, "unregisterService", service, asked(of, node, "lookupService", service))
