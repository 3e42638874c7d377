#!/usr/bin/env python3
"""Nodes for experiments, by the Python that has rclpy: `nodes.py camera|worker|prepared|clock|listener`."""

from __future__ import annotations

import sys
import time
from contextlib import suppress

import rclpy
from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import Image

DEEP = QoSProfile(depth=100)


class Camera(Node):
    """Gives `rate` messages each second: images of `size` bytes, or poses if that is 0."""

    def __init__(self) -> None:
        super().__init__("camera")
        size = self.declare_parameter("size", 100).value
        self.message = Image(encoding="mono8", height=1, width=size, step=size, data=bytes(size))
        if not size:
            self.message = PoseWithCovarianceStamped()
        self.messages = self.create_publisher(type(self.message), "n", DEEP)
        self.create_timer(1 / self.declare_parameter("rate", 100).value, self.give)

    def give(self) -> None:
        self.message.header.stamp.sec, self.message.header.stamp.nanosec = divmod(time.time_ns(), 10**9)
        self.messages.publish(self.message)


class Worker(Node):
    """Gives the images that it gets."""

    def __init__(self) -> None:
        super().__init__("worker")
        given = self.create_publisher(Image, "y", DEEP)
        self.create_subscription(Image, "x", given.publish, DEEP)


class Prepared(LifecycleNode):
    """Gives the images that it gets while it is active."""

    def __init__(self) -> None:
        super().__init__("prepared")

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        self.given = self.create_lifecycle_publisher(Image, "y", DEEP)
        self.create_subscription(Image, "x", self.given.publish, DEEP)
        return super().on_configure(state)


class Clock(Node):
    """Measures how old the images are that it gets: prints their number, median and 99th percentile in us, of each
    `number` of them.
    """

    def __init__(self) -> None:
        super().__init__("clock")
        self.number = self.declare_parameter("number", 500).value
        self.ages: list[int] = []
        self.create_subscription(Image, "x", self.note, DEEP)

    def note(self, image: Image) -> None:
        stamp = image.header.stamp
        self.ages.append(time.time_ns() - stamp.sec * 10**9 - stamp.nanosec)
        if len(self.ages) == self.number:
            ages = sorted(self.ages)
            print("ages", len(ages), ages[len(ages) // 2] // 1000, ages[len(ages) * 99 // 100] // 1000, flush=True)
            self.ages = []


class Listener(Node):
    """Prints when each image comes, by the monotonic clock in ns."""

    def __init__(self) -> None:
        super().__init__("listener")
        print("up", flush=True)
        self.create_subscription(Image, "x", lambda _: print(time.monotonic_ns(), flush=True), DEEP)


def main() -> None:
    rclpy.init()
    kinds = (Camera, Worker, Prepared, Clock, Listener)
    node = {each.__name__.lower(): each for each in kinds}[sys.argv[1]]()
    with suppress(KeyboardInterrupt, rclpy.executors.ExternalShutdownException):
        rclpy.spin(node)


if __name__ == "__main__":
    main()
