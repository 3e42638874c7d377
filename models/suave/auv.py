"""Units of an underwater robot that looks for a pipeline and follows it, simulated `pace` times as fast as in truth.

Elements carry simulated seconds as `at_s`; a day of the water is a period of the visibility.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from typing import TypedDict

MEAN_M, SWING_M = 2.5, 1.25
"""The visibility swings around its mean, in metres."""
SPEED_M_S = 0.3
"""The robot's speed with all thrusters."""
SEEN_M = 1.15
"""How wide a strip the camera sees from an altitude of 1 m."""
PIPELINE_M = 4.3
"""How far from the start of the search the pipeline is: so that a search takes about as long as in SUAVE."""


class Motion(TypedDict):
    """The robot's speed in metres per simulated second, for so many simulated seconds until `at_s`."""

    speed: float
    for_s: float
    at_s: float


def simulated_s(pace: float) -> float:
    """Simulated seconds since the epoch."""
    return time.time() * pace


def visibility_m(at_s: float, period_s: float) -> float:
    """How far one sees under water, from 1.25 to 3.75 m; a period begins with the mean, and clears up first."""
    return MEAN_M + SWING_M * math.sin(2 * math.pi * at_s / period_s)


class Water:
    """Gives the visibility in metres, `range_m`; `noise` is the standard deviation of a sensor's error."""

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
    """Drives the robot: with all thrusters, or more slowly with those that are left."""

    def __init__(self, share: float, pace: float = 1.0) -> None:
        self._speed, self._pace = share * SPEED_M_S, pace

    def __iter__(self) -> Iterator[Motion]:
        last_s = simulated_s(self._pace)
        while True:
            now_s = simulated_s(self._pace)
            yield {"speed": self._speed, "for_s": now_s - last_s, "at_s": now_s}
            last_s = now_s


class Spiral:
    """Searches the ground in a spiral. From higher up a wider strip is seen, where the water is clear enough."""

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
