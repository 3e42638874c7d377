"""The topics of a relay of ROS 1: those that it listens to, those that it publishes, and the inlets between them."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field

from cfgplan_runtime.nodes.message_layout import Layout
from cfgplan_runtime.ros1.tcpros import Framed, Header, MessageReader, MessageWriter
from cfgplan_runtime.streams.element import Moment
from cfgplan_runtime.streams.inlet import InputQueue

_TRUSTED_NS = 5_000_000_000
"""The largest distance of a message's stamp from now at which the stamp counts as its time."""
_STAMP = struct.Struct("<4xIII")
"""A message that begins with a header: its length, then the header's number, seconds and nanoseconds."""
_HEADER_TYPES = ("Header", "std_msgs/Header", "roslib/Header")


def begins_with_header(definition: str) -> bool:
    """Whether the first field of a message is a header. Comments and constants may stand before it."""
    said = (line.partition("#")[0] for line in definition.splitlines())
    first = next((line.split() for line in said if line.strip() and "=" not in line), [""])
    return first[0] in _HEADER_TYPES


@dataclass(slots=True, eq=False)
class RelayedPublication:
    """A topic that the relay publishes. Its `header`, with the type, must be known before nodes can subscribe."""

    topic: str
    queue: int
    header: Header | None = None
    is_known: bool = False
    """Whether it is registered with the master."""
    writers: list[MessageWriter] = field(default_factory=list)
    latched: Framed | None = None
    dropped: int = 0
    """The number of messages dropped for subscribers that are gone."""


@dataclass(slots=True, eq=False)
class RelayedInlet:
    """An inlet with its output topic; `reported` is the wire that was last reported as its source."""

    unit: str
    name: str
    queue: InputQueue
    publication: RelayedPublication
    reported: int | None = None
    elements: int = 0


@dataclass(slots=True, eq=False)
class SourceTopic:
    """A topic that the relay listens to. `wires` has the inlet of each wire, `offered` the number of messages that it
    got.

    `wanted` are the addresses of its publishers, `readers` the connections to them.
    """

    topic: str
    publisher: str | None
    wires: dict[int, RelayedInlet] = field(default_factory=dict)
    offered: dict[int, int] = field(default_factory=dict)
    wanted: set[str] = field(default_factory=set)
    readers: dict[str, MessageReader] = field(default_factory=dict)
    header: Header | None = None
    layout: Layout | None = None
    """The layout of its messages; None while it is not known, or can't be read from their definition."""
    has_stamp: bool = False
    messages: int = 0
    latched: Framed | None = None
    """The last message of a latched topic, for inlets that connect later."""
    last: Moment = (0, 0)

    def moment(self, message: Framed, now_ns: int) -> Moment:
        """The time of a message: its stamp, if that is near `now_ns`, else `now_ns`. Moments always rise."""
        time_ns = now_ns
        if self.has_stamp and len(message) >= _STAMP.size:
            _, seconds, nanoseconds = _STAMP.unpack_from(message)
            stamp_ns = seconds * 1_000_000_000 + nanoseconds
            if abs(stamp_ns - now_ns) < _TRUSTED_NS:
                time_ns = stamp_ns
        self.last = (time_ns, 0) if time_ns > self.last[0] else (self.last[0], self.last[1] + 1)
        return self.last
