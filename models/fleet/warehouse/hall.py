"""The ground truth of the hall: crates, robots and their cameras, as functions of time.

The origin is the middle of the hall. Lengths are in metres, headings in radians from the x axis, times in nanoseconds
since the epoch. The true state for any element of a stream can be computed from its time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float32]

WIDTH, HEIGHT = 320, 240
"""The size of a picture in pixels. A pixel is (u, v): right and down from the centre of the top left pixel."""
FOCAL = WIDTH / 2 / math.tan(math.radians(30))
CENTRE = ((WIDTH - 1) / 2, (HEIGHT - 1) / 2)
CAMERA_M = 1.5
TILT = math.radians(20)
"""The downward tilt of the cameras in radians, and their height above the floor."""
CRATE_M = 0.5
"""The edge of a crate. Its sides are parallel to the walls."""
COLOURS = ((205, 120, 40), (50, 100, 200))
"""Crates in the west are orange, crates in the east are blue."""
HALL_M = (7.0, 4.5)
"""The distances from the middle to the walls, along x and y."""
_NS_PER_S = 1_000_000_000
_SWAY_M = 0.5


@dataclass(frozen=True)
class Pose:
    """The position and heading of a robot, in metres and radians."""

    x: float
    y: float
    heading: float


@dataclass(frozen=True)
class Crate:
    """The position of a crate's centre on the floor in metres; `colour` is an index of COLOURS."""

    x: float
    y: float
    colour: int


def crates(time_ns: int) -> tuple[Crate, ...]:
    """Return the four crates at a time; they are always more than a metre apart."""
    return tuple(
        Crate(
            1.2 * (-1, 1)[east] + _SWAY_M * _wave(time_ns, 23 + 7 * number, number),
            1.2 * (-1, 1)[north] + _SWAY_M * _wave(time_ns, 31 + 5 * number, 2 * number),
            east,
        )
        for number, (east, north) in enumerate(((0, 0), (0, 1), (1, 0), (1, 1)))
    )


def pose(robot: str, time_ns: int) -> Pose:
    """Return the true pose of a robot at a time.

    r1 moves along the west wall, r2 along the east wall; both face the middle.
    """
    if robot not in ("r1", "r2"):
        raise ValueError(f"no robot {robot!r} is in the hall, only r1, r2")
    side = -1 if robot == "r1" else 1
    period_s = 37.0 if robot == "r1" else 43.0
    x = side * (5.0 + 0.3 * _wave(time_ns, 0.6 * period_s, 1.0))
    y = 0.8 * _wave(time_ns, period_s)
    gaze = 0.06 * _wave(time_ns, 0.4 * period_s, 2.0)
    return Pose(x, y, math.remainder(math.atan2(-y, -x) + gaze, 2 * math.pi))


def time_of_frame(number: int, per_s: int) -> int:
    """Return the time of a frame, rounded up to a nanosecond; it is the same for all robots."""
    return -(-number * _NS_PER_S // per_s)


def last_frame(now_ns: int, per_s: int) -> int:
    """Return the number of the last frame whose time is not after `now_ns`."""
    return now_ns * per_s // _NS_PER_S


def rays() -> Floats:
    """Return the direction of each pixel, as (ahead, left, up) of the robot: (240, 320, 3), not normalised."""
    u, v = np.meshgrid(np.arange(WIDTH) - CENTRE[0], np.arange(HEIGHT) - CENTRE[1])
    down = v / FOCAL
    ahead, up = math.cos(TILT) - math.sin(TILT) * down, -math.sin(TILT) - math.cos(TILT) * down
    return np.stack([ahead, -u / FOCAL, up], axis=-1).astype(np.float32)


def pixel(pose: Pose, x: float, y: float, height: float) -> tuple[float, float] | None:
    """Return the pixel (u, v) that shows a point to a camera at `pose`; None if the point is not in front of it."""
    ahead, left = _turned(x - pose.x, y - pose.y, -pose.heading)
    up = height - CAMERA_M
    depth = math.cos(TILT) * ahead - math.sin(TILT) * up
    if depth <= 0.1:
        return None
    down = -math.sin(TILT) * ahead - math.cos(TILT) * up
    return CENTRE[0] - FOCAL * left / depth, CENTRE[1] + FOCAL * down / depth


def on_floor(pose: Pose, u: float, v: float, beyond_m: float = 0.0) -> tuple[float, float, float] | None:
    """Return x and y of the point on the floor that a pixel shows, and its distance, all in metres.

    The point is moved away from the camera by `beyond_m`. None if the pixel does not show the floor.
    """
    down = (v - CENTRE[1]) / FOCAL
    drop = math.sin(TILT) + math.cos(TILT) * down
    if drop <= 1e-3:
        return None
    reach = CAMERA_M / drop
    ahead, left = (math.cos(TILT) - math.sin(TILT) * down) * reach, -(u - CENTRE[0]) / FOCAL * reach
    distance = math.hypot(ahead, left)
    stretch = (distance + beyond_m) / distance
    x, y = _turned(ahead * stretch, left * stretch, pose.heading)
    return pose.x + x, pose.y + y, distance + beyond_m


def _turned(x: float, y: float, angle: float) -> tuple[float, float]:
    cos, sin = math.cos(angle), math.sin(angle)
    return cos * x - sin * y, sin * x + cos * y


def _wave(time_ns: int, period_s: float, phase: float = 0.0) -> float:
    period_ns = round(period_s * _NS_PER_S)
    return math.sin(2 * math.pi * (time_ns % period_ns) / period_ns + phase)
