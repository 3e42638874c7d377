#!/usr/bin/env python3
"""Two nodes of rclpy, as any other: `cfgplan run` remaps their topics, here `scan` and `speed`."""

import sys
from contextlib import suppress

import rclpy
from rclpy.executors import ExternalShutdownException
from std_msgs.msg import Float64


def lidar(node):
    distance = node.declare_parameter("distance", 2.0).value
    publisher = node.create_publisher(Float64, "scan", 10)
    node.create_timer(0.1, lambda: publisher.publish(Float64(data=distance)))


def guard(node):
    publisher = node.create_publisher(Float64, "speed", 10)
    node.create_subscription(Float64, "scan", lambda scan: publisher.publish(Float64(data=scan.data / 5)), 10)


def main():
    rclpy.init()
    name = sys.argv[1]
    node = rclpy.create_node(name)
    {"lidar": lidar, "guard": guard}[name](node)
    with suppress(KeyboardInterrupt, ExternalShutdownException):  # how a node is stopped
        rclpy.spin(node)


if __name__ == "__main__":
    main()
