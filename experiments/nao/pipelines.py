"""The world of `models/nao`, the CPU time of its units, and a table of errors."""

from __future__ import annotations

import math
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2] / "models" / "nao"))

from football import scenario

ROBOTS = ("piff", "puff")


class Timed:
    """Calls units; `cpu_s` sums the CPU seconds of each."""

    def __init__(self) -> None:
        self.cpu_s: dict[str, float] = defaultdict(float)

    def __call__(self, unit: str, code: Callable[..., Any], **values: object) -> Any:
        start = time.process_time()
        result = code(**values)
        self.cpu_s[unit] += time.process_time() - start
        return result


def error(position: Mapping[str, Any], time_ns: int) -> tuple[float, float]:
    """Return the error of a position along both axes, in metres, at a time in nanoseconds since the epoch."""
    x, y = scenario.ball(time_ns)
    return position["x"] - x, position["y"] - y


def surprise(position: Mapping[str, Any], time_ns: int) -> float:
    """Return the squared Mahalanobis distance of the error; 2 on average if the position's covariance is right."""
    xx, xy, yy = position["covariance"]
    off = np.array(error(position, time_ns))
    return float(off @ np.linalg.solve([[xx, xy], [xy, yy]], off))


def distance(robot: str, time_ns: int) -> float:
    """Return the true distance from a robot to the ball, in metres."""
    pose, ball = scenario.pose(robot, time_ns), scenario.ball(time_ns)
    return math.hypot(pose.x - ball[0], pose.y - ball[1])


def summary(errors: list[tuple[float, float]]) -> str:
    """Return the cells of a table row: number of elements, root mean square, median, 95 % and largest error."""
    lengths = np.hypot(*np.array(errors).T)
    cells = (math.sqrt(float((lengths**2).mean())), np.median(lengths), np.quantile(lengths, 0.95), lengths.max())
    return " | ".join([f"{len(errors):,}", *(f"{100 * cell:.1f} cm" for cell in cells)])


HEAD = "| stream | positions | RMS error | median | 95 % below | largest |\n|---|---|---|---|---|---|"
