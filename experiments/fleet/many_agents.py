"""100 agents with 1,000 simulated units: the cost of orders, presence and reviews.

    python experiments/fleet/many_agents.py [--agents 100] [--linked]

Each unit may run on two hosts. The agents are those of cfgplan, all in one process, but their units are simulated: a
unit gets ready, sends a sign of life each second and ends, and no element flows. The manager is linked with each agent
by a socket; with --linked all agents are also linked with each other.
"""

from __future__ import annotations

import argparse
import os
import socket
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any

import psutil
from cfgplan_runtime import Manager, Runtime, SimulatedRuntime
from cfgplan_runtime.children.messages import UnitOrder
from cfgplan_runtime.fleet import agent
from cfgplan_runtime.fleet.fleet_runtime import Fleet, fleet_runtime
from cfgplan_runtime.lifecycle.reports import PHASES, Review
from cfgplan_runtime.lifecycle.seams import DeclaredCosts
from cfgplan_runtime.streams.run_folder import RunFolder
from cfgplan_runtime.supervision.backend import Inlet, Usage
from cfgplan_runtime.supervision.events import Event, UnitDied, UnitReady, UnitStatus, UnitStopped, WireSwitched
from computers import eventually

from cfgplan import api
from cfgplan.domain import (
    ChangeSet,
    ComputationUnit,
    Environment,
    Host,
    InputPort,
    OutputPort,
    Stream,
    Target,
    Transformation,
)

UNITS = 10
"""For each host; each is fed by the one before."""
SIGN_S = 1.0
KILLED = 20
PATIENCE_S = 120.0


class Simulated:
    """An agent with a simulated computer."""

    clock_offset_ns = 0
    code_folder = Path("/")

    def __init__(self, *, base: Path, **_: object) -> None:
        self.run_folder = RunFolder(base)
        self._events: SimpleQueue[Event | None] = SimpleQueue()
        self._started_s: dict[str, float] = {}
        self._sign_s = time.monotonic()
        self._is_over = False

    def end(self) -> None:
        """Make the agent end; may be called from any thread."""
        self._is_over = True
        self.wake()

    def close(self) -> None:
        self.run_folder.close()

    def wake(self) -> None:
        self._events.put(None)

    def wait(self, timeout_s: float) -> Sequence[Event]:
        due_s = self._sign_s + SIGN_S - time.monotonic()
        found = []
        try:
            found.append(self._events.get(timeout=max(0.0, min(timeout_s, due_s))))
            while True:
                found.append(self._events.get_nowait())
        except Empty:
            if self._is_over:
                sys.exit()  # the thread
        if time.monotonic() > self._sign_s + SIGN_S:
            self._sign_s = time.monotonic()
            steps = ((unit, round(100 * (self._sign_s - at_s))) for unit, at_s in self._started_s.items())
            found += [UnitStatus(unit, count, 0, {}, {}) for unit, count in steps]
        return [event for event in found if event is not None]

    def start_unit(self, order: UnitOrder, spare: str | None = None) -> None:  # noqa: ARG002
        self._started_s[order.unit] = time.monotonic()
        self._events.put(UnitReady(order.unit, 1000))

    def stop(self, unit: str) -> None:
        if self._started_s.pop(unit, None) is not None:
            self._events.put(UnitStopped(unit))

    def kill(self, unit: str, *, dump: bool = False) -> None:  # noqa: ARG002
        if self._started_s.pop(unit, None) is not None:
            self._events.put(UnitDied(unit, "killed"))

    def connect(self, wire: int, stream: Stream, inlet: Inlet, **_: object) -> None:  # noqa: ARG002
        self._events.put(WireSwitched(wire))

    def usage(self, unit: str) -> Usage | None:
        at_s = self._started_s.get(unit)
        return None if at_s is None else Usage(round(1e4 * (time.monotonic() - at_s)), 10 << 20)

    def open_relay(self) -> socket.socket:
        self._relay, theirs = socket.socketpair()
        return theirs

    def heard_from_relay(self) -> Sequence[Any]:
        return ()

    def __getattr__(self, _: str) -> Callable[..., None]:
        """All else has no effect."""
        return lambda *_, **__: None


def be_agents(count: int, folder: Path, *, are_linked: bool) -> None:
    """Run all agents until this process is killed. A number on standard input ends the agent with that number."""
    from cfgplan_runtime.processes.nursery import die_with_parent

    die_with_parent(os.getppid())
    agent.ProcessBackend = Simulated  # type: ignore[misc]
    agents = []
    for number, endpoint in enumerate(endpoints(count, folder)):
        runs = folder / f"{number}"
        runs.mkdir()
        connect = endpoints(number, folder) if are_linked else ()
        agents.append(agent.Agent(name_of(number), listen=[endpoint], connect=connect, base=runs))
        threading.Thread(target=agents[-1].run, daemon=True).start()
    print("ready", flush=True)
    for line in sys.stdin:  # until the other end is gone
        agents[int(line)]._backend.end()


def endpoints(count: int, folder: Path) -> list[str]:
    return [f"unixsock-stream/{folder}/a{number}" for number in range(count)]


def name_of(number: int) -> str:
    return f"h{number:03}"


