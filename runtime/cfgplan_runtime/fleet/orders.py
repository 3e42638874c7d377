"""What a manager and the agents of its hosts say to each other, and how: typed messages, in order and once."""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, NamedTuple, TypeAlias, TypeVar, get_args

import msgspec

from cfgplan.domain import Stream
from cfgplan_runtime.children.messages import FromRelay, ToRelay, UnitOrder
from cfgplan_runtime.streams.crossing import (
    PIECES_UNDER_WAY,
    Piece,
    Receiving,
    Sending,
    crossing_key,
    read_credit,
    read_frame,
)
from cfgplan_runtime.streams.zenoh_link import ZenohLink
from cfgplan_runtime.supervision import events
from cfgplan_runtime.supervision.backend import Inlet, Usage

SAY, HEARD, REFUSE = "say", "heard", "refuse"
"""Kinds of keys: messages, what was heard of them, and that a manager is not obeyed any more."""

Spoken = TypeVar("Spoken")


class Session(NamedTuple):
    """One conversation of a manager with an agent. Agents obey the highest term, and its first manager only."""

    term: int
    manager: str
    greeting: int

    def __str__(self) -> str:
        return f"{self.term}-{self.manager}-{self.greeting}"


def read_session(text: str) -> Session | None:
    """A session as its key has it; None if it is none."""
    parts = text.split("-")
    if len(parts) != 3 or not (parts[0].isdecimal() and parts[2].isdecimal()):
        return None
    return Session(int(parts[0]), parts[1], int(parts[2]))


# From the manager.


class GreetOrder(msgspec.Struct, tag=True):
    """The first order: end everything that runs, then say Welcome."""


class StartOrder(msgspec.Struct, tag=True):
    """Start a unit. `digest` is that of its source file at the manager, None if it has none there."""

    order: UnitOrder
    digest: str | None


class StopOrder(msgspec.Struct, tag=True):
    unit: str


class KillOrder(msgspec.Struct, tag=True):
    unit: str
    dump: bool


class ConnectOrder(msgspec.Struct, tag=True):
    wire: int
    stream: Stream
    inlet: Inlet
    queue: int
    blocks: bool


class CutOrder(msgspec.Struct, tag=True):
    wire: int
    inlet: Inlet


class EndWireOrder(msgspec.Struct, tag=True):
    wire: int
    stream: Stream
    inlet: Inlet


class SwitchOrder(msgspec.Struct, tag=True):
    inlet: Inlet


class OpenTopicOrder(msgspec.Struct, tag=True):
    topic: str


class CloseTopicOrder(msgspec.Struct, tag=True):
    topic: str


class RenewOrder(msgspec.Struct, tag=True):
    helper: str


class LeaveOrder(msgspec.Struct, tag=True):
    """The run is over: end everything that runs."""


Order: TypeAlias = (
    GreetOrder
    | StartOrder
    | StopOrder
    | KillOrder
    | ConnectOrder
    | CutOrder
    | EndWireOrder
    | SwitchOrder
    | OpenTopicOrder
    | CloseTopicOrder
    | RenewOrder
    | LeaveOrder
    | ToRelay
)


# From an agent.


class Welcome(msgspec.Struct, tag=True):
    """Nothing runs here any more, and orders are carried out. The topics' sockets will be in the folder `run`."""

    run: str


class EventTold(msgspec.Struct, tag=True):
    """An event of `supervision.events`, by the name of its class."""

    kind: str
    event: msgspec.Raw


class UsageTold(msgspec.Struct, tag=True):
    """What units have used by now."""

    usage: dict[str, Usage]


class RelayLost(msgspec.Struct, tag=True):
    """The relay has died, and with it all exports and imports; a new one takes its place."""

    cause: str


FromAgent: TypeAlias = Welcome | EventTold | UsageTold | RelayLost | FromRelay

_EVENTS = {kind.__name__: kind for kind in get_args(events.Event)}


def told(event: events.Event) -> EventTold:
    """An event as a message."""
    return EventTold(type(event).__name__, msgspec.Raw(msgspec.msgpack.encode(event)))


def event_of(message: EventTold) -> events.Event:
    """The event that a message tells of. Raises KeyError or msgspec.MsgspecError for none."""
    event: events.Event = msgspec.msgpack.decode(message.event, type=_EVENTS[message.kind])
    return event


class Talk(Generic[Spoken]):
    """One end of a session. Nothing waits: what is said is sent again by `pump` until it has come."""

    def __init__(self, link: ZenohLink, me: str, other: str, session: Session, incoming: object) -> None:
        self.session = session
        self.is_broken = False
        """Whether messages were lost for good, or are of another version: a new session is needed."""
        self._decoder: msgspec.msgpack.Decoder[Spoken] = msgspec.msgpack.Decoder(incoming)
        self._sending, self._receiving = Sending(granted=PIECES_UNDER_WAY), Receiving()
        self._put: Callable[[bytes, bytes], None] = link.publisher(crossing_key(me, SAY, other, str(session)), "orders")
        self._put_credit = link.publisher(crossing_key(me, HEARD, other, str(session)), "orders")

    def say(self, message: msgspec.Struct, now_s: float) -> None:
        """Have the other end told."""
        self._sending.offer(Piece(0, 0, msgspec.msgpack.encode(message)))
        self.pump(now_s)

    def hear(self, kind: str, head: bytes, payload: bytes, now_s: float) -> list[Spoken]:
        """Take what came at one of the session's keys. Returns the messages to handle now, in order."""
        if kind == HEARD:
            credit = read_credit(payload)
            if credit is not None:
                self._sending.hear(credit)
            return []
        frame = read_frame(head, payload)
        pieces = [] if frame is None else self._receiving.take(frame, now_s)
        self.is_broken = self.is_broken or self._receiving.dropped > 0
        try:
            return [self._decoder.decode(piece.payload) for piece in pieces]
        except msgspec.MsgspecError:
            self.is_broken = True
            return []

    def pump(self, now_s: float) -> None:
        """Send what is due."""
        for frame in self._sending.due(now_s):
            payload = b"" if frame.piece is None else bytes(frame.piece.payload)
            self._put(frame.head(), payload)
        credit = self._receiving.credit(now_s)
        if credit is not None:
            self._put_credit(b"", credit.packed())

    @property
    def is_done(self) -> bool:
        """Whether everything that was said has arrived."""
        return not self._sending.depth

    def due_s(self) -> float:
        """When `pump` has something to do, if nothing is heard before."""
        times = [due_s for due_s in (self._sending.due_s, self._receiving.due_s) if due_s is not None]
        return min(times, default=float("inf"))
