"""The messages between a run and its relay of ROS 1 topics."""

from __future__ import annotations

from typing import TypeAlias

import msgspec

from cfgplan_runtime.children.messages import CloseOutlet, Cut, End, Finish, Lost, OpenOutlet, Switched, SwitchNow
from cfgplan_runtime.nodes.relay_messages import CloseInlets, Lead, Observe, Passed, Refused, Unsaid


class RelayOrder(msgspec.Struct, frozen=True):
    """The relay's name as a node, its master's address, and the host name under which other nodes reach it."""

    node: str
    master: str
    host: str


class Listening(msgspec.Struct, tag=True):
    """The relay is ready, and has this address as a node."""

    address: str


ToTopicRelay: TypeAlias = Lead | Cut | End | SwitchNow | OpenOutlet | CloseOutlet | Observe | CloseInlets | Finish
FromTopicRelay: TypeAlias = Listening | Switched | Lost | Passed | Refused | Unsaid
