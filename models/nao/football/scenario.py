"""The ground truth of the play: the ball's and the robots' places as functions of time, and the clock of the frames.

The truth for any element of a stream can be computed from its time stamp.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from football.camera import Pose

FRAMES_PER_S = 15
_NS_PER_S = 1_000_000_000
_OVERDUE = 4


@dataclass(frozen=True)
class _Companion:
    """How a robot goes along with the ball: its mean direction from the ball and distance, and how it sways."""

    direction: float
    distance_m: float
    period_s: float


_COMPANIONS = {"piff": _Companion(math.pi, 1.5, 31.0), "puff": _Companion(-0.9, 1.7, 26.0)}


def ball(time_ns: int) -> tuple[float, float]:
    """The ball's place on the field in metres, at a time in nanoseconds since the epoch."""
    return 2.3 * _wave(time_ns, 53.0), 1.3 * _wave(time_ns, 31.0, 0.8)


def light(time_ns: int, day_s: float | None) -> float:
    """How bright it is, from 0.05 at night to 1, half of each day that long; always 1 without days."""
    if day_s is None:
        return 1.0
    return min(1.0, max(0.05, 0.8 + 0.75 * _wave(time_ns, day_s)))


def pose(robot: str, time_ns: int) -> Pose:
    """Where a robot is and looks: it keeps 0.9 to 2.3 m from the ball, moves around it, and lets its gaze sway."""
    if robot not in _COMPANIONS:
        raise ValueError(f"no robot {robot!r} is on the field, only {', '.join(_COMPANIONS)}")
    companion = _COMPANIONS[robot]
    direction = companion.direction + 0.5 * _wave(time_ns, companion.period_s)
    distance = companion.distance_m + 0.6 * _wave(time_ns, 0.7 * companion.period_s, 1.0)
    gaze = 0.15 * _wave(time_ns, 0.31 * companion.period_s, 2.0)
    x, y = ball(time_ns)
    return Pose(
        x + distance * math.cos(direction),
        y + distance * math.sin(direction),
        _normal(direction + math.pi + gaze),
    )


class FrameClock:
    """Gives the frames their times: multiples of 1/15 s, the same for all robots, so that streams can be aligned.

    It is asked about twice as often, so that delays on a busy computer are made up for.
    """

    def __init__(self) -> None:
        self._last: int | None = None

    def frame(self, now_ns: int) -> int | None:
        """The time of the next frame that is due; None if none is. Frames that are long overdue are left out."""
        due = now_ns * FRAMES_PER_S // _NS_PER_S
        if self._last is None or due - self._last > _OVERDUE:
            self._last = due
        elif due > self._last:
            self._last += 1
        else:
            return None
        return time_of_frame(self._last)


def time_of_frame(number: int) -> int:
    """The time of a frame in nanoseconds since the epoch, rounded up to one."""
    return -(-number * _NS_PER_S // FRAMES_PER_S)


def _wave(time_ns: int, period_s: float, phase: float = 0.0) -> float:
    period_ns = round(period_s * _NS_PER_S)
    return math.sin(2 * math.pi * (time_ns % period_ns) / period_ns + phase)


def _normal(angle: float) -> float:
    return math.remainder(angle, 2 * math.pi)
