"""ROS 2 topics of a run, in the wire format of `rmw_zenoh`: units read and write them, and targets are published."""

from cfgplan_runtime.ros2.units import Publisher, Subscriber

__all__ = ["Publisher", "Subscriber"]
