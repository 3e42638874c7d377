"""A fleet on this computer: agents r1, r2, ..., a runtime that uses them, and what comes out on its topic."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import psutil
from cfgplan_runtime import NoSuchTopicError, Received, Runtime, subscribe
from cfgplan_runtime.fleet.fleet_backend import FleetBackend
from cfgplan_runtime.fleet.fleet_runtime import linked
from cfgplan_runtime.fleet.local import LocalAgents
from cfgplan_runtime.streams.run_folder import RunFolder, base_folder, remove_dead_runs
from cfgplan_runtime.streams.subscription import RunPlace, SubscriptionToTopic
from cfgplan_runtime.supervision.events import Event
from warm_python import warm_subprocess

from cfgplan.domain import (
    ChangeSet,
    ComputationUnit,
    Host,
    InputPort,
    OutputPort,
    Publication,
    RunOptions,
    Stream,
    Subscription,
    Target,
    Transformation,
)

PATIENCE_S = 120.0
"""Far longer than anything takes on the slowest machine."""
FOLDER = Path(__file__).parent
RESULT = Target("result", "Y", "/result", host="r1")


def source(
    label: str = "count", code: str = "count", *, rate_hz: float | None = 200, **params: object
) -> Transformation:
    run = RunOptions(rate_hz=rate_hz)
    return Transformation(
        label, outputs=(OutputPort("n", "N"),), source=f"fleet_units.py:{code}", params=params, run=run
    )


def worker(label: str = "work", code: str = "same", *, run: RunOptions | None = None) -> Transformation:
    ports = (InputPort("x", "N"),), (OutputPort("y", "Y"),)
    return Transformation(label, *ports, source=f"fleet_units.py:{code}", run=run or RunOptions())


def unit(unit_id: str, host: str | None, *, topic: str | None = None, x: str | None = None) -> ComputationUnit:
    """A unit `label.N`; `x="count.1/n"` feeds its input."""
    feeds = () if x is None else fed_by(x)
    published = () if topic is None else (Publication("n" if x is None else "y", topic),)
    return ComputationUnit(unit_id, unit_id.rpartition(".")[0], feeds, published, host)


def cold(unit_id: str, host: str) -> ComputationUnit:
    """A cold spare `label.N`."""
    return ComputationUnit(unit_id, unit_id.rpartition(".")[0], host=host, standby=True)


def fed_by(*streams: str) -> tuple[Subscription, ...]:
    """The subscriptions of a worker."""
    return tuple(Subscription("x", Stream.parse(stream)) for stream in streams)


def swap(old: ComputationUnit, new: ComputationUnit, *rewired: ComputationUnit) -> ChangeSet:
    return ChangeSet(started=(new,), rewired=rewired, stopped=(old.id,))


class SmallFleet:
    """Agents of this computer and a runtime of theirs."""

    def __init__(self, agents: LocalAgents, run: RunFolder) -> None:
        self.agents = agents
        self.endpoints = agents.endpoints
        self.run = run

    @contextmanager
    def runtime(
        self,
        *library: Transformation,
        hosts: Sequence[str] = (),
        wait_s: float = PATIENCE_S,
        takes_over: bool = False,
    ) -> Iterator[Runtime]:
        named = tuple(hosts or self.agents.processes)
        everywhere = tuple(Host(name) for name in named)
        with closing(RunFolder()) as run, closing(linked(self.endpoints, None, wait_s)) as link:
            known = {one.label: one for one in library}
            more = {"folder": FOLDER, "library": known, "wait_s": wait_s, "takes_over": takes_over}
            with Runtime(backend=partial(FleetBackend, named, run, link, **more)) as runtime:
                targets = (RESULT,) if RESULT.host in named else ()
                runtime.apply(ChangeSet(added_transformations=library, added_targets=targets, added_hosts=everywhere))
                yield runtime

    @contextmanager
    def backend(
        self,
        *hosts: str,
        folder: Path = FOLDER,
        takes_over: bool = False,
        wait_s: float = PATIENCE_S,
        library: Sequence[Transformation] = (),
    ) -> Iterator[FleetBackend]:
        with closing(RunFolder()) as run, closing(linked(self.endpoints, None, wait_s)) as link:
            known = {one.label: one for one in library}
            more = {"folder": folder, "library": known, "takes_over": takes_over, "wait_s": wait_s}
            backend = FleetBackend(hosts, run, link, **more)
            backend.found()
            backend.take_hosts(())  # which sends the orders that end the rest
            yield backend
            backend.close()

    @contextmanager
    def other_manager(self, behind_ns: int = 0) -> Iterator[subprocess.Popen[bytes]]:
        """Another process that manages the hosts: it runs count.1 on r1 and work.1 on r2, which is published.

        It has the cold spare work.9 on r1. Its clock is behind.
        """
        code, hosts = "import other_manager; other_manager.main()", ",".join(self.agents.processes)
        line = [sys.executable, "-c", code, str(behind_ns), hosts, *self.endpoints]
        with warm_subprocess("other_manager").Popen(line, stdout=subprocess.PIPE) as process:
            assert process.stdout is not None
            try:
                assert process.stdout.readline() == b"applied\n"
                yield process
            finally:
                process.kill()
        remove_dead_runs(base_folder())

    def outside_listener(self, host: str, topic: str = "/result") -> Listener:
        """Who listens to a host's topic whatever manager there is."""
        number = list(self.agents.processes).index(host)
        (run,) = (self.run.path / str(number)).iterdir()
        return Listener(SubscriptionToTopic(topic, RunPlace(run), timeout_s=PATIENCE_S))

    def units(self) -> list[str]:
        """The units that really run, on all hosts."""
        return [words[2] for words, _ in self._children() if len(words) == 3 and words[2] not in ("nursery", "outlets")]

    def pids(self, label: str) -> list[int]:
        """The processes of a transformation's units, on all hosts."""
        return [pid for words, pid in self._children() if len(words) == 3 and words[2].startswith(f"{label}.")]

    def spares(self) -> dict[str, int]:
        """The cold spares that are prepared, or being prepared, on all hosts, and their processes."""
        return {words[3]: pid for words, pid in self._children() if words[2:3] == ["spare"]}

    def _children(self) -> Iterator[tuple[list[str], int]]:
        """What the agents' processes are called, in words, and their ids."""
        for agent in self.agents.processes.values():
            if agent.poll() is not None:
                continue
            for child in psutil.Process(agent.pid).children(recursive=True):
                with suppress(psutil.Error):  # it has just ended
                    yield " ".join(child.cmdline()).split(), child.pid


