#!/usr/bin/env python3
"""The units of the case study as nodes of ROS 2: `node.py CLASS` runs a class of `units.py` on ROS's own messages.

It needs a Python with rclpy, NumPy and OpenCV; cfgplan need not be there.
"""

from __future__ import annotations

import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.time import Time

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
import units
from football.scenario import FrameClock
from ros_messages import PORTS, SEEN, Aligned, kind_of, message_of, outputs_of

LOOK_S = 1 / 30
DEPTH = 8


class UnitNode(Node):
    """Calls a class with the messages at its inputs, or, for a source, at the time of each frame."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self._unit_name = name
        inputs, outputs = PORTS[name]
        self._outputs = {port: self.create_publisher(kind_of(port), port, DEPTH) for port in outputs}
        robot = self.declare_parameter("robot", "").value
        self._unit = getattr(units, name)(*([robot] if robot else []))
        self._aligned = Aligned(inputs, lambda values, time_ns: self._publish(self._unit(**values), time_ns))
        for port in inputs:
            self.create_subscription(kind_of(port), port, lambda message, port=port: self._take(port, message), DEPTH)
        if not inputs:
            self._frames = FrameClock()
            self.create_timer(LOOK_S, self._look)

    def _take(self, port: str, message: Any) -> None:
        self._aligned.take(port, Time.from_msg(message.header.stamp).nanoseconds, message)

    def _look(self) -> None:
        time_ns = self._frames.frame(time.time_ns())
        if time_ns is not None:
            self._publish(getattr(self._unit, SEEN[self._unit_name])(time_ns), time_ns)

    def _publish(self, value: Any, time_ns: int) -> None:
        for port, one in outputs_of(self._unit_name, value).items():
            if self._outputs[port].get_subscription_count():
                message = message_of(port, one)
                message.header.stamp = Time(nanoseconds=time_ns).to_msg()
                self._outputs[port].publish(message)


if __name__ == "__main__":
    rclpy.init()
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(UnitNode(sys.argv[1]))
