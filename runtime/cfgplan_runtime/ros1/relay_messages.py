"""The messages between a run and its relay of ROS 1 topics."""

from __future__ import annotations

from typing import TypeAlias

import msgspec

from cfgplan_runtime.children.messages import CloseOutlet, Cut, End, Finish, Lost, OpenOutlet, Switched, SwitchNow
from cfgplan_runtime.nodes.relay_messages import CloseInlets, Lead, Observe, Passed, Refused, Tap, Unsaid, Untap


class RelayOrder(msgspec.Struct, frozen=True):
    """The relay's name as a node, its master's address, and the host name under which other nodes reach it."""

    node: str
    master: str
    host: str


class Listening(msgspec.Struct, tag=True):
    """The relay is ready, and has this address as a node."""

    address: str


class TappedMessage(msgspec.Struct, tag=True):
    """A serialised message for the tap on `topic`, of the type `message` with this definition; `skipped` before it were
    not passed on.

    `time_ns` is its time in nanoseconds since 1970.
    """

    topic: str
    message: str
    definition: str
    time_ns: int
    skipped: int
    data: bytes


ToTopicRelay: TypeAlias = (
    Lead | Cut | End | SwitchNow | OpenOutlet | CloseOutlet | Observe | Tap | Untap | CloseInlets | Finish
)
FromTopicRelay: TypeAlias = Listening | Switched | Lost | Passed | Refused | TappedMessage | Unsaid
