"""A fleet of three network namespaces as computers, for experiments: its agents, and listeners to its topics."""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import psutil
from network import Network

if TYPE_CHECKING:
    from cfgplan_runtime.streams.subscription import SubscriptionToTopic

    from cfgplan.domain import Environment

HOSTS = ("base", "r1", "r2")
UNITS = Path(__file__).parents[1] / "runtime"
RATE_HZ = 200
QUEUE = 4096
"""The elements that may wait at a relay: a busy computer stops it for seconds, and what is lost then says nothing."""
SOME = 600
"""The elements of a source that ends."""
SLOW_LINKS = {"05": (500_000, 0.6, 5.0), "2": (2_000_000, 2.0, 50.0), "10": (10_000_000, 0.4, 50.0)}
"""By label: bytes of an element, how many a second, and the Mbit/s of a link that they fit."""
PATIENCE_S = 120.0
HELPERS = ("nursery", "outlets")

_COMMAND = """
import sys, time
from cfgplan_runtime.fleet import links
from cfgplan_runtime.processes.nursery import die_with_parent
links.LEASE_S, links._refuse_strangers = float(sys.argv.pop(1)), lambda _: None
die_with_parent(int(sys.argv.pop(1)))
ahead_ns, real = int(sys.argv.pop(1)), time.time_ns
time.time_ns = lambda: real() + ahead_ns
from cfgplan.cli import main
sys.exit(main())
"""


class Manager(NamedTuple):
    """A run in a separate process; `said` is the file with its output."""

    process: subprocess.Popen[str]
    said: Path

    def await_review(self) -> None:
        """Wait until its first review is over."""
        self.await_text("Running 2 units")

    def await_text(self, text: str) -> float:
        """Wait until it has printed a text; returns the seconds that it took."""
        return eventually(lambda: text in self.said.read_text())


