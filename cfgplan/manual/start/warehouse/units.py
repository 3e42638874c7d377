"""Unit code: what `source: units.py:NAME` names. Each unit is a process on the host that was planned."""

import itertools


def scanner(robot):
    """A source: the free distance in each of 36 directions, in metres; crates come and go."""
    for step in itertools.count():
        crate = (step // 10 + (18 if robot == "r2" else 0)) % 36
        yield [2.0 if direction == crate else 5.0 for direction in range(36)]


class Mapper:
    """The directions in which a robot sees a crate."""

    def __init__(self, robot):
        self.robot = robot

    def __call__(self, scan):
        return {"robot": self.robot, "crates": [n for n, metres in enumerate(scan) if metres < 3]}


def merger(first, second):
    """The crates that each robot sees."""
    return {each["robot"]: each["crates"] for each in (first, second)}
