"""The CPU time of the run's relay for a message, with `observe` at the output and without, in turns.

    CFGPLAN_ROS_PYTHON=ros/bin/python python experiments/ros2/observing.py [--seconds 10] [--rounds 5]

A node gives poses of 360 B, or images of 10 kB and 1 MB, on a target's topic, to which nobody listens.
"""

from __future__ import annotations

import argparse
import os
import queue
import statistics
from collections.abc import Iterator
from pathlib import Path

import psutil
from cfgplan_runtime import Runtime
from cfgplan_runtime.processes.child_process import cpu_us
from cfgplan_runtime.ros2.ros2_backend import Ros2Backend
from cfgplan_runtime.supervision.events import Event, UnitStatus

from cfgplan.domain import ChangeSet, ComputationUnit, OutputPort, Publication, Target, Transformation
from cfgplan.qualities import Contribution, QualityRule

HERE = Path(__file__).parent
PATIENCE_S = 60.0
KINDS = {
    "pose of 360 B at 100 Hz": (0, 100, ["pose.covariance.0"]),
    "pose of 360 B at 100 Hz, four fields": (0, 100, [f"pose.covariance.{place}" for place in (0, 7, 14, 35)]),
    "image of 10 kB at 100 Hz": (10_000, 100, ["width"]),
    "image of 1 MB at 30 Hz": (1_000_000, 30, ["width"]),
}
"""By name: the bytes of an image, the messages in a second, and the fields that are observed."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=int, default=10, help="seconds of each measurement")
    parser.add_argument("--rounds", type=int, default=5, help="measurements of each kind, with and without")
    options = parser.parse_args()
    print(f"load {os.getloadavg()[0]:.1f}; us of CPU for a message, medians of {options.rounds} (range)")
    print("| messages | without `observe` | with it |\n|---|---|---|")
    for name, (size, rate, fields) in KINDS.items():
        taken: dict[bool, list[float]] = {False: [], True: []}
        for _ in range(options.rounds):
            for is_observed, seen in taken.items():
                seen.append(relay_us(size, rate, fields if is_observed else [], options.seconds))
        print(f"| {name} | {shown(taken[False])} | {shown(taken[True])} |", flush=True)
    print(f"load {os.getloadavg()[0]:.1f} at the end")


def shown(taken: list[float]) -> str:
    return f"{statistics.median(taken):.0f} ({min(taken):.0f} to {max(taken):.0f})"


def relay_us(size: int, rate: int, fields: list[str], seconds: int) -> float:
    """The CPU time of the relay for a message, in microseconds."""
    quality = tuple(Contribution(f"q{place}", QualityRule.SET, 0, observe=each) for place, each in enumerate(fields))
    kind = "sensor_msgs/Image" if size else "geometry_msgs/PoseWithCovarianceStamped"
    port = OutputPort("n", "N", type=kind, quality=quality)
    source, params = "node:./nodes.py camera", {"size": size, "rate": rate}
    camera = Transformation("camera", (), (port,), source=source, params=params)
    unit = ComputationUnit("camera.1", "camera", (), (Publication("n", "/n"),))
    target = Target("n", "N", "/n")
    with Runtime(backend=lambda: Ros2Backend(folder=HERE, warm=False)) as runtime:
        events: queue.SimpleQueue[Event] = queue.SimpleQueue()
        runtime.listen(events.put)
        runtime.apply(ChangeSet((unit,), added_transformations=(camera,), added_targets=(target,)))
        (relay,) = [one for one in psutil.Process().children() if "host/main.py" in " ".join(one.cmdline())]
        counts = signs(events)
        for _ in range(3):
            next(counts)
        before, before_us = next(counts), cpu_us(relay.pid) or 0
        for _ in range(seconds - 1):
            next(counts)
        passed = next(counts) - before
        return ((cpu_us(relay.pid) or 0) - before_us) / passed


def signs(events: queue.SimpleQueue[Event]) -> Iterator[int]:
    """Yield the number of messages that the camera has given, once a second."""
    while True:
        event = events.get(timeout=PATIENCE_S)
        if isinstance(event, UnitStatus):
            yield event.outputs["n"].elements


if __name__ == "__main__":
    main()
