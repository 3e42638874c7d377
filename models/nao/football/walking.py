"""The errors of a walking robot: its body sways, and its estimated pose drifts and jitters."""

from __future__ import annotations

import math
import zlib

import numpy as np

from football.camera import HEIGHT_M, TILT, Camera, Pose

_SWAY = math.radians(0.4)
_SWAY_HEIGHT_M = 0.004
_CALIBRATION = math.radians(0.3)
_DRIFT_M, _TREMBLE_M = 0.05, 0.012
_DRIFT_HEADING, _TREMBLE_HEADING = math.radians(1.8), math.radians(0.6)
_SECONDS = (9.0, 23.0)
"""The shortest and the longest period of the drift, in seconds."""


class Gait:
    """The errors of one robot, independent of other robots' errors. All but the tilt's average to zero in a minute."""

    def __init__(self, robot: str) -> None:
        own = np.random.default_rng(zlib.crc32(robot.encode()))
        self._tilt_error = _CALIBRATION * float(own.choice([-1.0, 1.0]))
        self._periods_s = own.uniform(*_SECONDS, 6)
        self._phases = own.uniform(0.0, 2 * math.pi, 6)
        self._random = np.random.default_rng(zlib.crc32(robot.encode()) + 1)

    def camera(self, pose: Pose) -> Camera:
        """Return the true camera of a robot at `pose`, with the sway of its body."""
        tilt, roll, height = self._random.normal(0.0, (_SWAY, _SWAY, _SWAY_HEIGHT_M))
        return Camera(pose, HEIGHT_M + height, TILT + self._tilt_error + tilt, roll)

    def believed(self, pose: Pose, time_ns: int) -> Pose:
        """Return the pose that the robot's self-localization reports at a time when its true pose is `pose`."""
        angle = 2 * math.pi * time_ns / 1e9 / self._periods_s + self._phases
        waves = np.sin(angle)
        x, y, heading = (waves[:3] + waves[3:]) / math.sqrt(2)
        tremble = self._random.normal(0.0, (_TREMBLE_M, _TREMBLE_M, _TREMBLE_HEADING))
        return Pose(
            pose.x + _DRIFT_M * x + tremble[0],
            pose.y + _DRIFT_M * y + tremble[1],
            pose.heading + _DRIFT_HEADING * heading + tremble[2],
        )
