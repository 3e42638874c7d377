"""What a manager and the agents of its hosts say to each other, and how: typed messages, in order and once."""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, NamedTuple, TypeAlias, TypeVar

import msgspec

from cfgplan.domain import Stream
from cfgplan_runtime.children.messages import CrossingCounts, Export, Import, ImportUnused, ToRelay, UnitOrder
from cfgplan_runtime.streams import crossing
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
    """The first order: end everything that runs, unless it is to be adopted, then say Welcome."""

    adopts: bool


class ClockOrder(msgspec.Struct, tag=True):
    """This host's clock is so far ahead of the run's, by which elements have their times. It is in Held."""

    ahead_ns: int


class StartOrder(msgspec.Struct, tag=True):
    """Start a unit of the transformation `label`, as the `spare` that was prepared. `digest` is that of its source file
    at the manager, None if it has none there.
    """

    label: str
    order: UnitOrder
    digest: str | None
    spare: str | None = None


class PrepareOrder(msgspec.Struct, tag=True):
    """Prepare a cold spare, which `order` names; the rest is as in StartOrder."""

    label: str
    order: UnitOrder
    digest: str | None


class DiscardOrder(msgspec.Struct, tag=True):
    """End what was prepared for a cold spare."""

    spare: str


class StopOrder(msgspec.Struct, tag=True):
    """Stop a unit once it has what was given before to the crossings that it comes `after`."""

    unit: str
    after: tuple[str, ...] = ()


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
    """Give a topic its address; `host` is that of its target."""

    topic: str
    host: str | None


class CloseTopicOrder(msgspec.Struct, tag=True):
    topic: str


class RenewOrder(msgspec.Struct, tag=True):
    helper: str


class LeaveOrder(msgspec.Struct, tag=True):
    """The run is over: end everything that runs."""


Order: TypeAlias = (
    GreetOrder
    | ClockOrder
    | StartOrder
    | PrepareOrder
    | DiscardOrder
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


class HeldUnit(msgspec.Struct):
    """A unit that runs, or a spare: its transformation's label, how it was started, and its labor once it is ready."""

    label: str
    order: UnitOrder
    labor_us: int | None = None
    is_stopping: bool = False


class HeldWire(msgspec.Struct):
    """The newest wire to an inlet. The stream may be that of an import."""

    wire: int
    stream: Stream
    inlet: Inlet
    has_switched: bool = False


class HeldExport(msgspec.Struct):
    """A stream that goes to another host: the order, and the wire from its unit."""

    order: Export
    wire: int = 0
    stream: Stream | None = None


class HeldImport(msgspec.Struct):
    """What comes from another host: the order, and how many inputs it has been led to."""

    order: Import
    connected: int = 0


class Held(msgspec.Struct):
    """What an agent keeps on its host by the orders of its managers; `term` is that of the one before this.

    `topics` have the host of their target.
    """

    term: int = 0
    units: dict[str, HeldUnit] = {}
    spares: dict[str, HeldUnit] = {}
    wires: list[HeldWire] = []
    topics: dict[str, str | None] = {}
    exports: dict[str, HeldExport] = {}
    imports: dict[str, HeldImport] = {}
    ahead_ns: int | None = None

    def forget_wires(self, is_gone: Callable[[HeldWire], bool]) -> None:
        """Leave the wires out of which this is so."""
        self.wires = [one for one in self.wires if not is_gone(one)]


class Welcome(msgspec.Struct, tag=True):
    """Orders are carried out. `held` is all that runs here. The topics' sockets are in the folder `run`."""

    run: str
    held: Held


class EventTold(msgspec.Struct, tag=True):
    """An event of `supervision.events`, by the name of its class."""

    kind: str
    event: msgspec.Raw


class UsageTold(msgspec.Struct, tag=True):
    """What units have used by now, and what has gone over each crossing from this host."""

    usage: dict[str, Usage]
    crossings: dict[str, CrossingCounts] = {}


class TopicsTold(msgspec.Struct):
    """What an agent answers who asks: the run that it obeys, the topics that are there, and how far its clock is ahead
    of the run's.
    """

    run: str
    topics: list[str]
    ahead_ns: int = 0


FromAgent: TypeAlias = Welcome | EventTold | UsageTold | ImportUnused

_EVENTS = {kind.__name__: kind for kind in events.Event.__subclasses__()}


def told(event: events.Event) -> EventTold:
    """An event as a message."""
    return EventTold(type(event).__name__, msgspec.Raw(msgspec.msgpack.encode(event)))


def event_of(message: EventTold) -> events.Event:
    """The event that a message tells of. Raises msgspec.MsgspecError for one of another version."""
    if message.kind not in _EVENTS:
        raise msgspec.ValidationError(f"there is no event {message.kind}")
    event: events.Event = msgspec.msgpack.decode(message.event, type=_EVENTS[message.kind])
    return event


class Talk(Generic[Spoken]):
    """One end of a session. Nothing waits: `pump` sends what was said since its last call together, again and again
    until it has come.
    """

    def __init__(self, link: ZenohLink, me: str, other: str, session: Session, incoming: object) -> None:
        self.session = session
        self.is_broken = False
        """Whether messages were lost for good: a new session is needed."""
        self._decoder: msgspec.msgpack.Decoder[list[Spoken]] = msgspec.msgpack.Decoder(list[incoming])  # type: ignore[valid-type]
        self._unsent: list[msgspec.Struct] = []
        self._both = crossing.Conversation(crossing.Sending(granted=crossing.PIECES_UNDER_WAY))
        self._put = link.publisher(crossing.crossing_key(me, SAY, other, str(session)), "orders")
        self._put_credit = link.publisher(crossing.crossing_key(me, HEARD, other, str(session)), "orders")

    def say(self, message: msgspec.Struct) -> None:
        """Have the other end told with the next `pump`."""
        self._unsent.append(message)

    def hear(self, kind: str, head: bytes, payload: bytes, now_s: float) -> list[Spoken]:
        """Take what came at one of the session's keys. Returns the messages to handle now, in order.

        Raises msgspec.MsgspecError for a message of another version.
        """
        pieces = self._both.take(kind == HEARD, head, payload, now_s)
        self.is_broken = self.is_broken or self._both.receiving.dropped > 0
        return [message for piece in pieces for message in self._decoder.decode(piece.payload)]

    def pump(self, now_s: float) -> None:
        """Send what is due."""
        if self._unsent:
            self._both.sending.offer(crossing.Piece(0, 0, msgspec.msgpack.encode(self._unsent)))
            self._unsent.clear()
        self._both.pump(self._put, self._put_credit, now_s)

    @property
    def is_done(self) -> bool:
        """Whether everything that was said has arrived."""
        return not (self._unsent or self._both.sending.depth)

    def due_s(self) -> float:
        """When `pump` has something to do, if nothing is heard before."""
        return 0.0 if self._unsent else self._both.due_s
