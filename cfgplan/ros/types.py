"""Message types of ROS: one value for every spelling of a type."""

from __future__ import annotations

import re
from typing import Literal

from cfgplan.errors import InputError
from cfgplan.frozen import dataclass

TypeKind = Literal["msg", "srv", "action"]
_PATH = re.compile(
    r"""(?P<package>[A-Za-z]\w*)
    (?P<between>/|::|\.)
    (?:(?P<kind>msg|srv|action)(?P=between)(?P<dds>dds_(?P=between))?)?
    (?P<name>[A-Za-z]\w*)""",
    re.VERBOSE | re.ASCII,
)


@dataclass(frozen=True, slots=True, order=True)
class MessageType:
    """The type of a topic, service or action: `MessageType("nav_msgs", "Odometry")`."""

    package: str
    name: str
    kind: TypeKind = "msg"

    @classmethod
    def read(cls, text: str, kind: TypeKind = "msg") -> MessageType:
        """The type that a text spells in any of the ways there are.

        ROS 1 (`nav_msgs/Odometry`), ROS 2 (`nav_msgs/msg/Odometry`), DDS (`nav_msgs::msg::dds_::Odometry_`), C++
        (`nav_msgs::msg::Odometry`) and Python (`nav_msgs.msg.Odometry`). `kind` is that of a text that names none,
        as ROS 1 does not. Raises InputError.
        """
        found = _PATH.fullmatch(text.strip())
        if found is None:
            raise InputError.of(f"`{text}` is no message type", mend="write it as package/Name or package/msg/Name")
        named: TypeKind | None = found["kind"]  # type: ignore[assignment]
        name = found["name"]
        return cls(found["package"], name.removesuffix("_") if found["dds"] else name, named or kind)

    @property
    def ros1(self) -> str:
        """As ROS 1 writes it: `nav_msgs/Odometry`."""
        return f"{self.package}/{self.name}"

    @property
    def ros2(self) -> str:
        """As ROS 2 writes it: `nav_msgs/msg/Odometry`."""
        return f"{self.package}/{self.kind}/{self.name}"

    @property
    def dds(self) -> str:
        """As ROS 2 writes it on the wire: `nav_msgs::msg::dds_::Odometry_`."""
        return f"{self.package}::{self.kind}::dds_::{self.name}_"

    def __str__(self) -> str:
        return self.ros2
