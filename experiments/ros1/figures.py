"""The cost of changes with units as processes of cfgplan, nodes of ROS 1 or nodelets, side by side in one run.

    python experiments/ros1/figures.py [--times 10]

A worker between a source of 100 Hz and a topic is loaded, connected to another source, unloaded, and killed under the
life-cycle. Then the relay's share of a core is measured. Needs ROS 1 (see `.ci/run`).
"""

from __future__ import annotations

import argparse
import os
import statistics
import sys
import time
from itertools import pairwise
from pathlib import Path

import psutil
from cfgplan_runtime import Manager, Policy
from cfgplan_runtime.lifecycle.back_off import BackOffRules
from cfgplan_runtime.processes.child_process import cpu_us

from cfgplan import api
from cfgplan.domain import ChangeSet, ComputationUnit, Environment, Publication

sys.path.append(str(Path(__file__).parents[2]))
from experiments.workers import (
    NODELETS,
    PATIENCE_S,
    PROCESSES,
    ROS1,
    SOURCES,
    TOPIC,
    arrivals,
    eventually,
    library,
    ros1_of_its_own,
    runtime_of,
    worker,
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--times", type=int, default=10)
    times = parser.parse_args().times
    kinds = (PROCESSES, ROS1, NODELETS)
    with ros1_of_its_own() as is_installed:
        if not is_installed:
            sys.exit("ROS 1 with nodelets is not installed (see .ci/run)")
        changed = {kind: changes(kind, times) for kind in kinds}
        silent = {kind: silences(kind, times) for kind in kinds}
        relay = {size: relay_cost(size) for size in (10, 800)}
    print(f"\nload {os.getloadavg()[0]:.0f}; ms, medians of {times} (worst)")
    print("| what | processes | nodes (rospy) | nodelets |\n|---|---|---|---|")
    for what in ("load", "rewire", "unload"):
        print(f"| {what} | {' | '.join(shown(changed[kind][what]) for kind in kinds)} |")
    print(f"| `kill -9`: time without results | {' | '.join(shown(silent[kind]) for kind in kinds)} |")
    for size, us in relay.items():
        print(f"the relay takes {us:.0f} us of CPU for a picture of {size * size} B, read once and written once")


def shown(seconds: list[float]) -> str:
    return f"{statistics.median(seconds) * 1e3:.0f} ({max(seconds) * 1e3:.0f})"


def changes(kind: str, times: int) -> dict[str, list[float]]:
    """The seconds that each change took, until it was carried out."""
    taken: dict[str, list[float]] = {"load": [], "rewire": [], "unload": []}
    with runtime_of(kind) as runtime:
        runtime.apply(ChangeSet(SOURCES, added_transformations=library(kind), added_targets=(TOPIC,)))
        for _ in range(times):
            for what, change_set in (
                ("load", ChangeSet((worker(),))),
                ("rewire", ChangeSet(rewired=(worker(source="second.1"),))),
                ("unload", ChangeSet(stopped=("work.1",))),
            ):
                began_s = time.monotonic()
                runtime.apply(change_set)
                taken[what].append(time.monotonic() - began_s)
    return taken


def silences(kind: str, times: int) -> list[float]:
    """The seconds without results after each kill of the worker, with the life-cycle."""
    first, _, work = library(kind)
    world = api.world(Environment((), (first, work), (TOPIC,)), horizon_s=600)
    policy = Policy(back_off=BackOffRules(alone_s=0.0))
    seen = []
    with runtime_of(kind) as runtime, Manager(world, runtime, policy=policy) as manager:
        manager.settle(PATIENCE_S)
        with arrivals(kind, runtime) as came:
            for _ in range(times):
                start = len(came)
                eventually(lambda start=start: len(came) > start + 50)
                old, start = runtime.pid("work.1"), len(came) - 1
                assert old
                os.kill(old, 9)
                eventually(lambda old=old: runtime.pid("work.1") not in (None, old))
                before = len(came)
                eventually(lambda before=before: len(came) > before + 20)
                seen.append(max(b - a for a, b in pairwise(came[start:])))
    return seen


def relay_cost(size: int) -> float:
    """The CPU time of the relay in microseconds for a message of this size, led to one listener."""
    first, _, _ = library(ROS1, size)
    unit = ComputationUnit("first.1", "first", (), (Publication("n", TOPIC.topic),))
    with runtime_of(ROS1) as runtime:
        runtime.apply(ChangeSet((unit,), added_transformations=(first,), added_targets=(TOPIC,)))
        relays = [child for child in psutil.Process().children() if "topic_relay" in " ".join(child.cmdline())]
        with arrivals(ROS1, runtime) as came:
            eventually(lambda: len(came) > 50)
            before_us, count = cpu_us(relays[0].pid) or 0, len(came)
            eventually(lambda: len(came) > count + 300)
            return ((cpu_us(relays[0].pid) or 0) - before_us) / (len(came) - count)


if __name__ == "__main__":
    main()
