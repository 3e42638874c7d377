"""Counts lost and repeated messages of an input that is led to and fro between two detectors of one camera.

    CFGPLAN_ROS_PYTHON=ros/bin/python python experiments/ros2/switches.py [--switches 100]

A node counts at 50 Hz, two detectors give its numbers 2 and 14 ms later, and a tracker prints those that it gets.
Messages without a stamp (`plain`) are ordered by the time when each was sent, so a number may come from both detectors,
or, if one is behind by more than a period, from none.
"""

from __future__ import annotations

import argparse
import os
import queue
import statistics
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from cfgplan_runtime.supervision.events import Event, UnitPrinted

from cfgplan.domain import ChangeSet, ComputationUnit, InputPort, OutputPort, Stream, Subscription, Transformation

sys.path.append(str(Path(__file__).parents[2]))
from experiments.workers import PATIENCE_S, ROS2, runtime_of

RATE_HZ = 50
DELAYS_S = {"quick": 0.002, "slow": 0.014}
WAYS = ("stamped", "simulated", "plain", "best_effort")


@dataclass(frozen=True)
class Heard:
    """The numbers that the tracker got, the longest time between two of them, and how long each switch took, in
    seconds.
    """

    numbers: Sequence[int]
    gap_s: float
    switch_s: Sequence[float]

    @property
    def lost(self) -> int:
        """How many numbers between the smallest and the largest one are missing."""
        return max(self.numbers) - min(self.numbers) + 1 - len({*self.numbers})

    @property
    def repeated(self) -> int:
        return len(self.numbers) - len({*self.numbers})

    @property
    def back(self) -> int:
        """How often a smaller number followed."""
        return sum(after < before for before, after in pairwise(self.numbers))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--switches", type=int, default=100)
    number = parser.parse_args().switches
    print(f"load {os.getloadavg()[0]:.1f}; {number} switches each")
    print("| messages | got | lost | repeated | back | longest gap, periods | a switch, ms: median (worst) |")
    print("|---|---|---|---|---|---|---|")
    for way in WAYS:
        found = heard(way, number)
        took_ms = [1e3 * seconds for seconds in found.switch_s]
        figures = (len(found.numbers), found.lost, found.repeated, found.back, f"{found.gap_s * RATE_HZ:.1f}")
        print(f"| {way} | {' | '.join(map(str, figures))} | {statistics.median(took_ms):.0f} ({max(took_ms):.0f}) |")
    print(f"load {os.getloadavg()[0]:.1f} at the end")


def library(way: str) -> tuple[Transformation, ...]:
    kind = "std_msgs/Int64" if way == "plain" else "geometry_msgs/PointStamped"
    params = {"way": way}
    numbered = Transformation(
        "numbered",
        (),
        (OutputPort("n", "Number", type=kind),),
        source="node:./nodes.py numbered",
        params={**params, "rate": RATE_HZ},
    )
    detectors = [
        Transformation(
            label,
            (InputPort("x", "Number", type=kind),),
            (OutputPort("y", "Found", type=kind),),
            source="node:./nodes.py detector",
            params={**params, "delay": delay_s},
        )
        for label, delay_s in DELAYS_S.items()
    ]
    ports = (InputPort("x", "Found", type=kind),)
    return numbered, *detectors, Transformation("tracker", ports, (), source="node:./nodes.py tracker", params=params)


def fed(unit: str, stream: Stream) -> ComputationUnit:
    return ComputationUnit(unit, unit.partition(".")[0], (Subscription("x", stream),))


def tracker(detector: str) -> ComputationUnit:
    return fed("tracker.1", Stream(f"{detector}.1", "y"))


def heard(way: str, switches: int) -> Heard:
    """Switch the tracker so many times, twice a second at most. Returns the numbers that arrived."""
    lines: queue.SimpleQueue[tuple[int, int]] = queue.SimpleQueue()

    def note(event: Event) -> None:
        if isinstance(event, UnitPrinted) and event.line.startswith("got "):
            _, number, at_ns = event.line.split()
            lines.put((int(number), int(at_ns)))

    took_s = []
    got: list[tuple[int, int]] = []

    def take(number: int) -> None:
        got.extend(lines.get(timeout=PATIENCE_S) for _ in range(number))

    with runtime_of(ROS2) as runtime:
        runtime.listen(note)
        detectors = [fed(f"{label}.1", Stream("numbered.1", "n")) for label in DELAYS_S]
        started = (ComputationUnit("numbered.1", "numbered"), *detectors, tracker("quick"))
        runtime.apply(ChangeSet(started, added_transformations=library(way)))
        take(RATE_HZ)
        got.clear()  # which have come while they found each other
        for number in range(switches):
            began_s = time.monotonic()
            runtime.apply(ChangeSet(rewired=(tracker(("slow", "quick")[number % 2]),)))
            took_s.append(time.monotonic() - began_s)
            take(RATE_HZ // 2)
        take(RATE_HZ)
    numbers, times_ns = zip(*got, strict=True)
    return Heard(numbers, max(after - before for before, after in pairwise(times_ns)) / 1e9, took_s)


if __name__ == "__main__":
    main()
