"""Shared by the nodes of ROS 1 and ROS 2: the ports of the case's units, and their values as ROS messages.

Each node imports the message types of its own ROS installation; ROS 1 and ROS 2 name packages and fields equally.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from geometry_msgs.msg import Point32, PointStamped, PolygonStamped, PoseStamped, PoseWithCovarianceStamped
from sensor_msgs.msg import Image

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
"""The inputs and outputs of each class of `units.py`."""
SEEN = {"BottomCam": "picture", "SelfLocalization": "pose"}
"""The method of each class without inputs that returns its output at a time in ns."""
_MOST_WAITING = 64
"""The largest number of times that may wait for a missing input; the oldest is then dropped."""
_KINDS: dict[str, Any] = {
    "hull": PolygonStamped,
    "pixel": PointStamped,
    "pose": PoseStamped,
    "position": PoseWithCovarianceStamped,
    "first": PoseWithCovarianceStamped,
    "second": PoseWithCovarianceStamped,
}


def kind_of(port: str) -> Any:
    """Return the class of the messages at a port."""
    return _KINDS.get(port, Image)


def outputs_of(name: str, value: Any) -> dict[str, Any]:
    """Return the result of the class `name` as values by output; empty if it is None."""
    outputs = PORTS[name][1]
    if value is None:
        return {}
    return dict(value) if len(outputs) > 1 else {outputs[0]: value}


class Aligned:
    """Calls `step` with the values of all inputs and their time in ns, once all inputs have a value of that time."""

    def __init__(self, inputs: tuple[str, ...], step: Callable[[dict[str, Any], int], None]) -> None:
        self._inputs, self._step = inputs, step
        self._waiting: dict[int, dict[str, Any]] = {}

    def take(self, port: str, time_ns: int, message: Any) -> None:
        """Take the message of an input, whose stamp is `time_ns`."""
        values = self._waiting.setdefault(time_ns, {})
        values[port] = value_of(port, message)
        if len(values) == len(self._inputs):
            del self._waiting[time_ns]
            self._step(values, time_ns)
        while len(self._waiting) > _MOST_WAITING:
            del self._waiting[min(self._waiting)]


def message_of(port: str, value: Any) -> Any:
    """Convert a value at a port to a message without a stamp."""
    message = kind_of(port)()
    if port == "hull":
        message.polygon.points = [Point32(x=u, y=v) for u, v in value.tolist()]
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
    """Convert a message at a port to a value; the inverse of `message_of`."""
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
        return {"x": place.x, "y": place.y, "covariance": [float(covariance[at]) for at in (0, 1, 7)]}
    pixels = np.frombuffer(message.data, np.uint8)
    shape = (message.height, message.width) if message.encoding == "mono8" else (message.height, message.width, 2)
    return pixels.reshape(shape)