@contextmanager
def small_fleet(*hosts: str) -> Iterator[SmallFleet]:
    run = RunFolder()
    try:
        with LocalAgents(hosts, run.path, folder=FOLDER) as agents:
            yield SmallFleet(agents, run)
    finally:
        run.close()


class Listener:
    """Collects what comes on a topic of a run, in a thread."""

    def __init__(self, source: Runtime | SubscriptionToTopic, topic: str = "/result") -> None:
        self.received: list[Received] = []
        is_run = isinstance(source, Runtime)
        self.subscription = subscribe(topic, run=source.id, wait_s=PATIENCE_S) if is_run else source
        self._thread = threading.Thread(target=self._collect, daemon=True)
        self._thread.start()

    @property
    def values(self) -> list[Any]:
        return [received.value for received in self.received]

    def await_more(self, count: int) -> None:
        """Wait for so many more elements."""
        wanted = len(self.received) + count
        eventually(lambda: len(self.received) >= wanted)

    def close(self) -> None:
        self.subscription.close()

    def _collect(self) -> None:
        for received in self.subscription:
            self.received.append(received)


def eventually(is_so: Callable[[], bool]) -> None:
    """Wait until something is so; fails if it never is."""
    deadline = time.monotonic() + PATIENCE_S
    while not is_so():
        assert time.monotonic() < deadline, "it never came to be"
        time.sleep(0.01)


def gives(topic: str, run: str) -> bool:
    """Whether an element of a run comes on a topic within a second."""
    with suppress(NoSuchTopicError, TimeoutError), subscribe(topic, run=run, timeout_s=1.0) as subscription:
        return next(iter(subscription), None) is not None
    return False


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as free:
        return int(free.getsockname()[1])


def seen(runtime: Runtime, kind: type[Event]) -> list[Any]:
    """The events of a kind that a runtime has reported so far; they stay to be seen."""
    return [event for event in list(runtime.events.queue) if isinstance(event, kind)]


def kill_unit(runtime: Runtime, name: str) -> None:
    """Kill a unit's process as something else would."""
    eventually(lambda: runtime.pid(name) is not None)
    pid = runtime.pid(name)
    assert pid, f"{name} has no process"
    os.kill(pid, 9)


def moved(one: ComputationUnit, unit_id: str, host: str) -> ComputationUnit:
    return replace(one, id=unit_id, host=host)
