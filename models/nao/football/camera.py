"""The bottom camera as a pinhole above the ground: converts between field coordinates and pixels.

It stands 0.45 m high and looks 22 degrees down (the NAO's bottom camera with the head raised), 60.9 degrees wide; its
images have 640 x 480 pixels. A pixel is (u, v): u to the right and v down from the centre of the top left pixel.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

Matrix = npt.NDArray[np.float64]
Vector = npt.NDArray[np.float64]

WIDTH, HEIGHT = 640, 480
FOCAL = WIDTH / 2 / math.tan(math.radians(60.9 / 2))
CENTRE = ((WIDTH - 1) / 2, (HEIGHT - 1) / 2)
HEIGHT_M = 0.45
TILT = math.radians(22.0)


@dataclass(frozen=True)
class Pose:
    """The position of a robot in metres, and its heading in radians from the x axis."""

    x: float
    y: float
    heading: float


@dataclass(frozen=True)
class Camera:
    """A camera of a robot at `pose`; `tilt` and `roll` are in radians, `height` in metres."""

    pose: Pose
    height: float = HEIGHT_M
    tilt: float = TILT
    roll: float = 0.0

    @cached_property
    def place(self) -> Vector:
        """The camera's centre in field coordinates, (3,), in metres."""
        return np.array([self.pose.x, self.pose.y, self.height])

    @cached_property
    def turn(self) -> Matrix:
        """The rotation, (3, 3), from field directions to camera directions: right, down, forward."""
        ahead = np.array([math.cos(self.pose.heading), math.sin(self.pose.heading), 0.0])
        right = np.array([ahead[1], -ahead[0], 0.0])
        up = np.array([0.0, 0.0, 1.0])
        forward = math.cos(self.tilt) * ahead - math.sin(self.tilt) * up
        down = -math.sin(self.tilt) * ahead - math.cos(self.tilt) * up
        cos, sin = math.cos(self.roll), math.sin(self.roll)
        return np.stack([cos * right + sin * down, cos * down - sin * right, forward])

    @cached_property
    def from_ground(self) -> Matrix:
        """The homography, (3, 3), from ground points (x, y, 1) in metres to pixels (u, v, 1)."""
        columns = np.stack([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], -self.place], axis=1)
        matrix: Matrix = _LENS @ self.turn @ columns
        return matrix

    def seen_from(self, point: Vector) -> Vector:
        """Convert a point, (3,), from field to camera coordinates: right, down, forward, in metres."""
        seen: Vector = self.turn @ (point - self.place)
        return seen

    def pixel(self, point: Vector) -> tuple[float, float] | None:
        """Return the pixel (u, v) that shows a point of the field; None if the point is not in front of the camera."""
        right, down, forward = self.seen_from(point)
        if forward <= 1e-6:
            return None
        return CENTRE[0] + FOCAL * right / forward, CENTRE[1] + FOCAL * down / forward

    def ray(self, u: float, v: float) -> Vector:
        """Return the direction of a pixel's ray in field coordinates, (3,), not normalised."""
        direction: Vector = self.turn.T @ _to_direction(u, v)
        return direction

    def point_at_height(self, u: float, v: float, height: float) -> tuple[float, float] | None:
        """Return x and y where a pixel's ray is `height` above the ground, in metres; None if the ray does not fall."""
        ray = self.ray(u, v)
        if ray[2] >= -1e-6:
            return None
        reach = (height - self.height) / ray[2]
        return self.pose.x + reach * ray[0], self.pose.y + reach * ray[1]

    def horizon(self, u: float) -> float:
        """Return the row v of the horizon in column `u`."""
        slope = self.turn[:, 2]
        return float(CENTRE[1] - (slope[0] * (u - CENTRE[0]) + slope[2] * FOCAL) / slope[1])


_LENS: Matrix = np.array([[FOCAL, 0.0, CENTRE[0]], [0.0, FOCAL, CENTRE[1]], [0.0, 0.0, 1.0]])


def _to_direction(u: float, v: float) -> Vector:
    return np.array([(u - CENTRE[0]) / FOCAL, (v - CENTRE[1]) / FOCAL, 1.0])
