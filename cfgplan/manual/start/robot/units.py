"""Unit code: what `source: units.py:NAME` names. `cfgplan run env.yaml` runs each unit in a process of its own."""

import itertools
import math


def lidar():
    """A source: distances to the wall ahead, in metres; the robot leaves it and comes back every four minutes."""
    for step in itertools.count():
        ahead = 4 - _driven(step)
        yield [round(ahead / math.cos(math.radians(angle)), 3) for angle in range(-30, 31, 5)]


def scan_matcher(scan):
    """The pose, and the error of it in metres: far from the wall there is nothing to match."""
    ahead = min(scan)
    return {"x": 4 - ahead, "y": 0.0, "error": 0.05 if ahead < 3 else 0.8}


def camera():
    """A source of rows of pixels; the landmark is as wide as it is near."""
    for step in itertools.count():
        width = round(24 / (4.5 - _driven(step)))
        yield [[255 if abs(column - 12) < width / 2 else 0 for column in range(24)] for _ in range(4)]


def landmark_finder(image):
    """The pose from the width of the landmark."""
    width = sum(pixel > 0 for pixel in image[0])
    return {"x": 4.5 - 24 / max(width, 1), "y": 0.0}


class Driver:
    """A unit with a parameter: a speed towards the goal, slower when it is near."""

    def __init__(self, goal):
        self.goal = goal

    def __call__(self, pose):
        left = self.goal[0] - pose["x"]
        return {"linear": round(max(-0.5, min(0.5, left)), 2), "angular": 0.0}


def _driven(step):
    """Metres at a step: the robot goes to and fro between 3 and 0."""
    return 1.5 + 1.5 * math.cos(step / 400)
