"""The ball's position on the field from its pixel, with the error's covariance, and the fusion of two positions."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from football.camera import HEIGHT_M, Camera, Pose
from football.field import BALL_RADIUS_M

Covariance = npt.NDArray[np.float64]

POSITION_M = 0.045
"""The standard deviation of a robot's estimated position along each axis, in metres."""
HEADING = math.radians(1.6)
TILT = math.radians(0.55)
"""The standard deviation of the camera's tilt, in radians, which sways as the robot walks."""
FARTHEST_M = 6.0


@dataclass(frozen=True)
class BallPosition:
    """The ball's position on the field in metres, and the covariance of its error, (2, 2), in square metres."""

    x: float
    y: float
    covariance: Covariance


def located(u: float, v: float, pose: Pose) -> BallPosition | None:
    """Return where the ray of pixel (u, v) is one ball radius above the ground; None if that is not nearby."""
    place = Camera(pose).point_at_height(u, v, BALL_RADIUS_M)
    if place is None:
        return None
    ahead, aside = place[0] - pose.x, place[1] - pose.y
    distance = math.hypot(ahead, aside)
    if distance > FARTHEST_M:
        return None
    height = HEIGHT_M - BALL_RADIUS_M
    along = (distance * distance + height * height) / height * TILT
    across = distance * HEADING
    bearing = math.atan2(aside, ahead)
    turn = np.array([[math.cos(bearing), -math.sin(bearing)], [math.sin(bearing), math.cos(bearing)]])
    covariance = turn @ np.diag([along * along, across * across]) @ turn.T + POSITION_M**2 * np.eye(2)
    return BallPosition(place[0], place[1], covariance)


def fused(first: BallPosition, second: BallPosition) -> BallPosition:
    """Return the mean of two positions, weighted by the inverses of their covariances, with its covariance."""
    weights = [np.linalg.inv(one.covariance) for one in (first, second)]
    covariance = np.linalg.inv(weights[0] + weights[1])
    x, y = covariance @ (weights[0] @ (first.x, first.y) + weights[1] @ (second.x, second.y))
    return BallPosition(float(x), float(y), covariance)
