"""Units of an underwater robot that searches a pipeline and follows it; simulated time passes `pace` times as fast.

`at_s` of an element is in simulated seconds since the epoch; `period_s` is the period of the visibility.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from typing import TypedDict

MEAN_M, SWING_M = 2.5, 1.25
"""The mean and the amplitude of the visibility, in metres."""
SPEED_M_S = 0.3
"""The robot's speed with all thrusters, in metres per second."""
SEEN_M = 1.15
"""The width in metres of the strip that the camera sees from an altitude of 1 m."""
PIPELINE_M = 4.3
"""The distance from the start of the search to the pipeline; with it a search takes about as long as in SUAVE."""


class Motion(TypedDict):
    """The robot's speed in metres per simulated second during the `for_s` simulated seconds until `at_s`."""

    speed: float
    for_s: float
    at_s: float


def simulated_s(pace: float) -> float:
    """Return the simulated time, in seconds since the epoch."""
    return time.time() * pace


def visibility_m(at_s: float, period_s: float) -> float:
    """Return the visibility at a simulated time, 1.25 to 3.75 m. A period begins at the mean, and rises first."""
    return MEAN_M + SWING_M * math.sin(2 * math.pi * at_s / period_s)


class Water:
    """Yields the visibility in metres, `range_m`, as a sensor measures it.

    `noise` is the standard deviation of the sensor's error, as a share of the visibility.
    """

    def __init__(self, period_s: float, pace: float = 1.0, noise: float = 0.0) -> None:
        import random

        self._period_s, self._pace, self._noise = period_s, pace, noise
        self._random = random.Random(1)

    def __iter__(self) -> Iterator[dict[str, float]]:
        while True:
            at_s = simulated_s(self._pace)
            seen_m = visibility_m(at_s, self._period_s) * (1 + self._random.gauss(0, self._noise))
            yield {"range_m": round(seen_m, 4), "at_s": at_s}


class Thrusters:
    """Yields the robot's motion at a `share` of its full speed: 1 with all thrusters."""

    def __init__(self, share: float, pace: float = 1.0) -> None:
        self._speed, self._pace = share * SPEED_M_S, pace

    def __iter__(self) -> Iterator[Motion]:
        last_s = simulated_s(self._pace)
        while True:
            now_s = simulated_s(self._pace)
            yield {"speed": self._speed, "for_s": now_s - last_s, "at_s": now_s}
            last_s = now_s


class Spiral:
    """Searches the ground in a spiral. A higher altitude shows a wider strip, if the water is clear enough."""

    def __init__(self, altitude: float, period_s: float) -> None:
        self._altitude, self._period_s = altitude, period_s
        self._searched_m2 = 0.0

    def __call__(self, motion: Motion) -> dict[str, object]:
        if visibility_m(motion["at_s"], self._period_s) >= self._altitude:
            self._searched_m2 += motion["speed"] * motion["for_s"] * SEEN_M * self._altitude
        radius_m = math.sqrt(self._searched_m2 / math.pi)
        return {
            "altitude": self._altitude,
            "searched_m2": round(self._searched_m2, 3),
            "found": radius_m >= PIPELINE_M,
        }

    def get_state(self) -> float:
        return self._searched_m2

    def set_state(self, state: float) -> None:
        self._searched_m2 = state


class Follow:
    """Follows the pipeline."""

    def __init__(self) -> None:
        self._inspected_m = 0.0

    def __call__(self, motion: Motion) -> dict[str, float]:
        self._inspected_m += motion["speed"] * motion["for_s"]
        return {"inspected_m": round(self._inspected_m, 3)}

    def get_state(self) -> float:
        return self._inspected_m

    def set_state(self, state: float) -> None:
        self._inspected_m = state
