"""ROS 2: nodes as units, and topics that other units read and publish, on any middleware."""

from cfgplan_runtime.ros2.units import Publisher, Subscriber

__all__ = ["Publisher", "Subscriber"]
