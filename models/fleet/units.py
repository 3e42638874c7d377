"""The units of the fleet, as `transformations.yaml` names them; the package `warehouse` simulates their observations.

The time of an element is that of the picture that it was computed from.
"""

from __future__ import annotations

import math
import os
import time
import zlib
from collections.abc import Iterator

from cfgplan_runtime import At
from warehouse import hall, seeing
from warehouse.hall import Pose
from warehouse.picture import Bytes, Photographer
from warehouse.seeing import Box, Obstacle

_DRIFT_M, _DRIFT = 0.03, math.radians(0.4)
"""The amplitudes of a localiser's error: along each axis in metres, and of the heading in radians."""


class Camera:
    """Yields pictures of the scene in front of the robot: RGB, (240, 320, 3), 15 times a second."""

    def __init__(self, robot: str) -> None:
        self._robot = robot
        self._photographer = Photographer(zlib.crc32(robot.encode()))

    def __iter__(self) -> Iterator[At | None]:
        return (None if time_ns is None else At(time_ns, self.picture(time_ns)) for time_ns in _frames(15))

    def picture(self, time_ns: int) -> Bytes:
        """Return the picture, (240, 320, 3), at a time in nanoseconds since the epoch."""
        return self._photographer.picture(hall.pose(self._robot, time_ns), hall.crates(time_ns))


class Localiser:
    """Yields the robot's estimated pose, [x, y, heading] in metres and radians, 30 times a second."""

    def __init__(self, robot: str) -> None:
        self._robot = robot
        self._phase = zlib.crc32(robot.encode())

    def __iter__(self) -> Iterator[At | None]:
        return (None if time_ns is None else At(time_ns, self.pose(time_ns)) for time_ns in _frames(30))

    def pose(self, time_ns: int) -> list[float]:
        """Return the estimated pose at a time in nanoseconds since the epoch: the true pose plus a slow drift."""
        true = hall.pose(self._robot, time_ns)
        angle = time_ns / 1e9 % 1e6
        x, y, heading = (math.sin(angle / period + self._phase) for period in (2.0, 2.7, 3.1))
        return [true.x + _DRIFT_M * x, true.y + _DRIFT_M * y, true.heading + _DRIFT * heading]


def small_detector(image: Bytes) -> list[Box]:
    """Return the crates in a picture, (240, 320, 3), found in every fourth row and column."""
    return seeing.boxes(image, 4)


def large_detector(image: Bytes) -> list[Box]:
    """Return the crates in a picture, (240, 320, 3), found with every pixel."""
    return seeing.boxes(image, 1)


def obstacle_finder(boxes: list[Box], pose: list[float]) -> list[Obstacle]:
    """Return the positions on the floor of the crates that a robot at `pose`, [x, y, heading], sees."""
    return seeing.obstacles(boxes, Pose(*pose))


def merge_obstacles(one: list[Obstacle], other: list[Obstacle]) -> list[Obstacle]:
    """Return the obstacles that either robot sees; one that both see is listed once."""
    return seeing.merged(one, other)


def watchdog() -> dict[str, float]:
    """Return the load average of its computer over the last minute."""
    return {"load": os.getloadavg()[0]}


def _frames(per_s: int) -> Iterator[int | None]:
    """Yield the time of each frame once it is due, None before that. Frames that are requested too late are skipped."""
    last = hall.last_frame(time.time_ns(), per_s)
    while True:
        number = hall.last_frame(time.time_ns(), per_s)
        yield hall.time_of_frame(number, per_s) if number > last else None
        last = max(last, number)
