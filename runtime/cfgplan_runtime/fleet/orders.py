"""Messages between a manager and the agents of its hosts, delivered once and in order."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import suppress
from dataclasses import is_dataclass
from functools import cache
from hashlib import sha256
from inspect import signature
from types import UnionType
from typing import Any, Generic, Literal, NamedTuple, TypeAlias, TypeVar, Union, get_args, get_origin, get_type_hints

import msgspec

from cfgplan import __version__
from cfgplan.domain import Stream
from cfgplan_runtime.children.messages import (
    CrossingCounts,
    Export,
    GivenInput,
    Import,
    ImportUnused,
    ToRelay,
    UnitOrder,
)
from cfgplan_runtime.streams import crossing
from cfgplan_runtime.streams.element import Buffer, Moment
from cfgplan_runtime.streams.zenoh_link import ZenohLink
from cfgplan_runtime.supervision import events
from cfgplan_runtime.supervision.backend import Inlet, Usage

SAY, HEARD, REFUSE = "say", "heard", "refuse"
"""Kinds of keys: for messages, for their acknowledgements, and for the refusal of a manager."""
OTHER_VERSION = "version"
"""The first word of the refusal by an agent that can't read an order. Its version and the cause follow."""

Spoken = TypeVar("Spoken")


class Session(NamedTuple):
    """A conversation of a manager with an agent. An agent obeys the highest term, and within it the first manager.

    `life` is the id of the agent's process: another agent of the same name takes no part.
    """

    term: int
    manager: str
    greeting: int
    life: str

    def __str__(self) -> str:
        return f"{self.term}-{self.manager}-{self.greeting}-{self.life}"


def read_session(text: str) -> Session | None:
    """The session of a key's last part; None if it is no session."""
    parts = text.split("-")
    if len(parts) != 4 or not (parts[0].isdecimal() and parts[2].isdecimal()):
        return None
    return Session(int(parts[0]), parts[1], int(parts[2]), parts[3])


# From the manager.


class GreetOrder(msgspec.Struct, tag=True):
    """The first order: end all units that the manager does not adopt (`adopts`), then answer Welcome.

    `secret` signs the heartbeats of the session. `version` is that of the manager's cfgplan, `fields` its
    `digest_of_fields`.
    """

    adopts: bool
    secret: bytes = b""
    version: str = ""
    fields: str = ""


class ClockOrder(msgspec.Struct, tag=True):
    """Correct the times of elements: this host's clock is ahead of the run's by `ahead_ns`. `Held` has the value."""

    ahead_ns: int


class StartOrder(msgspec.Struct, tag=True):
    """Start a unit of the transformation `label`, in the process of `spare` if one was prepared. `digest` is that of
    its source file on the manager's computer; None without such a file.
    """

    label: str
    order: UnitOrder
    digest: str | None
    spare: str | None = None


class PrepareOrder(msgspec.Struct, tag=True):
    """Prepare the cold spare that `order` names; the other fields are as in StartOrder."""

    label: str
    order: UnitOrder
    digest: str | None


class DiscardOrder(msgspec.Struct, tag=True):
    """End the process of a cold spare."""

    spare: str


class StopOrder(msgspec.Struct, tag=True):
    """Stop a unit once each of the crossings in `after` has delivered a mark for it."""

    unit: str
    after: tuple[str, ...] = ()


class KillOrder(msgspec.Struct, tag=True):
    unit: str
    dump: bool


class ActivateOrder(msgspec.Struct, tag=True):
    """Activate a unit, or deactivate it."""

    unit: str
    is_active: bool


class HoldOrder(msgspec.Struct, tag=True):
    unit: str


class AskPlacesOrder(msgspec.Struct, tag=True):
    unit: str
    inlets: dict[str, bool]


class AskStateOrder(msgspec.Struct, tag=True):
    unit: str
    until: dict[str, Moment]
    successor: str = ""


class GiveStateOrder(msgspec.Struct, tag=True):
    unit: str
    state: bytes | None
    inputs: dict[str, GivenInput]
    outputs: dict[str, Moment]


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
    """Open a topic at its address; `host` is the one that its target asked for."""

    topic: str
    host: str | None


class CloseTopicOrder(msgspec.Struct, tag=True):
    topic: str


class RenewOrder(msgspec.Struct, tag=True):
    helper: str


class HeldFailures(msgspec.Struct):
    """The failures in a row of a transformation on a host: it must not be started again for `left_s` seconds.

    `digest` is that of its start order, and `code` that of its source file on the manager's computer; None without such
    a file. `at_s` is the time of the message on the clock of the keeper.
    """

    number: int
    left_s: float
    cause: str
    digest: str
    source: str = ""
    code: str | None = None
    at_s: float = 0.0

    def at(self, now_s: float) -> HeldFailures:
        """The same failures at a later time of this clock."""
        left_s = max(0.0, self.left_s - (now_s - self.at_s))
        return msgspec.structs.replace(self, left_s=left_s, at_s=now_s)


class KeepFailuresOrder(msgspec.Struct, tag=True):
    """Keep the failures of the transformation `label` for the next manager; None: forget them."""

    label: str
    failures: HeldFailures | None


