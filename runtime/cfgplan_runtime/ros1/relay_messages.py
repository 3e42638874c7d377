"""What a run and its relay of ROS 1 topics say to each other."""

from __future__ import annotations

from typing import TypeAlias

import msgspec

from cfgplan_runtime.children.messages import (
    CloseOutlet,
    Cut,
    End,
    Finish,
    Flow,
    Lost,
    OpenOutlet,
    PortCounts,
    Switched,
    SwitchNow,
)


class RelayOrder(msgspec.Struct, frozen=True):
    """The relay's name as a node, its master's address, and the host that other nodes reach it by."""

    node: str
    master: str
    host: str


class Lead(msgspec.Struct, tag=True):
    """Lead what is published on `source` to an inlet, as its source or its standby: it comes out on `target`.

    `unit` is whose inlet it is, "" for a topic's outlet, which has the topic's name. Of several publishers only those
    of `publisher` count, if that is given. With `is_service`, both are services.
    """

    wire: int
    unit: str
    inlet: str
    source: str
    target: str
    queue: int
    publisher: str | None = None
    is_service: bool = False


class CloseInlets(msgspec.Struct, tag=True):
    """A unit is gone, and all topics that were for its inputs."""

    unit: str


class Passed(msgspec.Struct, tag=True):
    """A sign of life, with counts since the start: what came on each source topic, and what inlets and topics got."""

    sources: dict[str, int]
    inlets: dict[str, PortCounts]
    flows: dict[str, Flow]


class Listening(msgspec.Struct, tag=True):
    """The relay is there: its address as a node."""

    address: str


class Refused(msgspec.Struct, tag=True):
    """A node does not get what it asked the relay for, or the relay not what it asked a node for."""

    topic: str
    cause: str


ToTopicRelay: TypeAlias = Lead | Cut | End | SwitchNow | OpenOutlet | CloseOutlet | CloseInlets | Finish
FromTopicRelay: TypeAlias = Listening | Switched | Lost | Passed | Refused
