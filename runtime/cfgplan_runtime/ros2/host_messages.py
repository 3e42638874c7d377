"""What a run and its helper that speaks ROS 2 say to each other, as lines of JSON."""

from __future__ import annotations

from typing import TypeAlias

import msgspec

from cfgplan_runtime.children.messages import Lost, Switched
from cfgplan_runtime.nodes.relay_messages import Passed, Refused


class PortTopic(msgspec.Struct, frozen=True):
    """A port of a node: the topic or service that it was remapped to, and its message type if the file says it.

    `key` is what the qualities of service of the port are remembered by.
    """

    topic: str
    key: str
    message: str | None = None


class Attend(msgspec.Struct, tag=True):
    """Tell when the ports of a unit's node are there.

    At most `queue` messages wait at each input. With `is_again` a node of this name was there before, and endpoints
    that the graph has by now are of that one.
    """

    unit: str
    node: str
    inputs: list[PortTopic]
    outputs: list[PortTopic]
    queue: int
    is_foreign: bool = False
    is_again: bool = False
    asks: bool = False
    """Whether the node is asked each second whether it still answers."""


class Listening(msgspec.Struct, tag=True):
    """The helper is ready, on this middleware."""

    rmw: str = ""


class Attended(msgspec.Struct, tag=True):
    """A unit's node is there, with its ports, or late with some of them."""

    unit: str


class Gone(msgspec.Struct, tag=True):
    """A node that somebody else runs is not there, or not any more."""

    unit: str


class Answered(msgspec.Struct, tag=True):
    """A node that is asked whether it still answers has answered."""

    unit: str


class Told(msgspec.Struct, tag=True):
    """Something that the user of a unit should know."""

    unit: str
    text: str


FromHost: TypeAlias = Listening | Attended | Gone | Answered | Told | Switched | Lost | Passed | Refused
