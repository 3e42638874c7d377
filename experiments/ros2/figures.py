"""The cost of changes and crashes with units as processes, nodes of ROS 1 and nodes of ROS 2, and of ROS 2's relay.

    CFGPLAN_ROS_PYTHON=ros/bin/python python experiments/ros2/figures.py [--rounds 5] [--short]

In each round, one after the other: a worker between a source of 100 Hz and a topic is started, connected to another
source, and killed by `kill -9`; it is replaced from nothing, by a prepared spare, and by one that runs. The helper of
ROS 2 is killed too. Then messages of several sizes go from a node to another, directly and through the relay, in turns.
Needs rclpy, and ROS 1 for its column; without it the column is left out.
"""

from __future__ import annotations

import argparse
import os
import queue
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack
from itertools import pairwise
from pathlib import Path

import psutil
from cfgplan_runtime.processes.child_process import cpu_us
from cfgplan_runtime.ros2.fast_dds import FastDdsProfiles
from cfgplan_runtime.ros2.ros_python import ros_python
from cfgplan_runtime.supervision.events import Event, SparePrepared, UnitDied, UnitPrinted, UnitStatus

from cfgplan.domain import ChangeSet, ComputationUnit, InputPort, OutputPort, Stream, Subscription, Transformation

sys.path.append(str(Path(__file__).parents[2]))
from experiments.workers import (
    IMAGE,
    PATIENCE_S,
    PROCESSES,
    ROS1,
    ROS2,
    SOURCES,
    TOPIC,
    arrivals,
    eventually,
    heard,
    library,
    ros1_of_its_own,
    runtime_of,
    worker,
)

HERE = Path(__file__).parent
FIGURES = (
    "start: to its first result",
    "rewire: until carried out",
    "rewire: longest time without results",
    "`kill -9`: until `UnitDied`",
    "`kill -9`, another one from nothing",
    "`kill -9`, a process that waits becomes it",
    "`kill -9`, a configured lifecycle node becomes it",
    "`kill -9`, another one runs already",
    "`kill -9` of the helper: longest time without results",
)
START, REWIRE, GAP, DIED, NOTHING, WARM, LIFECYCLE, RUNNING, HELPER = FIGURES
PAYLOADS = {100: 200, 10_000: 100, 1_000_000: 30}
"""Bytes of a message, and messages a second."""
Taken = dict[tuple[str, str], list[float]]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--short", action="store_true", help="one round, and messages of 100 B only")
    options = parser.parse_args()
    for line in report(1 if options.short else options.rounds, [100] if options.short else [*PAYLOADS]):
        print(line, flush=True)


def report(rounds: int, payloads: list[int]) -> Iterator[str]:
    """Yield the lines of both tables."""
    taken: Taken = {}
    with ExitStack() as stack:
        kinds = [PROCESSES, ROS1, ROS2] if stack.enter_context(ros1_of_its_own()) else [PROCESSES, ROS2]
        for _ in range(rounds):
            for kind in kinds:
                for name, seconds in figures(kind).items():
                    taken.setdefault((kind, name), []).append(seconds)
    yield f"load {os.getloadavg()[0]:.1f}; ms, medians of {rounds} (range)"
    yield f"| what | {' | '.join(kinds)} |"
    yield f"|---{'|---' * len(kinds)}|"
    for name in FIGURES:
        yield f"| {name} | {' | '.join(shown(taken.get((kind, name), [])) for kind in kinds)} |"
    yield ""
    yield "| payload | latency directly, median / p99 | through the relay | CPU of the relay a message |"
    yield "|---|---|---|---|"
    for size in payloads:
        direct, relayed, relay_us = latencies(size, PAYLOADS[size], rounds)
        yield f"| {size} B at {PAYLOADS[size]} Hz | {pair(direct)} | {pair(relayed)} | {relay_us / 1e3:.2f} ms |"
    yield f"load {os.getloadavg()[0]:.1f} at the end"


def shown(seconds: list[float]) -> str:
    if not seconds:
        return "-"
    return f"{statistics.median(seconds) * 1e3:.0f} ({min(seconds) * 1e3:.0f} to {max(seconds) * 1e3:.0f})"


