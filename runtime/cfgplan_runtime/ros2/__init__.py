"""ROS 2: nodes as units, and topics that units of other kinds read and publish, on any middleware."""

from cfgplan_runtime.ros2.units import Publisher, Subscriber

__all__ = ["Publisher", "Subscriber"]
