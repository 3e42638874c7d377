"""What a run and a relay say to each other, whichever ROS the relay speaks."""

from __future__ import annotations

import msgspec

from cfgplan_runtime.children.messages import Flow, PortCounts


class Lead(msgspec.Struct, tag=True):
    """Lead what is published on the topic `source` to an inlet, as its source or standby. It comes out on `target`.

    `unit` owns the inlet; for the outlet of a topic it is "", and the inlet has the topic's name. If `publisher` is
    given, only that node's messages count, where a relay can tell. With `is_service`, `source` and `target` are
    services. `message` is the message type that the file says, as ROS 2 writes it.
    """

    wire: int
    unit: str
    inlet: str
    source: str
    target: str
    queue: int
    publisher: str | None = None
    is_service: bool = False
    message: str | None = None


class CloseInlets(msgspec.Struct, tag=True):
    """A unit is gone: close all inlets that fed it."""

    unit: str


class Passed(msgspec.Struct, tag=True):
    """A sign of life, with counts since the start: of messages by source topic, and of what inlets and topics got."""

    sources: dict[str, int]
    inlets: dict[str, PortCounts]
    flows: dict[str, Flow]


class Refused(msgspec.Struct, tag=True):
    """A node and the relay do not agree on a topic."""

    topic: str
    cause: str
