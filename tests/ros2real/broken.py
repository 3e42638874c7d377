#!/usr/bin/env python3
"""Nodes that do what they should not, by the Python that has rclpy: `broken.py NODE`."""

from __future__ import annotations

import os
import sys
import time
from contextlib import suppress

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from std_msgs.msg import String

LINE = b"x" * 99 + b"\n"


class Shouter(Node):
    """Shouts what it hears."""

    def __init__(self, name: str = "shouter") -> None:
        super().__init__(name)
        loud = self.create_publisher(String, "~/loud", 1000)
        self.create_subscription(String, "quiet", lambda word: loud.publish(String(data=word.data + "!")), 1000)


class Flood(Shouter):
    """Prints 100 MB, then shouts."""

    def __init__(self) -> None:
        for _ in range(1000):
            os.write(1, LINE * 1000)
        super().__init__()


class Stuck(Shouter):
    """Takes an hour to be a node."""

    def __init__(self) -> None:
        time.sleep(3600)
        super().__init__()


class Shy(Shouter):
    """Shouts on a topic of its own that no file has."""

    def create_publisher(self, kind: type, topic: str, depth: int) -> object:
        return super().create_publisher(kind, "whisper" if topic == "~/loud" else topic, depth)


def main() -> None:
    rclpy.init()
    nodes = [{"flood": Flood, "stuck": Stuck, "shy": Shy, "pair": Shouter}[sys.argv[1]]()]
    if sys.argv[1] == "pair":
        nodes.append(Node("helper"))
    executor = SingleThreadedExecutor()
    for node in nodes:
        executor.add_node(node)
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        executor.spin()


if __name__ == "__main__":
    main()
