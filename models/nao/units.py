"""The units of the case study, as `pipeline.yaml` names them; the package `football` has their algorithms.

The time of an element is that of its frame.
"""

from __future__ import annotations

import time
import zlib
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, TypedDict

import numpy as np
from football import scenario, seeing
from football.camera import Pose
from football.field import Bytes
from football.locating import BallPosition, fused, located
from football.rendering import Renderer
from football.scenario import FrameClock

if TYPE_CHECKING:
    from cfgplan_runtime import At, WithQuality
from football.walking import Gait

DAYLIGHT_LUMA = 89.3
"""The median luma of a picture by day."""
ERROR_BY_LIGHT = ((0.6, 1.0), (0.9, 0.0))
"""Points (light, error in metres): how far the pictures mislead the detector."""
BEACON_ERROR_M = 0.25
"""The standard deviation of the beacon's error along each axis."""


class Position(TypedDict):
    """The ball's position in metres, and the covariance of its error in square metres: [xx, xy, yy]."""

    x: float
    y: float
    covariance: list[float]


class BottomCam:
    """Yields images as packed YUYV 4:2:2, (480, 640, 2). With `day_s` a night comes every so many seconds."""

    def __init__(self, robot: str, day_s: float | None = None) -> None:
        self._robot = robot
        self._day_s = day_s
        self._gait = Gait(robot)
        self._renderer = Renderer(zlib.crc32(robot.encode()))

    def __iter__(self) -> Iterator[At | None]:
        return _frames(self.picture)

    def picture(self, time_ns: int) -> Bytes:
        """Return the image at a time in nanoseconds since the epoch."""
        camera = self._gait.camera(scenario.pose(self._robot, time_ns))
        return self._renderer.picture(camera, scenario.ball(time_ns), scenario.light(time_ns, self._day_s))


class ExposedCam(BottomCam):
    """Yields images with their `error` in metres, which it estimates from how dark they are.

    By day, the light that it finds in a picture has a standard deviation of 0.5 %.
    """

    def __iter__(self) -> Iterator[At | None]:
        return _frames(self.measured)

    def measured(self, time_ns: int) -> WithQuality:
        """Return the image at a time in nanoseconds since the epoch, with its error."""
        from cfgplan_runtime import WithQuality

        picture = self.picture(time_ns)
        light = float(np.median(picture[::8, ::8, 0])) / DAYLIGHT_LUMA
        lights, errors = zip(*ERROR_BY_LIGHT, strict=True)
        return WithQuality(picture, {"error": float(np.interp(light, lights, errors))})


class Photometer:
    """Yields the brightness, {light}: 1 by day. The sensor's error has a standard deviation of 5 % of the value."""

    def __init__(self, day_s: float) -> None:
        self._day_s = day_s
        self._random = np.random.default_rng(1)

    def __iter__(self) -> Iterator[dict[str, float]]:
        while True:
            light = scenario.light(time.time_ns(), self._day_s)
            yield {"light": round(light * (1 + 0.05 * float(self._random.normal())), 4)}


class Beacon:
    """Yields the ball's position by its infrared beacon, with a standard deviation of 25 cm along each axis."""

    def __init__(self) -> None:
        self._random = np.random.default_rng(2)

    def __iter__(self) -> Iterator[At | None]:
        return _frames(self.position)

    def position(self, time_ns: int) -> Position:
        """Return the measured position at a time in nanoseconds since the epoch."""
        x, y = np.array(scenario.ball(time_ns)) + self._random.normal(0, BEACON_ERROR_M, 2)
        return _as_value(BallPosition(float(x), float(y), np.eye(2) * BEACON_ERROR_M**2))


class Subsampler:
    """Maps an image, (480, 640, 2), to its channels in five sizes each, from `y640` (640 x 480) to `v40` (40 x 30)."""

    def __call__(self, image: Bytes) -> dict[str, Bytes]:
        channels = {"y": image[..., 0], "u": image[:, 0::2, 1], "v": image[:, 1::2, 1]}
        return {
            f"{name}{width}": sized
            for name, channel in channels.items()
            for width, sized in seeing.subsampled(np.ascontiguousarray(channel)).items()
        }


class Segmenter:
    """Maps 80 x 60 channels to the corners of the green field's convex hull, (n, 2), in pixels of the full image."""

    def __call__(self, y: Bytes, v: Bytes) -> seeing.Points | None:
        return seeing.field_hull(y, v)


class BallDetector:
    """Finds the ball's centre and radius in pixels of the full image: {u, v, radius}, or None if it sees no ball."""

    def __call__(self, hull: seeing.Points, fine: Bytes, coarse: Bytes) -> dict[str, float] | None:
        ball = seeing.find_ball(hull, fine, coarse)
        return None if ball is None else {"u": ball.u, "v": ball.v, "radius": ball.radius}


class SelfLocalization:
    """Yields the robot's estimated pose, {x, y, heading} in metres and radians, at the time of each frame."""

    def __init__(self, robot: str) -> None:
        self._robot = robot
        self._gait = Gait(robot)

    def __iter__(self) -> Iterator[At | None]:
        return _frames(self.pose)

    def pose(self, time_ns: int) -> dict[str, float]:
        """Return the estimated pose at a time in nanoseconds since the epoch."""
        believed = self._gait.believed(scenario.pose(self._robot, time_ns), time_ns)
        return {"x": believed.x, "y": believed.y, "heading": believed.heading}


class BallLocalization:
    """Maps the ball's pixel and the robot's pose to the ball's position on the field; None if that is not nearby."""

    def __call__(self, pixel: dict[str, float], pose: dict[str, float]) -> Position | None:
        ball = located(pixel["u"], pixel["v"], Pose(pose["x"], pose["y"], pose["heading"]))
        return None if ball is None else _as_value(ball)


class FuseBallPos:
    """Fuses two positions of the same time into one."""

    def __call__(self, first: Position, second: Position) -> Position:
        return _as_value(fused(_from_value(first), _from_value(second)))


def _frames(seen: Callable[[int], object]) -> Iterator[At | None]:
    """Yield `seen(time)` at the time of each frame, and None between frames."""
    from cfgplan_runtime import At  # here, since nodes of ROS run in a Python that may have no cfgplan

    clock = FrameClock()
    while True:
        time_ns = clock.frame(time.time_ns())
        yield None if time_ns is None else At(time_ns, seen(time_ns))


def _as_value(position: BallPosition) -> Position:
    (xx, xy), (_, yy) = position.covariance.tolist()
    covariance = [round(entry, 7) for entry in (xx, xy, yy)]
    return {"x": round(position.x, 4), "y": round(position.y, 4), "covariance": covariance}


def _from_value(value: Position) -> BallPosition:
    xx, xy, yy = value["covariance"]
    return BallPosition(value["x"], value["y"], np.array([[xx, xy], [xy, yy]]))
