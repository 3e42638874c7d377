"""The units of the fleet, as `transformations.yaml` names them; the package `warehouse` simulates their observations.

Elements carry the time of their frame.
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
"""What a localiser gets wrong, as amplitudes along each axis and of the heading."""


class Camera:
    """Yields pictures of the scene in front of the robot: RGB, (240, 320, 3), 15 times a second."""

    def __init__(self, robot: str) -> None:
        self._robot = robot
        self._photographer = Photographer(zlib.crc32(robot.encode()))

    def __iter__(self) -> Iterator[At | None]:
        return (None if time_ns is None else At(time_ns, self.picture(time_ns)) for time_ns in _frames(15))

    def picture(self, time_ns: int) -> Bytes:
        """Return the camera's picture at a time."""
        return self._photographer.picture(hall.pose(self._robot, time_ns), hall.crates(time_ns))


class Localiser:
    """Gives where the robot believes it is, [x, y, heading] in metres and radians, 30 times a second."""

    def __init__(self, robot: str) -> None:
        self._robot = robot
        self._phase = zlib.crc32(robot.encode())

    def __iter__(self) -> Iterator[At | None]:
        return (None if time_ns is None else At(time_ns, self.pose(time_ns)) for time_ns in _frames(30))

    def pose(self, time_ns: int) -> list[float]:
        """Return the robot's estimated pose at a time: the truth plus a slow drift."""
        true = hall.pose(self._robot, time_ns)
        angle = time_ns / 1e9 % 1e6
        x, y, heading = (math.sin(angle / period + self._phase) for period in (2.0, 2.7, 3.1))
        return [true.x + _DRIFT_M * x, true.y + _DRIFT_M * y, true.heading + _DRIFT * heading]


def small_detector(image: Bytes) -> list[Box]:
    """Gives the crates of a picture, looking at each fourth row and column."""
    return seeing.boxes(image, 4)


def large_detector(image: Bytes) -> list[Box]:
    """Gives the crates of a picture, looking at every pixel."""
    return seeing.boxes(image, 1)


def obstacle_finder(boxes: list[Box], pose: list[float]) -> list[Obstacle]:
    """Gives where on the floor the crates stand that a robot sees."""
    return seeing.obstacles(boxes, Pose(*pose))


def merge_obstacles(one: list[Obstacle], other: list[Obstacle]) -> list[Obstacle]:
    """Gives what either robot sees."""
    return seeing.merged(one, other)


def watchdog() -> dict[str, float]:
    """Gives how many processes of its computer wait for a core, on average over a minute."""
    return {"load": os.getloadavg()[0]}


def _frames(per_s: int) -> Iterator[int | None]:
    """Yield the time of each frame once it is due, None before that. Frames that are requested too late are skipped."""
    last = hall.last_frame(time.time_ns(), per_s)
    while True:
        number = hall.last_frame(time.time_ns(), per_s)
        yield hall.time_of_frame(number, per_s) if number > last else None
        last = max(last, number)