def environment(count: int, places: int = 2) -> Environment:
    """Return an environment with a chain of units to a topic for each host; each unit may run on `places` hosts."""

    def link(host: int, place: int) -> Transformation:
        label = f"t{host}_{place}"
        inputs = (InputPort("x", f"T{host}_{place - 1}"),) if place else ()
        outputs = (OutputPort("y", f"T{host}_{place}", rate_uhz=10_000_000, size_bytes=1000),)
        hosts = tuple(name_of((host + number) % count) for number in range(places))
        one, more = (hosts[0], ()) if places == 1 else (None, hosts)
        return Transformation(label, inputs, outputs, 100_000, 1000, source="simulated:unit", host=one, hosts=more)

    library = tuple(link(host, place) for host in range(count) for place in range(UNITS))
    targets = tuple(Target(f"r{host}", f"T{host}_{UNITS - 1}", f"/r{host}") for host in range(count))
    return Environment((), library, targets, tuple(Host(name_of(host)) for host in range(count)), transfer_us=20_000)


@contextmanager
def agents_of(count: int, folder: Path, *, are_linked: bool) -> Iterator[subprocess.Popen[str]]:
    linked = ["--linked"] if are_linked else []
    command = [sys.executable, __file__, f"--agents={count}", f"--within={folder}", *linked]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            assert process.stdout.readline() == "ready\n"
            yield process
        finally:
            process.kill()


def ms(seconds: float) -> str:
    return f"{1000 * seconds:.1f} ms"


def cost(what: str, process: psutil.Process, seconds: float) -> str:
    """Return a process's share of a core over `seconds`, and its memory, as text after `what`."""
    before = sum(process.cpu_times()[:2])
    time.sleep(seconds)
    busy = (sum(process.cpu_times()[:2]) - before) / seconds
    return f"{what}: {100 * busy:.1f} % of a core, {process.memory_info().rss >> 20} MB"


def reviewed(manager: Manager, perturb: Callable[[], None]) -> list[Review]:
    """Perturb, and return the reviews that follow."""
    known = manager.snapshot().reviews[-1].number
    perturb()
    eventually(lambda: manager.snapshot().reviews[-1].number > known and manager.is_settled, PATIENCE_S)
    return [review for review in manager.snapshot().reviews if review.number > known]


def lose(process: subprocess.Popen[str], number: int) -> None:
    """End the agent with a number."""
    assert process.stdin is not None
    process.stdin.write(f"{number}\n")
    process.stdin.flush()


def told(reviews: Sequence[Review]) -> str:
    """Return the median durations of reviews and of their phases, as text."""
    whole = statistics.median(sum(review.seconds.values()) for review in reviews)
    phases = {phase: statistics.median(review.seconds.get(phase, 0.0) for review in reviews) for phase in PHASES}
    return f"{ms(whole)} ({', '.join(f'{phase} {ms(seconds)}' for phase, seconds in phases.items() if seconds)})"


def orders(runtime: Runtime, count: int) -> None:
    """Print the time to start a unit on one host, and on all hosts."""

    def unit(number: int, host: int) -> ComputationUnit:
        return ComputationUnit(f"alone.{number}", "alone", (), (), name_of(host))

    hosts = tuple(Host(name_of(host)) for host in range(count))
    alone = Transformation("alone", outputs=(OutputPort("y", "Alone"),), source="simulated:unit")
    runtime.apply(ChangeSet(added_transformations=(alone,), added_hosts=hosts))
    took_s = []
    for number in range(count):
        start = time.monotonic()
        runtime.apply(ChangeSet(started=(unit(number, number),)))
        took_s.append(time.monotonic() - start)
    start = time.monotonic()
    runtime.apply(ChangeSet(started=tuple(unit(count + host, host) for host in range(count))))
    print(f"a unit started: {ms(statistics.median(took_s))}; {count} on as many hosts: {ms(time.monotonic() - start)}")
    runtime.apply(ChangeSet(stopped=tuple(f"alone.{number}" for number in range(2 * count))))


def measure(count: int, *, are_linked: bool) -> None:
    world = api.world(environment(count), horizon_s=600)
    in_thought = SimulatedRuntime()
    alone = Manager(world, in_thought, clock=in_thought.clock, estimator=DeclaredCosts())
    alone.run(5.0)
    print(f"first review without a fleet: {told(alone.snapshot().reviews)}", flush=True)
    with tempfile.TemporaryDirectory(prefix="many") as name:
        os.environ["XDG_RUNTIME_DIR"] = name
        folder, me = Path(name), psutil.Process()
        with agents_of(count, folder, are_linked=are_linked) as process:
            agents = psutil.Process(process.pid)
            start = time.monotonic()
            fleet = Fleet(endpoints(count, folder))
            with fleet_runtime(fleet, Environment(hosts=world.environment.hosts), folder) as runtime:
                eventually(lambda: len(runtime.supervisor.hosts) == count and not runtime.supervisor.lost_hosts)
                print(f"all {count} agents there after {time.monotonic() - start:.2f} s")
                print(cost("agents without units", agents, 5.0), cost("manager", me, 5.0), sep="; ", flush=True)
                orders(runtime, count)
                with Manager(world, runtime, estimator=DeclaredCosts()) as manager:
                    manager.settle()
                    print(f"first review, {len(runtime.environment.units)} units: {told(manager.snapshot().reviews)}")
                    print(cost("agents with units", agents, 5.0), cost("manager", me, 5.0), sep="; ", flush=True)
                    reviews = []
                    for number in range(0, KILLED * UNITS, UNITS):
                        killed = runtime.environment.units[number].id
                        reviews += reviewed(manager, lambda killed=killed: runtime.kill(killed))
                    print(f"{KILLED} units killed, a review each: {told(reviews)}")
                    print(f"a host lost: {told(reviewed(manager, lambda: lose(process, count // 2)))}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--agents", type=int, default=100)
    parser.add_argument("--linked", action="store_true", help="link all agents with all")
    parser.add_argument("--within", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.within is not None:
        be_agents(options.agents, options.within, are_linked=options.linked)
    else:
        measure(options.agents, are_linked=options.linked)


if __name__ == "__main__":
    main()
