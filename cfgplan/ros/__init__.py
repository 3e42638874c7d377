"""ROS: message types, and graphs of nodes and topics from running systems, recordings and files."""

from cfgplan.ros.types import MessageType as MessageType
from cfgplan.ros.types import TypeKind as TypeKind