def pair(ages_us: tuple[float, float]) -> str:
    return f"{ages_us[0] / 1e3:.2f} / {ages_us[1] / 1e3:.1f} ms"


# Changes and crashes.


def figures(kind: str) -> dict[str, float]:
    """Measure one round of a kind, in seconds by name."""
    found = changes(kind)
    found[DIED], found[NOTHING] = crash(kind)
    _, found[RUNNING] = crash(kind, runs_beside=True)
    if kind != ROS1:
        _, found[WARM] = crash(kind, is_prepared=True)
    if kind == ROS2:
        _, found[LIFECYCLE] = crash(kind, is_prepared=True, code="prepared")
        found[HELPER] = loss_of_helper()
    return found


def changes(kind: str) -> dict[str, float]:
    """Measure a start, and a switch to another source."""
    with runtime_of(kind) as runtime:
        runtime.apply(ChangeSet(SOURCES, added_transformations=library(kind), added_targets=(TOPIC,)))
        with ExitStack() as stack:
            came = stack.enter_context(arrivals(kind, runtime)) if kind != ROS1 else []
            began_s = time.monotonic()
            runtime.apply(ChangeSet((worker(),)))
            if kind == ROS1:  # its topic is not to be found before
                came = stack.enter_context(arrivals(kind, runtime))
            eventually(lambda: len(came) > 0)
            started_s = came[0] - began_s
            eventually(lambda: len(came) > 50)
            at, began_s = len(came) - 1, time.monotonic()
            runtime.apply(ChangeSet(rewired=(worker(source="second.1"),)))
            rewired_s = time.monotonic() - began_s
            eventually(lambda: len(came) > at + 100)
            return {START: started_s, REWIRE: rewired_s, GAP: max(b - a for a, b in pairwise(came[at:]))}


def crash(
    kind: str, *, is_prepared: bool = False, runs_beside: bool = False, code: str = "worker"
) -> tuple[float, float]:
    """Measure the seconds from a worker's death to its event, and to the first result of the next worker."""
    is_warm = kind == ROS2 and is_prepared and code == "worker"
    transformations = library(kind, code=code, standby_us=1 if is_prepared else None)
    with runtime_of(kind) as runtime:
        events: queue.SimpleQueue[Event] = queue.SimpleQueue()
        runtime.listen(events.put)
        died_s: list[float] = []
        runtime.listen(lambda event: died_s.append(time.monotonic()) if isinstance(event, UnitDied) else None)
        beside = (worker(2, publishes=False),) if runs_beside else ()
        spare = (ComputationUnit("work.2", "work", standby=True),) if is_prepared else ()
        started = (SOURCES[0], worker(), *beside)
        runtime.apply(ChangeSet(started, added_transformations=transformations, added_targets=(TOPIC,)))
        with arrivals(kind, runtime) as came:
            eventually(lambda: len(came) > 100)
            if spare:
                runtime.apply(ChangeSet(spare))
                heard(events, SparePrepared)
                time.sleep(2.0 if is_warm else 0.5)  # the graph has to know the process that waits
            pid = runtime.pid("work.1")
            assert pid
            killed_s = time.monotonic()
            os.kill(pid, 9)
            heard(events, UnitDied)
            count = len(came)
            runtime.apply(ChangeSet(rewired=(worker(2),)) if runs_beside else ChangeSet((worker(3),)))
            eventually(lambda: len(came) > count)
            return died_s[0] - killed_s, came[count] - killed_s


def loss_of_helper() -> float:
    """Measure the longest time without results around the death of ROS 2's helper, in seconds. No node may end."""
    with runtime_of(ROS2) as runtime:
        started = (SOURCES[0], worker())
        runtime.apply(ChangeSet(started, added_transformations=library(ROS2), added_targets=(TOPIC,)))
        nodes = [runtime.pid(unit.id) for unit in started]
        with arrivals(ROS2, runtime) as came:
            eventually(lambda: len(came) > 100)
            at, killed_s = len(came) - 1, time.monotonic()
            relay_process().kill()
            eventually(lambda: came[-1] > killed_s + 0.1 and len(came) > at + 200)
            assert nodes == [runtime.pid(unit.id) for unit in started]
            return max(b - a for a, b in pairwise(came[at:]))


