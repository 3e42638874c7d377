"""Unit code: what `source: units.py:NAME` names. `cfgplan run env.yaml` runs each unit in a process of its own."""

import itertools
import math


def thermometer(room):
    """A source: degrees in a room, which swing about 20."""
    phase = sum(map(ord, room))
    for step in itertools.count():
        yield round(20 + 2 * math.sin(step / 20 + phase), 2)


class Thermostat:
    """The position of a valve from 0 to 1, from the degrees of its room."""

    def __init__(self, comfort):
        self.comfort = comfort

    def __call__(self, celsius):
        return round(max(0.0, min(1.0, (self.comfort - celsius) / 2)), 2)


def boiler_control(valves):
    """The power of the boiler in kW; an input that takes several streams is a list of their values."""
    return round(2.5 * sum(valves), 1)
