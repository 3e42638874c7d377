"""ROS as it is: message types, and the graphs of nodes and topics that running systems, recordings and files tell."""

from cfgplan.ros.types import MessageType, TypeKind

__all__ = ["MessageType", "TypeKind"]