class Fleet:
    """Agents on all hosts of a network, started by commands; a context manager.

    `secrets` is the folder of their certificates, `units` that of their code. Without `is_secured` they use no
    certificates, which beyond loopback only this experiment allows.
    """

    def __init__(
        self,
        network: Network,
        secrets: Path,
        *,
        lease_s: float = 2.0,
        is_secured: bool = True,
        hosts: Sequence[str] = HOSTS,
        units: Path = UNITS,
    ) -> None:
        from cfgplan_runtime.fleet import links

        links.LEASE_S = lease_s
        self.hosts, self._units = tuple(hosts), units
        self._is_secured = is_secured
        self.network = network
        self.lease_s = lease_s
        self.folder = secrets.parent
        self._secrets = secrets
        self.endpoints = {host: f"{'tls' if is_secured else 'tcp'}/{network.address[host]}:7447" for host in hosts}
        self.agents: dict[str, subprocess.Popen[str]] = {}
        self._managers = 0
        for host in self.hosts:
            self.start_agent(host)
        self._await_agents()

    def _await_agents(self) -> None:
        for host in self.hosts:
            eventually(lambda host=host: "listens on" in self.said(host))

    def start_agent(self, host: str, *, ahead_ns: int = 0) -> None:
        """Start a host's agent, its clock ahead by `ahead_ns`. Each link is named at one end only: see the runtime's
        README.
        """
        others = [f"--connect={self.endpoints[other]}" for other in self.hosts[: self.hosts.index(host)]]
        arguments = ["agent", f"--name={host}", f"--listen={self.endpoints[host]}", *others, f"--folder={self._units}"]
        self.agents[host] = self._start(host, arguments, self._secrets / host, self._base(host), ahead_ns=ahead_ns)

    @contextlib.contextmanager
    def manager(self, host: str, environment: Path) -> Iterator[Manager]:
        """Run `cfgplan run --take-over` on a host; it is killed at the end if it still runs."""
        self._managers += 1
        base = self._base(f"manager-{self._managers}")
        connect = [f"--connect={endpoint}" for endpoint in self.endpoints.values()]
        arguments = ["run", str(environment), "--take-over", "--plain", "--no-estimates", *connect]
        with self._start(host, arguments, self._secrets / "manager", base) as process:
            try:
                yield Manager(process, base / "said")
            finally:
                process.kill()

    @contextlib.contextmanager
    def twin(self, name: str, host: str) -> Iterator[tuple[subprocess.Popen[str], Path]]:
        """Run a second agent with the name of another on a host; yields its process and the file with its output."""
        base, listen = self._base(f"twin-{name}"), f"--listen=tls/{self.network.address[host]}:7448"
        others = [f"--connect={endpoint}" for endpoint in self.endpoints.values()]
        arguments = ["agent", f"--name={name}", listen, *others, f"--folder={self._units}"]
        with self._start(host, arguments, self._secrets / name, base) as process:
            try:
                yield process, base / "said"
            finally:
                process.kill()

    def renew_certificate(self, host: str) -> None:
        """Replace a host's certificate."""
        from cfgplan_runtime.fleet.certificates import make

        shutil.rmtree(self._secrets / host)
        make(self._secrets, {host: [self.network.address[host]]}, days=1)

    def said(self, host: str) -> str:
        """Return the output of a host's agent."""
        return (self._base(host) / "said").read_text()

    @contextlib.contextmanager
    def operated(self, environment: Environment, folder: Path) -> Iterator[Any]:
        """Yield a runtime of this fleet for an operation on an environment."""
        from cfgplan_runtime.fleet import fleet_runtime

        secured = self._secrets / "manager" if self._is_secured else None
        reached = fleet_runtime.Fleet(tuple(self.endpoints.values()), secured, takes_over=True)
        with fleet_runtime.fleet_runtime(reached, environment, folder) as runtime:
            yield runtime

    def run_folder(self, host: str) -> Path:
        """Return the folder of the topics at a host."""
        from cfgplan_runtime.streams.run_folder import is_alive

        return next(run for run in (self._base(host) / "cfgplan").iterdir() if is_alive(run))

    def units(self, host: str) -> dict[str, int]:
        """Return the process ids of the units that run on a host, by unit, as its process list has them."""
        return {name: pid for name, pid in self._processes(host).items() if name not in HELPERS}

    def helpers(self, host: str) -> dict[str, int]:
        """Return the process ids of an agent's processes other than units, by title."""
        return {name: pid for name, pid in self._processes(host).items() if name in HELPERS}

    def _processes(self, host: str) -> dict[str, int]:
        found = {}
        with contextlib.suppress(psutil.NoSuchProcess):  # a killed agent has none
            for child in psutil.Process(self.agents[host].pid).children(recursive=True):
                with contextlib.suppress(psutil.Error):  # it has just ended
                    words = " ".join(child.cmdline()).split()
                    if len(words) == 3:
                        found[words[2]] = child.pid
        return found

    def _base(self, name: str) -> Path:
        return self._secrets / f"runs-{name}"

    def _start(
        self, host: str, arguments: list[str], certificates: Path, base: Path, *, ahead_ns: int = 0
    ) -> subprocess.Popen[str]:
        """Start a command of cfgplan; its output goes to the file `said` of its folder of runs."""
        command = [sys.executable, "-c", _COMMAND, str(self.lease_s), str(os.getpid()), str(ahead_ns), *arguments]
        secured = [f"--certificates={certificates}"] if self._is_secured else []
        base.mkdir(exist_ok=True)
        said = base / "said"
        said.unlink(missing_ok=True)
        bad = str(self.folder / f"bad-{host}")
        environment = {**os.environ, "XDG_RUNTIME_DIR": str(base), "CFGPLAN_SOAK_BAD": bad}
        with said.open("w") as output:
            return self.network.start(
                host, [*command, *secured], env=environment, stdout=output, stderr=subprocess.STDOUT
            )

    def restart(self, host: str | None = None, *, ahead_ns: int = 0) -> None:
        """Restart a host's agent; without a host, all agents that have ended."""
        for name in self.hosts if host is None else (host,):
            if host is not None:
                self.kill_agent(name)
            if self.agents[name].poll() is not None:
                self.start_agent(name, ahead_ns=ahead_ns)
        self._await_agents()

    def kill_agent(self, host: str) -> None:
        """Kill a host's agent by SIGKILL, as in a crash."""
        agent = self.agents[host]
        agent.kill()
        agent.wait()

    @contextlib.contextmanager
    def runtime(self, *, is_empty: bool = False) -> Iterator[Any]:
        """Yield a runtime of this fleet with its library, targets and hosts, or with none of them if `is_empty`."""
        from cfgplan_runtime.fleet import fleet_runtime

        from cfgplan.domain import ChangeSet, Environment, Host
        from cfgplan.errors import InputError

        hosts = tuple(Host(name) for name in HOSTS)
        secured = self._secrets / "manager" if self._is_secured else None
        reached = fleet_runtime.Fleet(tuple(self.endpoints.values()), secured, takes_over=True)
        with contextlib.ExitStack() as stack:
            runtime: Any = None

            def took_over() -> bool:
                nonlocal runtime
                with contextlib.suppress(InputError):  # most agents are starting, or were cut off until now
                    runtime = stack.enter_context(fleet_runtime.fleet_runtime(reached, Environment(hosts=hosts), UNITS))
                return runtime is not None

            eventually(took_over)
            eventually(lambda: not runtime.supervisor.lost_hosts)
            if not is_empty:
                runtime.apply(ChangeSet(added_transformations=library(), added_targets=targets(), added_hosts=hosts))
            yield runtime

    def __enter__(self) -> Fleet:
        return self

    def __exit__(self, *_: object) -> None:
        for agent in self.agents.values():
            agent.terminate()
        for agent in self.agents.values():
            try:
                agent.wait(PATIENCE_S)
            except subprocess.TimeoutExpired:
                agent.kill()
                agent.wait()


