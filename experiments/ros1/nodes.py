#!/usr/bin/python3
"""Programs for `figures.py`: `nodes.py camera|worker` as nodes of ROS 1; `count` and `work` as units of cfgplan."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import Any


def count() -> Iterator[bytes]:
    number = 0
    while True:
        yield number.to_bytes(100, "little")
        number += 1


def work(x: bytes) -> bytes:
    return x


def camera() -> None:
    """Gives grey pictures, `~size` pixels wide, `~rate` of them each second."""
    import rospy
    from sensor_msgs.msg import Image

    rospy.init_node("camera")
    pictures, size = rospy.Publisher("n", Image, queue_size=10), rospy.get_param("~size")
    picture = Image(height=size, width=size, encoding="mono8", step=size, data=bytes(size * size))
    rate = rospy.Rate(rospy.get_param("~rate"))
    while not rospy.is_shutdown():
        picture.header.stamp = rospy.Time.now()
        pictures.publish(picture)
        rate.sleep()


def worker() -> None:
    """Gives the pictures that it gets."""
    import rospy
    from sensor_msgs.msg import Image

    def give(picture: Any) -> None:
        pictures.publish(picture)

    rospy.init_node("worker")
    pictures = rospy.Publisher("y", Image, queue_size=10)
    rospy.Subscriber("x", Image, give, queue_size=10, buff_size=1 << 24, tcp_nodelay=True)
    rospy.spin()


if __name__ == "__main__":
    {"camera": camera, "worker": worker}[sys.argv[1]]()