def relay_process() -> psutil.Process:
    """The helper of the run in this process."""
    (relay,) = [one for one in psutil.Process().children() if "host/main.py" in " ".join(one.cmdline())]
    return relay


# The relay.


def latencies(size: int, rate: int, rounds: int) -> tuple[tuple[float, float], tuple[float, float], float]:
    """Measure the ages of messages in us, directly and relayed (median and p99 each), and the relay's CPU in us."""
    number = rate * 5
    seen: dict[bool, list[tuple[float, float]]] = {False: [], True: []}
    cost = []
    for _ in range(rounds):
        seen[False].append(direct(size, rate, number))
        ages, relay_us = relayed(size, rate, number)
        seen[True].append(ages)
        cost.append(relay_us)
    by_way = {way: tuple(map(statistics.median, zip(*ages, strict=True))) for way, ages in seen.items()}
    (median, last), (relayed_median, relayed_last) = by_way[False], by_way[True]
    return (median, last), (relayed_median, relayed_last), statistics.median(cost)


def direct(size: int, rate: int, number: int) -> tuple[float, float]:
    """Return median and p99 of the ages of messages between two nodes without a run, with its profiles."""
    python = ros_python(is_known=True)
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        profiles = FastDdsProfiles(Path(folder), python.environment)

        def start(node: str, *parameters: str) -> subprocess.Popen[str]:
            said = [part for each in parameters for part in ("-p", each)]
            command = [python.program, str(HERE / "nodes.py"), node, "--ros-args", "-r", "x:=n", *said]
            process = subprocess.Popen(
                command,
                env={**python.environment, **profiles.environment(node)},
                stdout=subprocess.PIPE,
                text=True,
            )
            stack.callback(process.kill)
            return process

        clock = start("clock", f"number:={number}")
        start("camera", f"size:={size}", f"rate:={rate}")
        assert clock.stdout is not None
        ages = (ages_of(line) for line in clock.stdout if line.startswith("ages"))
        next(ages)  # with the time in which they find each other
        return next(ages)


def relayed(size: int, rate: int, number: int) -> tuple[tuple[float, float], float]:
    """Return median and p99 of the ages of messages through the relay, and its CPU time for a message, in us."""
    out, into = OutputPort("n", "N", type=IMAGE), InputPort("x", "N", type=IMAGE)
    camera = Transformation("camera", (), (out,), source="node:./nodes.py camera", params={"size": size, "rate": rate})
    clock = Transformation("clock", (into,), (), source="node:./nodes.py clock", params={"number": number})
    units = (
        ComputationUnit("camera.1", "camera"),
        ComputationUnit("clock.1", "clock", (Subscription("x", Stream("camera.1", "n")),)),
    )
    with runtime_of(ROS2) as runtime:
        events: queue.SimpleQueue[Event] = queue.SimpleQueue()
        runtime.listen(events.put)
        runtime.apply(ChangeSet(units, added_transformations=(camera, clock)))
        relay = relay_process()
        first = second = 0
        before_us = 0
        ages: list[tuple[float, float]] = []
        while len(ages) < 2:
            event = events.get(timeout=PATIENCE_S)
            if isinstance(event, UnitPrinted) and event.line.startswith("ages"):
                ages.append(ages_of(event.line))
            elif isinstance(event, UnitStatus) and event.unit == "camera.1":
                second = event.outputs["n"].elements
                if len(ages) == 1 and not first:
                    first, before_us = second, cpu_us(relay.pid) or 0
        return ages[1], ((cpu_us(relay.pid) or 0) - before_us) / max(1, second - first)


def ages_of(line: str) -> tuple[float, float]:
    """Return median and p99 in us."""
    _, _, median, last = line.split()
    return float(median), float(last)


if __name__ == "__main__":
    main()
