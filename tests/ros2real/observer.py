#!/usr/bin/env python3
"""An observer for tests, by the Python that has rclpy: what comes on topics, and what the graph has, as lines of JSON.

`observer.py` does what lines of its input say: `{"listen": TOPIC, "type": TYPE, "latched": BOOL}` has every message
told that comes, `{"look": true}` the graph.
"""

from __future__ import annotations

import json
import os
import sys
import threading
from contextlib import suppress
from importlib import import_module
from typing import Any

import rclpy
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

TOLD = os.fdopen(os.dup(1), "w")
"""What is told; the middleware's own lines go where errors go."""
os.dup2(2, 1)


def say(**what: object) -> None:
    TOLD.write(json.dumps(what) + "\n")
    TOLD.flush()


def text_of(message: Any) -> str:
    """Its text; of a pose when and where it was, in ns and metres."""
    if hasattr(message, "pose"):
        stamp, place = message.header.stamp, message.pose.pose.position
        return f"{stamp.sec * 10**9 + stamp.nanosec} {place.x} {place.y}"
    return str(message.data if hasattr(message, "data") else message.header.frame_id)


def listen(node: Node, topic: str, kind: str, latched: bool, reliable: bool) -> None:
    module, _, name = kind.replace("/", ".").rpartition(".")
    durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
    reliability = ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT
    node.create_subscription(
        getattr(import_module(module), name),
        topic,
        lambda message: say(topic=topic, text=text_of(message)),
        QoSProfile(depth=1000, durability=durability, reliability=reliability),
    )


def look(node: Node) -> None:
    names = [topic for topic, _ in node.get_topic_names_and_types()]
    topics = [topic for topic in names if node.get_publishers_info_by_topic(topic)]
    heard = [topic for topic in names if node.get_subscriptions_info_by_topic(topic)]
    nodes = [f"{space.rstrip('/')}/{name}" for name, space in node.get_node_names_and_namespaces()]
    say(topics=topics, heard=heard, nodes=nodes)


def main() -> None:
    rclpy.init()
    node = Node("observer", enable_rosout=False, start_parameter_services=False)
    executor = rclpy.executors.SingleThreadedExecutor()
    executor.add_node(node)

    def hear() -> None:
        for line in sys.stdin:
            order = json.loads(line)
            if "listen" in order:
                work = lambda order=order: listen(  # noqa: E731
                    node, order["listen"], order["type"], order.get("latched", False), order.get("reliable", True)
                )
            else:
                work = lambda: look(node)  # noqa: E731
            executor.create_task(work)
        executor.create_task(rclpy.shutdown)

    threading.Thread(target=hear, daemon=True).start()
    say(begun=True)
    with suppress(KeyboardInterrupt, rclpy.executors.ExternalShutdownException):
        executor.spin()


if __name__ == "__main__":
    main()
