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
    """Tell when the ports of a unit's node are there. At most `queue` messages wait at each input.

    With `waits` it is a cold spare of a lifecycle node, which is only configured. With `asks` the node is asked each
    second whether it still answers.
    """

    unit: str
    node: str
    inputs: list[PortTopic]
    outputs: list[PortTopic]
    queue: int
    is_foreign: bool = False
    asks: bool = False
    waits: bool = False


class Begin(msgspec.Struct, tag=True):
    """A cold spare is a unit from now on: activate it."""

    spare: str
    unit: str


class Listening(msgspec.Struct, tag=True):
    """The helper is ready, on this middleware."""

    rmw: str = ""


class Attended(msgspec.Struct, tag=True):
    """A unit's node is there, with its ports, or late with some of them."""

    unit: str


class Configured(msgspec.Struct, tag=True):
    """A cold spare is configured, and waits."""

    unit: str


class Failed(msgspec.Struct, tag=True):
    """A lifecycle node does not let itself be configured or activated."""

    unit: str
    cause: str


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


FromHost: TypeAlias = (
    Listening | Attended | Configured | Failed | Gone | Answered | Told | Switched | Lost | Passed | Refused
)
