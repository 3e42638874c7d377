"""ROS as it is: message types, and the graphs of nodes and topics that running systems, recordings and files tell."""

from cfgplan.ros.types import MessageType as MessageType
from cfgplan.ros.types import TypeKind as TypeKind
