"""Counts lost and repeated messages of a lifecycle node that is replaced, and measures for how long both are active.

    CFGPLAN_ROS_PYTHON=ros/bin/python python experiments/ros2/replacing.py [--replacements 20]

A lifecycle node gives the number of each fiftieth of a second, and a tracker prints those that it gets. Each update
replaces the node by a new one of the same transformation; `beside a slow one` it starts another node, too, which takes
two seconds more.
"""

from __future__ import annotations

import argparse
import os
import queue
import statistics
import sys
import time
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

from cfgplan_runtime.supervision.events import Event, UnitPrinted

from cfgplan.domain import ChangeSet, ComputationUnit, InputPort, OutputPort, Stream, Subscription, Transformation

sys.path.append(str(Path(__file__).parents[2]))
from experiments.workers import PATIENCE_S, ROS2, runtime_of

RATE_HZ = 50
SLOW_S = 2.0
WAYS = ("stamped", "plain", "stamped, beside a slow one")


@dataclass(frozen=True)
class Replaced:
    """The tracker's numbers, the longest time between two of them, and for each replacement the seconds that it took
    and those for which both nodes were active. `missed` are the first node's first numbers that never came.
    """

    numbers: tuple[int, ...]
    missed: int
    gap_s: float
    took_s: list[float]
    both_s: list[float]
    deactivated: int

    @property
    def repeated(self) -> int:
        return len(self.numbers) - len(set(self.numbers))

    @property
    def lost(self) -> int:
        return max(self.numbers) - min(self.numbers) + 1 - len(set(self.numbers))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--replacements", type=int, default=20)
    number = parser.parse_args().replacements
    print(f"load {os.getloadavg()[0]:.1f}")
    print(
        "| messages | got | first ones missed | lost | repeated | longest gap, ms "
        "| both active, ms: median (worst) | deactivated | a replacement, ms: median (worst) |"
    )
    print("|---|---|---|---|---|---|---|---|---|", flush=True)
    for way in WAYS:
        found = replaced(way, number)
        print(
            f"| {way} | {len(found.numbers)} | {found.missed} | {found.lost} | {found.repeated} "
            f"| {found.gap_s * 1e3:.0f} | {shown(found.both_s)} | {found.deactivated} | {shown(found.took_s)} |",
            flush=True,
        )
    print(f"load {os.getloadavg()[0]:.1f} at the end")


def shown(seconds: list[float]) -> str:
    return f"{statistics.median(seconds) * 1e3:.0f} ({max(seconds) * 1e3:.0f})"


def library(way: str) -> tuple[Transformation, ...]:
    kind = "std_msgs/Int64" if way == "plain" else "geometry_msgs/PointStamped"
    given, params = OutputPort("n", "Number", type=kind), {"way": way}
    managed = Transformation("managed", (), (given,), source="node:./nodes.py managed", params=params)
    slow = replace(managed, label="slow", params={**params, "sleep": SLOW_S})
    ports = (InputPort("x", "Number", type=kind),)
    return managed, slow, Transformation("tracker", ports, (), source="node:./nodes.py tracker", params=params)


def tracker(number: int) -> ComputationUnit:
    return ComputationUnit("tracker.1", "tracker", (Subscription("x", Stream(f"managed.{number}", "n")),))


def replaced(way: str, replacements: int) -> Replaced:
    """Replace the node so many times, once a second at most."""
    lines: queue.SimpleQueue[tuple[int, int]] = queue.SimpleQueue()
    told: dict[tuple[str, str], int] = {}
    """The last number that each unit has printed with each word."""

    def note(event: Event) -> None:
        if isinstance(event, UnitPrinted):
            match event.line.split():
                case ["got", number, at_ns]:
                    lines.put((int(number), int(at_ns)))
                case ["active" | "inactive" | "ended" | "first" as word, number]:
                    told[event.unit, word] = int(number)

    got: list[tuple[int, int]] = []
    took_s = []

    def take(number: int) -> None:
        """Take all numbers that have come, and so many more."""
        got.extend(lines.get(timeout=PATIENCE_S) for _ in range(lines.qsize() + number))

    with runtime_of(ROS2) as runtime:
        runtime.listen(note)
        started = (ComputationUnit("managed.0", "managed"), tracker(0))
        runtime.apply(ChangeSet(started, added_transformations=library(way)))
        take(2 * RATE_HZ)
        for number in range(1, replacements + 1):
            new = [ComputationUnit(f"managed.{number}", "managed")]
            old = [f"managed.{number - 1}"]
            if "slow" in way:
                new.append(ComputationUnit(f"slow.{number}", "slow"))
                old += [f"slow.{number - 1}"] * (number > 1)
            change_set = ChangeSet(tuple(new), rewired=(tracker(number),), stopped=tuple(old))
            began_s = time.monotonic()
            runtime.apply(change_set)
            took_s.append(time.monotonic() - began_s)
            take(RATE_HZ // 2)
        take(RATE_HZ)
    both_s = []
    for number in range(replacements):
        before, after = f"managed.{number}", f"managed.{number + 1}"
        end_ns = told.get((before, "inactive"), told[before, "ended"])
        both_s.append((end_ns - told[after, "active"]) / 1e9)
    numbers, times_ns = zip(*got, strict=True)
    gap_s = max(later - earlier for earlier, later in pairwise(times_ns)) / 1e9
    deactivated = sum((f"managed.{number}", "inactive") in told for number in range(replacements))
    return Replaced(numbers, numbers[0] - told["managed.0", "first"], gap_s, took_s, both_s, deactivated)


if __name__ == "__main__":
    main()
