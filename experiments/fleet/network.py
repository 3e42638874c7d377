"""Computers of a fleet as Linux network namespaces on a bridge, which end with this process.

    with Network(["r1", "r2", "base"]) as network:
        network.start("r1", ["ping", "-c", "1", network.address["base"]]).wait()
        network.cut("r1")

Each namespace is held by a `cat` that reads from this process. When this process ends in any way, the `cat`s end, and
with them the namespaces and their devices. No name is visible outside.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any

SKIPPED = 77
"""The exit code of an experiment where there are no network namespaces."""
_TOOLS = ("unshare", "nsenter", "ip", "bridge", "tc")
_LOSSY_SWITCH = Path(__file__).with_name("lossy_switch.py")
_FORWARDS, _IS_DISABLED = "3", "0"


class Network:
    """Named hosts in network namespaces, each with an `address`; a context manager. Raises NotAllowedError without
    namespaces.
    """

    def __init__(self, hosts: Sequence[str]) -> None:
        self.address = {host: f"10.77.0.{number}" for number, host in enumerate(hosts, 1)}
        self._stack, self._cut_loudly = ExitStack(), set[str]()
        with ExitStack() as stack:
            missing = [tool for tool in _TOOLS if shutil.which(tool) is None]
            if missing:
                raise NotAllowedError(f"not installed: {', '.join(missing)}")
            # Who is not root is it in a user namespace of its own.
            is_root = os.geteuid() == 0
            self._rights = [] if is_root else ["--user", "--preserve-credentials"]
            mapped = [] if is_root else ["--user", "--map-root-user"]
            self._switch = stack.enter_context(_namespace(["unshare", *mapped, "--net"]))
            self._in("switch", "ip", "link", "add", "bridge", "type", "bridge")
            self._in("switch", "ip", "link", "set", "bridge", "up")
            self._pids: dict[str, str] = {}
            for host, address in self.address.items():
                self._pids[host] = stack.enter_context(_namespace([*self._enter("switch"), "unshare", "--net"]))
                self._in("switch", "ip", "link", "add", host, "type", "veth", "peer", "eth0", "netns", self._pids[host])
                self._in("switch", "ip", "link", "set", host, "master", "bridge", "up")
                self._in(host, "ip", "address", "add", f"{address}/24", "dev", "eth0")
                for device in ("lo", "eth0"):
                    self._in(host, "ip", "link", "set", device, "up")
            self._stack = stack.pop_all()

    @property
    def token(self) -> str:
        """The argument with which another process calls `joined`."""
        return json.dumps([self.address, self._pids, self._switch])

    @classmethod
    def joined(cls, token: str) -> Network:
        """Return the network that another process made, in a process on one of its hosts."""
        network = cls.__new__(cls)
        network.address, network._pids, network._switch = json.loads(token)
        network._rights, network._stack, network._cut_loudly = [], ExitStack(), set()
        return network

    def start(self, host: str, command: Sequence[str], **options: Any) -> subprocess.Popen[str]:
        """Start a command on a host; the caller ends it. Options are those of Popen."""
        environment: Mapping[str, str] = options.pop("env", os.environ)
        return subprocess.Popen([*self._enter(host), *command], env=environment, text=True, **options)

    def cut(self, host: str, *, loudly: bool = False) -> None:
        """Block all traffic to and from a host. With `loudly` the host sees that its cable is gone."""
        if loudly:
            self._cut_loudly.add(host)
            self._in("switch", "ip", "link", "set", host, "down")
        else:
            self._in("switch", "bridge", "link", "set", "dev", host, "state", _IS_DISABLED)

    def mend(self, host: str) -> None:
        """Undo `cut`."""
        if host in self._cut_loudly:
            # It forwards once its cable is there, which may be a moment later.
            self._cut_loudly.discard(host)
            self._in("switch", "ip", "link", "set", host, "up")
        else:
            self._in("switch", "bridge", "link", "set", "dev", host, "state", _FORWARDS)

    def limit(self, host: str, mbit_s: float) -> None:
        """Limit the traffic to a host and from it to `mbit_s` megabits per second each."""
        rate = ["tbf", "rate", f"{mbit_s}mbit", "burst", "32kb", "latency", "50ms"]
        self._in("switch", "tc", "qdisc", "replace", "dev", host, "root", *rate)
        self._in(host, "tc", "qdisc", "replace", "dev", "eth0", "root", *rate)

    def unlimit(self, host: str) -> None:
        """Undo `limit`."""
        self._in("switch", "tc", "qdisc", "delete", "dev", host, "root")
        self._in(host, "tc", "qdisc", "delete", "dev", "eth0", "root")

    @contextmanager
    def lossy(self, loss: float, delay_s: float) -> Iterator[None]:
        """Let a switch in user space lose the share `loss` of all frames, and delay the others by `delay_s` one way."""
        line = [*self._enter("switch"), sys.executable, str(_LOSSY_SWITCH), str(loss), str(delay_s), *self.address]
        for host in self.address:
            self._in(host, sys.executable, str(_LOSSY_SWITCH), "plain", "eth0")
        with subprocess.Popen(line, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as switch:
            assert switch.stdout is not None and switch.stdin is not None
            assert switch.stdout.readline() == "ready\n"
            self._set_all("nomaster", "promisc", "on")
            try:
                yield
            finally:
                self._set_all("promisc", "off", "master", "bridge")
                switch.stdin.close()

    def _set_all(self, *words: str) -> None:
        """Set all devices of the switch at one moment: a busy computer takes seconds for one command each."""
        lines = "\n".join(" ".join(["link", "set", host, *words]) for host in self.address)
        self._in("switch", "sh", "-c", f"ip -batch - <<END\n{lines}\nEND")

    def __enter__(self) -> Network:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()

    def _enter(self, place: str) -> list[str]:
        pid = self._switch if place == "switch" else self._pids[place]
        return ["nsenter", "--target", pid, *self._rights, "--net"]

    def _in(self, place: str, *command: str) -> None:
        done = subprocess.run([*self._enter(place), *command], capture_output=True, text=True, check=False)
        if done.returncode:
            raise NotAllowedError(f"{' '.join(command)}: {done.stderr.strip()}")


class NotAllowedError(Exception):
    """Raised if this system allows no network namespaces; the message has the reason."""


def run_within(hosts: Sequence[str], token: str | None, work: Callable[[Network], bool | None]) -> int:
    """Run `work` on the first host of a network of `hosts`.

    Without a token: make the network, and run this command again on its first host with the option `--within=TOKEN`.
    Returns that command's exit code, or SKIPPED.

    With the token: call `work` with the network. Returns 1 if it returns False, otherwise 0.
    """
    if token is not None:
        from cfgplan_runtime.processes.nursery import die_with_parent

        die_with_parent(os.getppid())
        return int(work(Network.joined(token)) is False)
    try:
        network = Network(hosts)
    except NotAllowedError as error:
        print(f"no network namespaces: {error}")
        return SKIPPED
    with network:
        return network.start(hosts[0], [sys.executable, *sys.argv, f"--within={network.token}"]).wait()


@contextmanager
def _namespace(command: Sequence[str]) -> Iterator[str]:
    """The process id of a process in the namespace that a command makes."""
    echo = ["sh", "-c", "echo $$; exec cat >/dev/null"]
    made = subprocess.Popen(
        [*command, *echo], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    with made:
        assert made.stdout is not None and made.stderr is not None
        said = made.stdout.readline().strip()
        if not said:
            raise NotAllowedError(f"{' '.join(command)}: {made.stderr.read().strip()}")
        yield said
