#!/usr/bin/env python3
"""An observer for tests, by the Python that has rclpy: what comes on topics, and what the graph has, as lines of JSON.

`observer.py` does what lines of its input say: `{"listen": TOPIC, "type": TYPE, "latched": BOOL}` has every message
told that comes, `{"look": true}` the graph, and `{"publish": TOPIC, "type": TYPE, "texts": [...], "every": S}` has
these texts published one after the other, again and again.
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
    if hasattr(message, "x"):
        return f"{message.x} {message.y} {message.z}"
    return str(message.header.frame_id if hasattr(message, "header") else message.data)


def class_of(kind: str) -> Any:
    module, _, name = kind.replace("/", ".").rpartition(".")
    return getattr(import_module(module), name)


def quality(latched: bool = False, reliable: bool = True) -> QoSProfile:
    durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
    reliability = ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT
    return QoSProfile(depth=1000, durability=durability, reliability=reliability)


def listen(node: Node, topic: str, kind: str, **qualities: bool) -> None:
    tell = lambda message: say(topic=topic, text=text_of(message))  # noqa: E731
    node.create_subscription(class_of(kind), topic, tell, quality(**qualities))


def publish(node: Node, topic: str, kind: str, texts: list[str], every: float, **qualities: bool) -> None:
    """Publish texts; again and again if `every` is not 0."""
    cls, waiting = class_of(kind), [*texts]
    publisher = node.create_publisher(cls, topic, quality(**qualities))

    def send() -> None:
        waiting.extend([] if waiting else texts)
        publisher.publish(cls(data=waiting.pop(0)))

    if every:
        node.create_timer(every, send)
    else:
        for _ in texts:
            send()


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
                work = lambda order=order: listen(node, order.pop("listen"), order.pop("type"), **order)  # noqa: E731
            elif "publish" in order:
                work = lambda order=order: publish(node, order.pop("publish"), order.pop("type"), **order)  # noqa: E731
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
