"""The units of `models/nao` called one after the other in this process, and errors as a table."""

from __future__ import annotations

import math
import sys
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2] / "models" / "nao"))

import units
from football import scenario

ROBOTS = ("piff", "puff")


class Pipeline:
    """One robot's units; `cpu_s` adds up what each takes."""

    def __init__(self, robot: str) -> None:
        self.robot = robot
        self.cpu_s: dict[str, float] = defaultdict(float)
        self._camera = units.BottomCam(robot)
        self._self_localization = units.SelfLocalization(robot)
        self._subsampler = units.Subsampler()
        self._segmenter = units.Segmenter()
        self._detector = units.BallDetector()
        self._localization = units.BallLocalization()

    def position(self, time_ns: int) -> units.Position | None:
        """Where the robot says that the ball is."""
        image = self._timed("bottom_cam", self._camera.picture, time_ns)
        sizes = self._timed("subsampler", self._subsampler, image=image)
        hull = self._timed("segmenter", self._segmenter, y=sizes["y80"], v=sizes["v80"])
        pose = self._timed("self_localization", self._self_localization.pose, time_ns)
        if hull is None:
            return None
        pixel = self._timed("ball_detector", self._detector, hull=hull, fine=sizes["y640"], coarse=sizes["y320"])
        if pixel is None:
            return None
        found: units.Position | None = self._timed("ball_localization", self._localization, pixel=pixel, pose=pose)
        return found

    def _timed(self, unit: str, function: Callable[..., Any], *values: object, **ports: object) -> Any:
        start = time.process_time()
        result = function(*values, **ports)
        self.cpu_s[unit] += time.process_time() - start
        return result


def error(position: units.Position, time_ns: int) -> tuple[float, float]:
    """How far a position is from the truth of its moment, along both axes, in metres."""
    x, y = scenario.ball(time_ns)
    return position["x"] - x, position["y"] - y


def surprise(position: units.Position, time_ns: int) -> float:
    """The squared error in units of its own covariance; 2 on average if that is honest."""
    xx, xy, yy = position["covariance"]
    off = np.array(error(position, time_ns))
    return float(off @ np.linalg.solve([[xx, xy], [xy, yy]], off))


def distance(robot: str, time_ns: int) -> float:
    """From a robot to the ball, in metres."""
    pose, ball = scenario.pose(robot, time_ns), scenario.ball(time_ns)
    return math.hypot(pose.x - ball[0], pose.y - ball[1])


def summary(errors: list[tuple[float, float]]) -> str:
    """Cells of a table: elements, root mean square, median, 95 %, largest."""
    lengths = np.hypot(*np.array(errors).T)
    cells = (math.sqrt(float((lengths**2).mean())), np.median(lengths), np.quantile(lengths, 0.95), lengths.max())
    return " | ".join([f"{len(errors):,}", *(f"{100 * cell:.1f} cm" for cell in cells)])


HEAD = "| stream | positions | RMS error | median | 95 % below | largest |\n|---|---|---|---|---|---|"
