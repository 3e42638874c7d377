"""The messages between a run and its relay, the same for ROS 1 and ROS 2."""

from __future__ import annotations

import msgspec

from cfgplan_runtime.children.messages import Flow, PortCounts, Qualities


class Lead(msgspec.Struct, tag=True):
    """Connect the topic `source` to an inlet, as its source or standby; the relay publishes the messages on `target`.

    `unit` owns the inlet; for the outlet of a topic it is "", and the inlet has the topic's name. If `publisher` is
    given, only that node's messages count, if the relay can tell publishers apart. With `is_service`, `source` and
    `target` are services. `message` is the message type in the file, in ROS 2 spelling.
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


class Observe(msgspec.Struct, tag=True):
    """Read how good an output is: `fields` of its messages on `topic`, by the quality attributes that they say.

    `publisher` is as in Lead.
    """

    unit: str
    port: str
    topic: str
    fields: dict[str, str]
    publisher: str | None = None


class Tap(msgspec.Struct, tag=True):
    """Pass on messages of the topic `source` to the run, for a tap on `topic`, until Untap.

    `publisher` and `message` are as in Lead.
    """

    topic: str
    source: str
    publisher: str | None = None
    message: str | None = None


class Untap(msgspec.Struct, tag=True):
    """Pass on messages for a tap no more."""

    topic: str


class CloseInlets(msgspec.Struct, tag=True):
    """A unit has ended: close all inlets that fed it, and observe its outputs no more."""

    unit: str


class Passed(msgspec.Struct, tag=True):
    """A sign of life, with counts since the start: messages by source topic, and elements by inlet and by topic.

    `qualities` are by unit what its outputs have said since the last sign.
    """

    sources: dict[str, int]
    inlets: dict[str, PortCounts]
    flows: dict[str, Flow]
    qualities: dict[str, Qualities] = {}


class Refused(msgspec.Struct, tag=True):
    """A node and the relay can't be connected on a topic."""

    topic: str
    cause: str


class Unsaid(msgspec.Struct, tag=True):
    """An observed output does not say how good it is."""

    unit: str
    text: str
