#!/usr/bin/env python3
"""The units of the underwater robot as nodes of ROS 2: `node.py CLASS` runs a class of `auv.py` on ROS's own messages.

It needs a Python with rclpy; cfgplan need not be there.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import rclpy
from geometry_msgs.msg import Point, TwistStamped
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.time import Time
from std_msgs.msg import Float64

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from auv import Follow, Motion, Spiral, Thrusters, Water

DEPTH = 8
RATES_HZ = {"Water": 5, "Thrusters": 20}
SEARCH = "/search"
"""The target's topic. A new altitude continues from the searched area that was published there."""
LISTENS_S = 1.0
"""A new altitude waits this long for the searched area of the previous one; at the first start none is published."""


class WaterNode(Node):
    """Publishes the visibility in metres."""

    def __init__(self) -> None:
        super().__init__("water")
        self._values = iter(Water(_number(self, "period_s", 80.0), noise=_number(self, "noise", 0.0)))
        self._visibility = self.create_publisher(Float64, "visibility", DEPTH)
        self.create_timer(1 / RATES_HZ["Water"], self._look)

    def _look(self) -> None:
        self._visibility.publish(Float64(data=next(self._values)["range_m"]))


class ThrustersNode(Node):
    """Publishes the speed of the robot."""

    def __init__(self) -> None:
        super().__init__("thrusters")
        self._values = iter(Thrusters(_number(self, "share", 1.0)))
        self._motion = self.create_publisher(TwistStamped, "motion", DEPTH)
        self.create_timer(1 / RATES_HZ["Thrusters"], self._push)

    def _push(self) -> None:
        value = next(self._values)
        message = TwistStamped()
        message.header.stamp = Time(nanoseconds=int(value["at_s"] * 1e9)).to_msg()
        message.twist.linear.x = value["speed"]
        self._motion.publish(message)


class MovedNode(Node):
    """A node that computes with the motion of the thrusters. Its first message only marks the beginning."""

    def __init__(self, name: str, moved: Callable[[Motion], None]) -> None:
        super().__init__(name)
        self._moved = moved
        self._last_s: float | None = None
        self.create_subscription(TwistStamped, "motion", self._move, DEPTH)

    def _move(self, message: TwistStamped) -> None:
        at_s = Time.from_msg(message.header.stamp).nanoseconds / 1e9
        if self._last_s is not None and at_s > self._last_s:
            self._moved({"speed": message.twist.linear.x, "for_s": at_s - self._last_s, "at_s": at_s})
        self._last_s = at_s


class SpiralNode(MovedNode):
    """Publishes a point: x is the altitude in metres, y the searched area, z is 1 if the pipeline was found."""

    def __init__(self) -> None:
        super().__init__("spiral", self._search)
        self._spiral = Spiral(_number(self, "altitude", 1.0), _number(self, "period_s", 80.0))
        self._path = self.create_publisher(Point, "path", DEPTH)
        self._listens_s = LISTENS_S
        self.create_subscription(Point, SEARCH, self._hear, DEPTH)

    def _hear(self, path: Point) -> None:
        self._listens_s = 0
        self._spiral.set_state(max(self._spiral.get_state(), path.y))

    def _search(self, motion: Motion) -> None:
        if self._listens_s > 0:
            self._listens_s -= motion["for_s"]
            return
        value: dict[str, Any] = self._spiral(motion)
        self._path.publish(Point(x=float(value["altitude"]), y=float(value["searched_m2"]), z=float(value["found"])))


class FollowNode(MovedNode):
    """Publishes the inspected length of the pipeline, in metres."""

    def __init__(self) -> None:
        super().__init__("follow", self._inspect)
        self._follow = Follow()
        self._seen = self.create_publisher(Float64, "seen", DEPTH)

    def _inspect(self, motion: Motion) -> None:
        self._seen.publish(Float64(data=self._follow(motion)["inspected_m"]))


NODES = {"Water": WaterNode, "Thrusters": ThrustersNode, "Spiral": SpiralNode, "Follow": FollowNode}


def _number(node: Node, name: str, usual: float) -> float:
    """A parameter, which may be written as a whole number."""
    given = node.declare_parameter(name, usual, ignore_override=False, descriptor=_any_type()).value
    return float(given)


def _any_type() -> Any:
    from rcl_interfaces.msg import ParameterDescriptor

    return ParameterDescriptor(dynamic_typing=True)


if __name__ == "__main__":
    rclpy.init()
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(NODES[sys.argv[1]]())
