"""From the ball's pixel to the field, with the error to be expected, and the fusion of two such positions."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from football.camera import HEIGHT_M, Camera, Pose
from football.field import BALL_RADIUS_M

Covariance = npt.NDArray[np.float64]

POSITION_M = 0.045
"""What a robot does not know of its place, as a standard deviation along each axis."""
HEADING = math.radians(1.6)
TILT = math.radians(0.55)
"""How far the camera may be tilted otherwise than it is thought to be; it sways as the robot walks."""
FARTHEST_M = 6.0


@dataclass(frozen=True)
class BallPosition:
    """The ball on the field in metres, and the covariance of its error."""

    x: float
    y: float
    covariance: Covariance


def located(u: float, v: float, pose: Pose) -> BallPosition | None:
    """Where the ray of the ball's centre is one radius above the ground; None if that is nowhere near."""
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
    """The most likely position if both covariances are true: each counts by the inverse of its own."""
    weights = [np.linalg.inv(one.covariance) for one in (first, second)]
    covariance = np.linalg.inv(weights[0] + weights[1])
    x, y = covariance @ (weights[0] @ (first.x, first.y) + weights[1] @ (second.x, second.y))
    return BallPosition(float(x), float(y), covariance)
