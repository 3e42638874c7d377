"""A fleet on one computer: an agent for each host, linked by sockets in a folder that only its user can enter."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

from cfgplan_runtime.processes.cpu_group import CpuGroup
from cfgplan_runtime.streams.closable import Closable

_AGENT_CODE = "from cfgplan_runtime.fleet.local import main; main()"
_AGENT_CLOSE_S = 5.0


class LocalAgents(Closable):
    """Agents of hosts on this computer; they end with the thread that made them. A context manager.

    Their sockets are in `run`, the folder of the run. Sources such as `units.py:Class` are relative to `folder`. The
    units of a host in `cpu` are put in its group.
    """

    def __init__(
        self,
        hosts: Sequence[str],
        run: Path,
        *,
        folder: Path,
        preload: Sequence[str] = (),
        cpu: Mapping[str, CpuGroup] = MappingProxyType({}),
    ) -> None:
        self.endpoints = [f"unixsock-stream/{run}/a{number}" for number in range(len(hosts))]
        self.processes: dict[str, subprocess.Popen[bytes]] = {}
        try:
            for number, host in enumerate(hosts):
                runs = run / f"{number}"
                runs.mkdir(mode=0o700)
                arguments = [str(os.getpid()), host, str(folder), str(runs), self.endpoints[number]]
                group = str(cpu[host].path) if host in cpu else ""
                more = [",".join(self.endpoints[:number]), ",".join(preload), group]
                # In a session of its own it does not get Ctrl-C: the command does, and stops units in order.
                self.processes[host] = subprocess.Popen(
                    [sys.executable, "-c", _AGENT_CODE, *arguments, *more],
                    stdin=subprocess.DEVNULL,
                    start_new_session=True,
                )
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """End all agents and their units."""
        for process in self.processes.values():
            process.terminate()
        for process in self.processes.values():
            try:
                process.wait(_AGENT_CLOSE_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def main() -> None:
    """Run as an agent that ends with the process that has started it."""
    from cfgplan_runtime.fleet.agent import Agent
    from cfgplan_runtime.processes.nursery import die_with_parent

    parent, host, folder, base, listen, connect, preload, group = sys.argv[1:]
    die_with_parent(int(parent))
    signal.signal(signal.SIGTERM, lambda *_: sys.exit())
    agent = Agent(
        host,
        listen=[listen],
        connect=connect.split(",") if connect else [],
        folder=Path(folder),
        preload=preload.split(",") if preload else [],
        base=Path(base),
        cpu=CpuGroup(Path(group)) if group else None,
    )
    agent.run()
