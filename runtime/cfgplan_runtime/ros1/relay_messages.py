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
    """Lead what is published on the topic `source` to an inlet, as its source or standby. It comes out on `target`.

    `unit` owns the inlet; for the outlet of a topic it is "", and the inlet has the topic's name. If `publisher` is
    given, only that node's messages count. With `is_service`, `source` and `target` are services.
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
    """A unit is gone: close all inlets that fed it."""

    unit: str


class Passed(msgspec.Struct, tag=True):
    """A sign of life, with counts since the start: of messages by source topic, and of what inlets and topics got."""

    sources: dict[str, int]
    inlets: dict[str, PortCounts]
    flows: dict[str, Flow]


class Listening(msgspec.Struct, tag=True):
    """The relay is ready, and has this address as a node."""

    address: str


class Refused(msgspec.Struct, tag=True):
    """A node asked the relay for a topic and was refused."""

    topic: str
    cause: str


ToTopicRelay: TypeAlias = Lead | Cut | End | SwitchNow | OpenOutlet | CloseOutlet | CloseInlets | Finish
FromTopicRelay: TypeAlias = Listening | Switched | Lost | Passed | Refused
