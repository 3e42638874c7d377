"""The units of the rescue robots, as `transformations.yaml` names them.

True poses are functions of time. The scouts ant and bee face each other, 10 m apart, and look from side to side.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]
Place = list[float]
"""[x, y] of a person, [x, y, heading] of a robot, or [bearing, distance] of a sighting; in metres and radians."""

PEOPLE = ((0.5, 1.8), (-1.0, -1.5), (2.0, -0.2))
_STARTS = {"ant": (-5.0, 0.0), "bee": (5.0, math.pi)}
_HALF_VIEW = math.radians(40)
_TALL = 0.9
"""The share of a picture's height that a person fills at a distance of one metre."""


def camera(robot: str) -> Iterator[Image]:
    """Yield pictures, (120, 160, 3), in which people are orange."""
    for picture in _pictures(robot, 120, 160):
        yield picture[..., None] // np.array([1, 2, 4], np.uint8)


def heat_camera(robot: str) -> Iterator[Image]:
    """Yield heat images, (60, 80), in which people are bright."""
    yield from _pictures(robot, 60, 80)


def localiser(robot: str) -> Iterator[Place]:
    """Yield the pose of a robot, [x, y, heading], in metres and radians."""
    while True:
        yield pose(robot, time.time())


def person_finder(image: Image) -> list[Place]:
    """Return bearing and distance, in radians and metres, of each person in a picture."""
    return _found(image[..., 0] - image[..., 2] > 100)


def warm_spot_finder(image: Image) -> list[Place]:
    """Return bearing and distance, in radians and metres, of each spot that is as warm as a person."""
    return _found(image > 150)


def search_map(ant: list[Place], ant_at: Place, bee: list[Place], bee_at: Place) -> list[Place]:
    """Return the positions of people, [x, y] in metres; a person that both scouts see is listed once."""
    found: list[Place] = []
    for sightings, (x, y, heading) in ((ant, ant_at), (bee, bee_at)):
        for bearing, distance in sightings:
            there = [x + distance * math.cos(heading + bearing), y + distance * math.sin(heading + bearing)]
            if all(math.dist(there, other) > 1 for other in found):
                found.append([round(each, 2) for each in there])
    return found


def pose(robot: str, time_s: float) -> Place:
    """Return the true pose of a robot at a time in seconds since the epoch."""
    x, heading = _STARTS[robot]
    return [x, math.sin(time_s / 11), heading + 0.2 * math.sin(time_s / 7)]


def _pictures(robot: str, height: int, width: int) -> Iterator[Image]:
    noise = np.random.default_rng(sum(robot.encode()))
    while True:
        picture = noise.integers(0, 60, (height, width), np.uint8)
        x, y, heading = pose(robot, time.time())
        for person in PEOPLE:
            bearing = math.remainder(math.atan2(person[1] - y, person[0] - x) - heading, math.tau)
            column = round(width * (bearing / _HALF_VIEW + 1) / 2)
            tall = round(height * _TALL / math.dist(person, (x, y)))
            top, left = (height - tall) // 2, column - tall // 4
            if left >= 0 and left + tall // 2 < width:
                picture[top : top + tall, left : left + tall // 2] = 200
        yield picture


def _found(mask: NDArray[np.bool_]) -> list[Place]:
    height, width = mask.shape
    tall = mask.sum(axis=0)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], tall > 0, [0]])))
    return [
        [((left + right) / width - 1) * _HALF_VIEW, height * _TALL / float(tall[left:right].max())]
        for left, right in edges.reshape(-1, 2).tolist()
    ]
