"""The errors of the ball's positions, with one robot and with both, over minutes of the game; no unit is started.

python experiments/nao/accuracy.py [--frames 3000] [--every 3]
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Mapping
from typing import Any

import pipelines
from football import scenario
from nao_demo.rehearsing import Robot
from units import FuseBallPos


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=3000)
    parser.add_argument("--every", type=int, default=3, help="take each Nth frame of 15 per second")
    options = parser.parse_args()
    timed = pipelines.Timed()
    robots = [Robot(name, timed) for name in pipelines.ROBOTS]
    fuse = FuseBallPos()
    errors: dict[str, list[tuple[float, float]]] = defaultdict(list)
    surprises: dict[str, list[float]] = defaultdict(list)
    by_distance: dict[float, list[tuple[float, float]]] = defaultdict(list)

    def note(stream: str, position: Mapping[str, Any], time_ns: int) -> None:
        errors[stream].append(pipelines.error(position, time_ns))
        surprises[stream].append(pipelines.surprise(position, time_ns))

    for number in range(options.frames):
        time_ns = scenario.time_of_frame(number * options.every)
        found = {robot.name: robot.see(time_ns).position for robot in robots}
        for robot, position in found.items():
            if position is not None:
                note(robot, position, time_ns)
                nearest = round(pipelines.distance(robot, time_ns) * 2) / 2
                by_distance[nearest].append(pipelines.error(position, time_ns))
        first, second = found.values()
        if first is not None and second is not None:
            note("fused", fuse(first=first, second=second), time_ns)
    print(f"{options.frames:,} moments, {options.frames * options.every / scenario.FRAMES_PER_S / 60:.0f} minutes\n")
    print(pipelines.HEAD)
    for stream, found_errors in errors.items():
        print(f"| {stream} | {pipelines.summary(found_errors)} |")
    print("\nSquared error in units of the covariance (honest: 2.0):")
    print(", ".join(f"{stream} {sum(values) / len(values):.2f}" for stream, values in surprises.items()))
    print(f"\n{pipelines.HEAD.replace('stream', 'ball about')}")
    for metres, found_errors in sorted(by_distance.items()):
        print(f"| {metres} m away | {pipelines.summary(found_errors)} |")
    print("\nCPU per frame and robot:")
    total = {unit: cpu_s / len(robots) / options.frames for unit, cpu_s in timed.cpu_s.items()}
    print(", ".join(f"{unit} {1000 * cpu:.2f} ms" for unit, cpu in total.items()))
    print(f"At 15 frames per second {15 * sum(total.values()):.3f} s/s, without the transport.")


if __name__ == "__main__":
    main()
