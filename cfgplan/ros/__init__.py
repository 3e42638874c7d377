"""ROS as it is: message types, and the graphs of nodes and topics that running systems, recordings and files tell."""

from cfgplan.ros.liveliness import EndpointToken as EndpointToken
from cfgplan.ros.liveliness import LivelinessToken as LivelinessToken
from cfgplan.ros.liveliness import NodeToken as NodeToken
from cfgplan.ros.liveliness import Qos as Qos
from cfgplan.ros.liveliness import all_tokens as all_tokens
from cfgplan.ros.liveliness import read_token as read_token
from cfgplan.ros.types import MessageType as MessageType
from cfgplan.ros.types import TypeKind as TypeKind
