#!/usr/bin/env python3
"""Nodes for experiments, by the Python that has rclpy: `nodes.py NODE`, with a node's class in lower case."""

from __future__ import annotations

import sys
import time
from contextlib import suppress

import rclpy
from geometry_msgs.msg import PointStamped, PoseWithCovarianceStamped
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Image
from std_msgs.msg import Int64

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


class Numbered(Node):
    """Counts, `rate` numbers a second, in messages with a stamp, with the stamp of a time ten times as fast
    (`simulated`), without one (`plain`), or without a promise to arrive (`best_effort`).
    """

    def __init__(self) -> None:
        super().__init__("numbered")
        self.way = self.declare_parameter("way", "stamped").value
        reliability = ReliabilityPolicy.BEST_EFFORT if self.way == "best_effort" else ReliabilityPolicy.RELIABLE
        self.numbers = self.create_publisher(
            Int64 if self.way == "plain" else PointStamped, "n", QoSProfile(depth=100, reliability=reliability)
        )
        self.number, self.period_ns = 0, 10**9 // self.declare_parameter("rate", 50).value
        self.create_timer(self.period_ns / 1e9, self.give)

    def give(self) -> None:
        self.number += 1
        if self.way == "plain":
            self.numbers.publish(Int64(data=self.number))
            return
        message = PointStamped()
        message.header.frame_id = str(self.number)
        now_ns = 10 * self.number * self.period_ns if self.way == "simulated" else time.time_ns()
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(now_ns, 10**9)
        self.numbers.publish(message)


class Managed(LifecycleNode):
    """Numbers the fiftieths of a second while it is active, in messages with the time of each as stamp, or without one
    (`plain`): all such nodes give the same. Prints the first number, and by the monotonic clock in ns when it becomes
    active, inactive, and ends.
    """

    def __init__(self) -> None:
        super().__init__("managed")
        self.is_plain = self.declare_parameter("way", "stamped").value == "plain"
        self.rate = self.declare_parameter("rate", 50).value
        self.number = 0
        time.sleep(self.declare_parameter("sleep", 0.0).value)

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        self.numbers = self.create_lifecycle_publisher(Int64 if self.is_plain else PointStamped, "n", DEEP)
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        told(f"active {time.monotonic_ns()}")
        self.number = int(time.time() * self.rate)
        told(f"first {self.number}")
        self.timer = self.create_timer(0.1 / self.rate, self.give)
        result = super().on_activate(state)
        self.publish()
        return result

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        self.destroy_timer(self.timer)
        told(f"inactive {time.monotonic_ns()}")
        return super().on_deactivate(state)

    def give(self) -> None:
        while time.time() * self.rate >= self.number + 1:
            self.number += 1
            self.publish()

    def publish(self) -> None:
        if self.is_plain:
            self.numbers.publish(Int64(data=self.number))
            return
        message = PointStamped()
        message.header.frame_id = str(self.number)
        message.header.stamp.sec, rest = divmod(self.number, self.rate)
        message.header.stamp.nanosec = rest * (10**9 // self.rate)
        self.numbers.publish(message)


class Detector(Node):
    """Passes each message on after `delay` seconds. The numbers have this `way`."""

    def __init__(self) -> None:
        super().__init__("detector")
        way, delay_s = self.declare_parameter("way", "stamped").value, self.declare_parameter("delay", 0.002).value
        reliability = ReliabilityPolicy.BEST_EFFORT if way == "best_effort" else ReliabilityPolicy.RELIABLE
        quality = QoSProfile(depth=100, reliability=reliability)
        kind = Int64 if way == "plain" else PointStamped
        given = self.create_publisher(kind, "y", quality)

        def give(message: Int64 | PointStamped) -> None:
            time.sleep(delay_s)
            given.publish(message)

        self.create_subscription(kind, "x", give, quality)


class Tracker(Node):
    """Prints each number that it gets, with the monotonic time in ns. It asks for reliable messages."""

    def __init__(self) -> None:
        super().__init__("tracker")
        is_plain = self.declare_parameter("way", "stamped").value == "plain"

        def note(message: Int64 | PointStamped) -> None:
            number = message.data if is_plain else message.header.frame_id
            print("got", number, time.monotonic_ns(), flush=True)

        self.create_subscription(Int64 if is_plain else PointStamped, "x", note, DEEP)


def told(line: str) -> None:
    print(line, flush=True)


def main() -> None:
    rclpy.init()
    kinds = (Camera, Worker, Prepared, Clock, Listener, Numbered, Managed, Detector, Tracker)
    node = {each.__name__.lower(): each for each in kinds}[sys.argv[1]]()
    try:
        with suppress(KeyboardInterrupt, rclpy.executors.ExternalShutdownException):
            rclpy.spin(node)
    finally:
        if isinstance(node, Managed):
            told(f"ended {time.monotonic_ns()}")


if __name__ == "__main__":
    main()