class LeaveOrder(msgspec.Struct, tag=True):
    """The run is over: end all units."""


Order: TypeAlias = (
    GreetOrder
    | ClockOrder
    | StartOrder
    | PrepareOrder
    | DiscardOrder
    | StopOrder
    | KillOrder
    | ActivateOrder
    | HoldOrder
    | AskPlacesOrder
    | AskStateOrder
    | GiveStateOrder
    | ConnectOrder
    | CutOrder
    | EndWireOrder
    | SwitchOrder
    | OpenTopicOrder
    | CloseTopicOrder
    | RenewOrder
    | KeepFailuresOrder
    | LeaveOrder
    | ToRelay
)


# From an agent.


class HeldStop(msgspec.Struct):
    """An order to stop a unit, given at `at_s` on the host's clock. Until the unit `is_told`, the host awaits elements
    of others.
    """

    at_s: float
    is_told: bool = False


class HeldUnit(msgspec.Struct):
    """A unit or spare: its transformation's label, its start order, its labor once it is ready, and the order to stop
    it. It was started at `since_s` on the host's clock.

    `handover` is its part in the last hand-over of a state: a new unit waits for the state and then has it; the unit
    that it replaces is asked for the state, for this `successor`. If it is not replaced after all, it has its own
    state again. It makes no step unless it `is_active`.
    """

    label: str
    order: UnitOrder
    labor_us: int | None = None
    stop: HeldStop | None = None
    since_s: float = 0.0
    is_active: bool = False
    handover: Literal["", "waits", "has it", "is asked"] = ""
    successor: str = ""


class HeldWire(msgspec.Struct):
    """The newest wire to an inlet. Its stream may be an import."""

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
    """A stream that comes from another host: the order, and the number of inputs that it has fed."""

    order: Import
    connected: int = 0


class Held(msgspec.Struct):
    """The units, wires and topics of an agent's host; `term` is that of the manager before the present one.

    `topics` has the host that each topic's target asked for. `now_s` is the present time of the host's monotonic clock.
    `failures` has the failures on this host by the label of the transformation. The highest number of a wire so far is
    `last_wire`; an inlet may still use the wire before its newest one.
    """

    term: int = 0
    now_s: float = 0.0
    units: dict[str, HeldUnit] = {}
    spares: dict[str, HeldUnit] = {}
    wires: list[HeldWire] = []
    topics: dict[str, str | None] = {}
    exports: dict[str, HeldExport] = {}
    imports: dict[str, HeldImport] = {}
    ahead_ns: int | None = None
    failures: dict[str, HeldFailures] = {}
    last_wire: int = 0

    def forget_wires(self, is_gone: Callable[[HeldWire], bool]) -> None:
        """Remove the wires that fulfil a condition."""
        self.wires = [one for one in self.wires if not is_gone(one)]


class HeldState(msgspec.Struct):
    """The last state that a unit had at `at_ns`, a time of the run."""

    at_ns: int
    state: bytes


class Welcome(msgspec.Struct, tag=True):
    """The agent obeys from now on. `held` has its units, wires and topics, and `states` the last states by name;
    sockets of topics are in the folder `run`. It answers heartbeats at the addresses `beats`, written `HOST PORT`.
    `version` is that of the agent's cfgplan, `fields` its `digest_of_fields`.
    """

    run: str
    held: Held
    beats: tuple[str, ...] = ()
    states: dict[str, HeldState] = {}
    version: str = ""
    fields: str = ""


class EventReport(msgspec.Struct, tag=True):
    """An event of `supervision.events`; `kind` is the name of its class."""

    kind: str
    event: msgspec.Raw


class UsageReport(msgspec.Struct, tag=True):
    """The usage of units so far, and the counts of each crossing from this host."""

    usage: dict[str, Usage]
    crossings: dict[str, CrossingCounts] = {}


def topics_key(host: str | None) -> str:
    """The key at which an agent answers with TopicsReport; None means any host."""
    return f"{crossing.host_key(host)}/topics"


class TopicsReport(msgspec.Struct):
    """An agent's answer to the question for topics: the run that it obeys, the topics on its host, and the difference
    of its clock from the run's.
    """

    run: str
    topics: list[str]
    ahead_ns: int = 0


def held_key(host: str | None) -> str:
    """The key at which an agent, or any (None), answers with Held."""
    return f"{crossing.host_key(host)}/held"


FromAgent: TypeAlias = Welcome | EventReport | UsageReport | ImportUnused

_EVENTS = {kind.__name__: kind for kind in events.Event.__subclasses__()}


@cache
def digest_of_fields() -> str:
    """Return a digest of all messages and events, and of the names, types and defaults of their fields.

    The two ends of a session compare it, since each drops fields that it does not know. The versions of Python and of
    msgspec make no difference.
    """
    said = dict[str, Any]()
    for kind in (Order, FromAgent, *_EVENTS.values()):
        _type_name(kind, said)
    return sha256(json.dumps(said, sort_keys=True).encode()).hexdigest()[:16]


