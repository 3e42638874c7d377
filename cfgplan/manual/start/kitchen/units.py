"""Unit code: what `source: units.py:NAME` names. `cfgplan run env.yaml` runs each unit in a process of its own."""

import itertools
import math


def thermometer():
    """A source: a generator that is asked for a value at the transformation's rate."""
    for step in itertools.count():
        yield 40 + 30 * math.sin(step / 5)


def infrared_camera():
    """A source of small pictures: rows of degrees."""
    for step in itertools.count():
        warmest = 40 + 30 * math.sin(step / 5)
        yield [[20, 21, 20], [22, warmest, 21]]


def warmest_pixel(picture):
    """One step: the value of its input in, the value of its output out."""
    return max(max(row) for row in picture)


class FireAlarm:
    """A unit with a memory: constructed once with the transformation's params, then called for each step."""

    def __init__(self, limit):
        self.limit = limit
        self.burns = False

    def __call__(self, heat):
        self.burns = heat > self.limit or (self.burns and heat > self.limit - 20)
        return {"burns": self.burns, "celsius": round(heat, 1)}
