"""ROS as it is: message types, and the graphs of nodes and topics that running systems, recordings and files tell."""

from cfgplan.ros.liveliness import EndpointToken, LivelinessToken, NodeToken, Qos, all_tokens, read_token
from cfgplan.ros.types import MessageType, TypeKind

__all__ = [
    "EndpointToken",
    "LivelinessToken",
    "MessageType",
    "NodeToken",
    "Qos",
    "TypeKind",
    "all_tokens",
    "read_token",
]