def _type_name(kind: Any, said: dict[str, Any]) -> str:
    """Return the name of a type, and note the fields of all classes in it by the names of these."""
    parts = get_args(kind)
    if get_origin(kind) is Literal:
        return f"Literal{sorted(map(repr, parts))}"
    if parts:
        names = [_type_name(part, said) for part in parts]
        is_union = get_origin(kind) in (Union, UnionType)
        return " | ".join(sorted(names)) if is_union else f"{get_origin(kind).__name__}[{', '.join(names)}]"
    name = str(getattr(kind, "__name__", kind))
    has_fields = is_dataclass(kind) or hasattr(kind, "_fields") or hasattr(kind, "__struct_fields__")
    if has_fields and name not in said:
        said[name] = None  # a class may have fields of its own type
        defaults = {key: str(field.default) for key, field in signature(kind).parameters.items()}
        said[name] = [
            (key, _type_name(of, said), defaults[key]) for key, of in get_type_hints(kind).items() if key in defaults
        ]
    return name


def report_of(event: events.Event) -> EventReport:
    """An event as a message."""
    return EventReport(type(event).__name__, msgspec.Raw(msgspec.msgpack.encode(event)))


def event_of(message: EventReport) -> events.Event:
    """The event in a message. Raises msgspec.MsgspecError if the message is of another version."""
    if message.kind not in _EVENTS:
        raise msgspec.ValidationError(f"there is no event {message.kind}")
    event: events.Event = msgspec.msgpack.decode(message.event, type=_EVENTS[message.kind])
    return event


class OtherVersionError(Exception):
    """A message of another version of cfgplan can't be read. `theirs` is the other version; empty if unknown."""

    def __init__(self, theirs: str, cause: object) -> None:
        super().__init__(str(cause))
        self.theirs = theirs


def other_version(theirs: str, cause: object) -> str:
    """Return why a manager can't use an agent that has another version of cfgplan, and the mend."""
    known = f"cfgplan {theirs}" if theirs else "an unknown version of cfgplan"
    again = " from other sources" if theirs == __version__ else ""
    return (
        f"its agent has {known}{again}, and this run has cfgplan {__version__}: they do not understand each other "
        f"({cause}); install the same version on both, and start the agent again"
    )


class _Versioned(msgspec.Struct):
    """The version in a message whose other fields may be unknown."""

    version: str = ""
    fields: str = ""


class ReliableChannel(Generic[Spoken]):
    """One end of a session. No method blocks. `pump` sends all messages since its last call as one segment, and repeats
    it until it has arrived.
    """

    def __init__(self, link: ZenohLink, me: str, other: str, session: Session, incoming: object) -> None:
        self.session = session
        self.is_broken = False
        """Whether messages are lost for good, so that a new session is needed."""
        self._decoder: msgspec.msgpack.Decoder[list[Spoken]] = msgspec.msgpack.Decoder(list[incoming])  # type: ignore[valid-type]
        self.theirs: str | None = None
        """The version of cfgplan at the other end, by its first message; empty if that does not say it."""
        self._unsent: list[msgspec.Struct] = []
        self._both = crossing.DuplexChannel(crossing.Sending(granted=crossing.FRAMES_UNDER_WAY))
        self._put = link.publisher(crossing.crossing_key(me, SAY, other, str(session)), "orders")
        self._put_credit = link.publisher(crossing.crossing_key(me, HEARD, other, str(session)), "orders")

    def say(self, message: msgspec.Struct) -> None:
        """Queue a message for the next `pump`."""
        self._unsent.append(message)

    def hear(self, kind: str, head: bytes, payload: bytes, now_s: float) -> list[Spoken]:
        """Take a message at one of the session's keys. Returns the messages that can be handled now, in order.

        Raises OtherVersionError for a message of another version: none of the messages that came with it is returned.
        """
        segments = self._both.take(kind == HEARD, head, payload, now_s)
        self.is_broken = self.is_broken or self._both.receiving.dropped > 0
        return [message for segment in segments for message in self._read(segment.payload)]

    def _read(self, payload: Buffer) -> list[Spoken]:
        if self.theirs is None:
            said = _Versioned()
            with suppress(msgspec.MsgspecError):
                said = next(
                    (one for one in msgspec.msgpack.decode(payload, type=list[_Versioned]) if one.version), said
                )
            self.theirs = said.version
            if said.version and said.fields != digest_of_fields():
                raise OtherVersionError(said.version, "their messages differ")
        try:
            return self._decoder.decode(payload)
        except msgspec.MsgspecError as error:
            raise OtherVersionError(self.theirs, error) from None

    def pump(self, now_s: float) -> None:
        """Send the orders that are due."""
        if self._unsent:
            self._both.sending.offer(crossing.Segment(0, 0, msgspec.msgpack.encode(self._unsent)))
            self._unsent.clear()
        self._both.pump(self._put, self._put_credit, now_s)

    @property
    def is_done(self) -> bool:
        """Whether all sent messages have arrived."""
        return not (self._unsent or self._both.sending.depth)

    def due_s(self) -> float:
        """The time at which `pump` is due if no message arrives before."""
        return 0.0 if self._unsent else self._both.due_s
