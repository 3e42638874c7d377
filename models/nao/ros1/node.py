#!/usr/bin/env python3
"""The units of the case study as nodes of ROS 1: `node.py CLASS` runs a class of `units.py` on ROS's own messages.

It needs a Python that has cfgplan with its extra `demo`, of the version for which rospy is installed.
"""

from __future__ import annotations

import math
import sys
import threading
from pathlib import Path
from typing import Any

import numpy as np

try:
    import rospy
except ModuleNotFoundError:
    sys.path.append("/usr/lib/python3/dist-packages")  # where Debian has it, for its own Python
    import rospy

from geometry_msgs.msg import Point32, PointStamped, PolygonStamped, PoseStamped, PoseWithCovarianceStamped
from sensor_msgs.msg import Image

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
import units

CHANNELS = tuple(f"{channel}{width}" for channel in "yuv" for width in (640, 320, 160, 80, 40))
PORTS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "BottomCam": ((), ("image",)),
    "Subsampler": (("image",), CHANNELS),
    "Segmenter": (("y", "v"), ("hull",)),
    "BallDetector": (("hull", "fine", "coarse"), ("pixel",)),
    "SelfLocalization": ((), ("pose",)),
    "BallLocalization": (("pixel", "pose"), ("position",)),
    "FuseBallPos": (("first", "second"), ("position",)),
}
"""The inputs and outputs of each class."""
MOST_WAITING = 64
"""The moments for which an input may be missing."""
LOOK_S = 1 / 30


def main(name: str) -> None:
    """Run a class as a node until it is told to end."""
    rospy.init_node(name)
    inputs, outputs = PORTS[name]
    publishers = {port: rospy.Publisher(port, MESSAGES.get(port, Image), queue_size=8) for port in outputs}
    robot = rospy.get_param("~robot", None)
    unit = getattr(units, name)(*([] if robot is None else [robot]))

    def publish(value: Any, time_ns: int) -> None:
        if value is None:
            return
        for port, one in (value if len(outputs) > 1 else {outputs[0]: value}).items():
            if publishers[port].get_num_connections():
                message = message_of(port, one)
                message.header.stamp = rospy.Time(*divmod(time_ns, 10**9))
                publishers[port].publish(message)

    if inputs:
        steps = Aligned(inputs, lambda values, time_ns: publish(unit(**values), time_ns))
        for port in inputs:
            kind = MESSAGES.get(port, Image)
            rospy.Subscriber(port, kind, steps.take, port, queue_size=8, buff_size=1 << 24, tcp_nodelay=True)
        rospy.spin()
        return
    for given in unit:
        if rospy.is_shutdown():
            return
        if given is None:
            rospy.sleep(LOOK_S)
        else:
            publish(given.value, given.time_ns)


class Aligned:
    """Calls `step` with the values of all inputs, once it has those of one moment."""

    def __init__(self, inputs: tuple[str, ...], step: Any) -> None:
        self._inputs, self._step = inputs, step
        self._waiting: dict[int, dict[str, Any]] = {}
        self._lock = threading.Lock()

    def take(self, message: Any, port: str) -> None:
        """Take a message: rospy calls it from a thread of each publisher."""
        time_ns = message.header.stamp.to_nsec()
        with self._lock:
            values = self._waiting.setdefault(time_ns, {})
            values[port] = value_of(port, message)
            if len(values) == len(self._inputs):
                del self._waiting[time_ns]
                self._step(values, time_ns)
            while len(self._waiting) > MOST_WAITING:
                del self._waiting[min(self._waiting)]


MESSAGES: dict[str, Any] = {
    "hull": PolygonStamped,
    "pixel": PointStamped,
    "pose": PoseStamped,
    "position": PoseWithCovarianceStamped,
    "first": PoseWithCovarianceStamped,
    "second": PoseWithCovarianceStamped,
}
"""The message types of ports; all others are images."""


def message_of(port: str, value: Any) -> Any:
    """A value as a message."""
    message = MESSAGES.get(port, Image)()
    if port == "hull":
        message.polygon.points = [Point32(u, v, 0) for u, v in value.tolist()]
    elif port == "pixel":
        message.point.x, message.point.y, message.point.z = value["u"], value["v"], value["radius"]
    elif port == "pose":
        message.pose.position.x, message.pose.position.y = value["x"], value["y"]
        half = value["heading"] / 2
        message.pose.orientation.z, message.pose.orientation.w = math.sin(half), math.cos(half)
    elif port == "position":
        message.pose.pose.position.x, message.pose.pose.position.y = value["x"], value["y"]
        xx, xy, yy = value["covariance"]
        message.pose.covariance = [xx, xy, *[0.0] * 4, xy, yy, *[0.0] * 28]
    else:
        message.height, message.width = value.shape[:2]
        message.encoding = "mono8" if value.ndim == 2 else "yuv422_yuy2"
        message.step = value.nbytes // message.height
        message.data = value.tobytes()
    return message


def value_of(port: str, message: Any) -> Any:
    """A message as the value that it was made of."""
    if port == "hull":
        return np.array([(point.x, point.y) for point in message.polygon.points], np.float32)
    if port == "pixel":
        return {"u": message.point.x, "v": message.point.y, "radius": message.point.z}
    if port == "pose":
        turn = message.pose.orientation
        place = message.pose.position
        return {"x": place.x, "y": place.y, "heading": 2 * math.atan2(turn.z, turn.w)}
    if port in ("first", "second"):
        place, covariance = message.pose.pose.position, message.pose.covariance
        return {"x": place.x, "y": place.y, "covariance": [covariance[0], covariance[1], covariance[7]]}
    pixels = np.frombuffer(message.data, np.uint8)
    shape = (message.height, message.width) if message.encoding == "mono8" else (message.height, message.width, 2)
    return pixels.reshape(shape)


if __name__ == "__main__":
    main(sys.argv[1])
