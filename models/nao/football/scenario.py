"""The ground truth of the game: the positions of ball and robots as functions of time, and the clock of the frames.

The true state for any element of a stream can be computed from its time, in nanoseconds since the epoch.
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
    """Return the ball's position on the field, (x, y) in metres, at a time."""
    return 2.3 * _wave(time_ns, 53.0), 1.3 * _wave(time_ns, 31.0, 0.8)


def light(time_ns: int, day_s: float | None) -> float:
    """Return the brightness, from 0.05 at night to 1 by day. Day and night last `day_s` seconds; None: no night."""
    if day_s is None:
        return 1.0
    return min(1.0, max(0.05, 0.8 + 0.75 * _wave(time_ns, day_s)))


def pose(robot: str, time_ns: int) -> Pose:
    """Return the true pose of a robot: it moves around the ball at 0.9 to 2.3 m, and its heading sways.

    Raises ValueError for an unknown robot.
    """
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
    """Tells which frames are due. Their times are multiples of 1/15 s for all robots, so that streams can be aligned.

    Call `frame` about twice as often, so that delays on a busy computer skip no frame.
    """

    def __init__(self) -> None:
        self._last: int | None = None

    def frame(self, now_ns: int) -> int | None:
        """Return the time of the next frame that is due; None if none is. Frames that are long overdue are skipped."""
        due = now_ns * FRAMES_PER_S // _NS_PER_S
        if self._last is None or due - self._last > _OVERDUE:
            self._last = due
        elif due > self._last:
            self._last += 1
        else:
            return None
        return time_of_frame(self._last)


def time_of_frame(number: int) -> int:
    """Return the time of a frame, rounded up to a nanosecond."""
    return -(-number * _NS_PER_S // FRAMES_PER_S)


def _wave(time_ns: int, period_s: float, phase: float = 0.0) -> float:
    period_ns = round(period_s * _NS_PER_S)
    return math.sin(2 * math.pi * (time_ns % period_ns) / period_ns + phase)


def _normal(angle: float) -> float:
    return math.remainder(angle, 2 * math.pi)