def library() -> tuple[Any, ...]:
    """Return transformations: numbers at 200 Hz (endless or limited), images of 460 kB at 40 Hz, larger ones, and a
    relay.
    """
    from cfgplan.domain import InputPort, OutputPort, RunOptions, Transformation

    def source(label: str, rate_hz: float, code: str = "", **params: int) -> Transformation:
        code, run = f"measured_units.py:{code or label}", RunOptions(rate_hz=rate_hz)
        return Transformation(label, outputs=(OutputPort("n", "N"),), source=code, params=params, run=run)

    ports = (InputPort("x", "N"),), (OutputPort("n", "Y"),)
    return (
        source("count", RATE_HZ),
        source("some", RATE_HZ, number=SOME),
        source("images", 40),
        *(source(f"large{mb}", hz, "large", size=size) for mb, (size, hz, _) in SLOW_LINKS.items()),
        Transformation("same", *ports, source="measured_units.py:same", run=RunOptions(queue=QUEUE)),
    )


def targets() -> tuple[Any, ...]:
    """Return targets for two topics at the base."""
    from cfgplan.domain import Target

    return Target("result", "Y", "/result", host="base"), Target("images", "Y", "/images", host="base")


def unit(name: str, host: str, *, x: str | None = None, topic: str | None = None) -> Any:
    """Return a unit on a host; `name` has the form `transformation.N`."""
    from cfgplan.domain import ComputationUnit, Publication, Stream, Subscription

    feeds = () if x is None else (Subscription("x", Stream.parse(x)),)
    published = () if topic is None else (Publication("n", topic),)
    return ComputationUnit(name, name.partition(".")[0], feeds, published, host)


class Listener:
    """Collects the elements on a topic with their arrival times until the run ends.

    The run is given by its id, or by a host's folder.
    """

    def __init__(self, run: str | Path, topic: str = "/result", *, number: Callable[[Any], Any] = int) -> None:
        from cfgplan_runtime import subscribe
        from cfgplan_runtime.streams.subscription import RunPlace, SubscriptionToTopic

        self.values: list[Any] = []
        self.times_ns: list[int] = []
        self._number = number
        self.at_s: list[float] = []
        subscription = (
            subscribe(topic, run=run, wait_s=PATIENCE_S)
            if isinstance(run, str)
            else SubscriptionToTopic(topic, RunPlace(run), timeout_s=PATIENCE_S)
        )
        threading.Thread(target=self._collect, args=(subscription,), daemon=True).start()

    def _collect(self, subscription: SubscriptionToTopic) -> None:
        for received in subscription:
            self.values.append(self._number(received.value))
            self.times_ns.append(received.time_ns)
            self.at_s.append(time.monotonic())

    def await_more(self, more: int = 20) -> None:
        """Wait for `more` further elements."""
        wanted = len(self.values) + more
        eventually(lambda: len(self.values) >= wanted)

    def wrong(self) -> int:
        """Return the number of elements that were lost, repeated or out of order."""
        values = list(self.values)
        return sum(1 if after <= before else after - before - 1 for before, after in pairwise(values))

    def silence_s(self, since_s: float = 0.0) -> float:
        """Return the longest time between two elements since a moment, in seconds."""
        times = [since_s, *(at_s for at_s in list(self.at_s) if at_s > since_s)] if since_s else list(self.at_s)
        return max((after - before for before, after in pairwise(times)), default=float("inf"))


def eventually(is_so: Callable[[], bool], patience_s: float = PATIENCE_S) -> float:
    """Wait until `is_so()` is true; returns the seconds that it took. Raises TimeoutError after `patience_s`."""
    start = time.monotonic()
    while not is_so():
        if time.monotonic() > start + patience_s:
            raise TimeoutError("it never came to be")
        time.sleep(0.002)
    return time.monotonic() - start


def events(runtime: Any, kind: str) -> list[Any]:
    """Return the events of a kind that a runtime has reported so far."""
    return [event for event in list(runtime.events.queue) if type(event).__name__ == kind]


@contextlib.contextmanager
def stream(fleet: Fleet, *hosts: str) -> Iterator[tuple[Any, Listener]]:
    """Run a stream of numbers from the first host through the second to a topic at the base; yields runtime and
    listener.
    """
    from cfgplan.domain import ChangeSet

    with fleet.runtime() as runtime:
        units = unit("count.1", hosts[0]), unit("same.1", hosts[1], x="count.1/n", topic="/result")
        runtime.apply(ChangeSet(started=units))
        listener = Listener(runtime.id)
        listener.await_more()
        yield runtime, listener
