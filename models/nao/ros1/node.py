#!/usr/bin/env python3
"""The units of the case study as nodes of ROS 1: `node.py CLASS` runs a class of `units.py` on ROS's own messages.

It needs a Python with NumPy and OpenCV, of the version for which rospy is installed.
"""

from __future__ import annotations

import sys
import threading
import time
from pathlib import Path
from typing import Any

try:
    import rospy
except ModuleNotFoundError:
    sys.path.append("/usr/lib/python3/dist-packages")  # where Debian has it, for its own Python
    import rospy

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
import units
from football.scenario import FrameClock
from ros_messages import PORTS, SEEN, Aligned, kind_of, message_of, outputs_of

LOOK_S = 1 / 30


def main(name: str) -> None:
    """Run the class `name` of `units.py` as a node until ROS shuts it down."""
    rospy.init_node(name)
    inputs, outputs = PORTS[name]
    publishers = {port: rospy.Publisher(port, kind_of(port), queue_size=8) for port in outputs}
    robot = rospy.get_param("~robot", None)
    unit = getattr(units, name)(*([] if robot is None else [robot]))

    def publish(value: Any, time_ns: int) -> None:
        for port, one in outputs_of(name, value).items():
            if publishers[port].get_num_connections():
                message = message_of(port, one)
                message.header.stamp = rospy.Time(*divmod(time_ns, 10**9))
                publishers[port].publish(message)

    if inputs:
        steps = Aligned(inputs, lambda values, time_ns: publish(unit(**values), time_ns))
        lock = threading.Lock()

        def take(message: Any, port: str) -> None:
            with lock:  # rospy calls it from a thread of each publisher
                steps.take(port, message.header.stamp.to_nsec(), message)

        for port in inputs:
            rospy.Subscriber(port, kind_of(port), take, port, queue_size=8, buff_size=1 << 24, tcp_nodelay=True)
        rospy.spin()
        return
    clock, seen = FrameClock(), getattr(unit, SEEN[name])
    while not rospy.is_shutdown():
        time_ns = clock.frame(time.time_ns())
        if time_ns is None:
            rospy.sleep(LOOK_S)
        else:
            publish(seen(time_ns), time_ns)


if __name__ == "__main__":
    main(sys.argv[1])
