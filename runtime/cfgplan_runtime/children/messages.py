"""Messages between supervisor, nursery and child processes."""

from __future__ import annotations

from typing import Any, TypeAlias

import msgspec

from cfgplan_runtime.streams.element import Moment
from cfgplan_runtime.streams.measured_stream import Quality


class UnitOrder(msgspec.Struct, frozen=True, tag=True):
    """All that a child needs to be a unit.

    Its source is relative to `folder`; the times of its elements are the monotonic clock plus the offset.
    """

    unit: str
    source: str
    params: dict[str, Any]
    inputs: list[str]
    outputs: list[str]
    start: str
    tolerance_ns: int
    period_ns: int | None
    queue: int
    blocks: bool
    state_name: str | None
    state: bytes | None
    memory_bytes: int | None
    format: str = "json"
    """How a program reads and writes."""
    folder: str = ""
    clock_offset_ns: int = 0
    optional: list[str] = []
    """The inputs that no step waits for."""
    services: list[str] = []
    """The inputs that neither start a step nor hold one back."""
    counts: dict[str, int] = {}
    """The number of streams of each input that takes several; ALL: every matching one."""
    qualities: dict[str, dict[str, str | None]] = {}
    """By output: the quality attributes that it states, each with the field of a value that says it, if one does."""
    idle_sign_ns: int = 1_000_000_000
    """Nanoseconds between two signs of life while nothing comes and nothing is done."""
    stop_us: int | None = None
    """Microseconds that the unit may take to end, for a supervisor that does not know its transformation; None if that
    has no `stop`.
    """


class SpareOrder(msgspec.Struct, frozen=True, tag=True):
    """All that a child needs to construct the code of a unit, and to be one once it is told to BeginUnit."""

    order: UnitOrder


class OutletOrder(msgspec.Struct, frozen=True, tag=True):
    """All that a child needs to be the outlets of a run."""

    folder: str
    queue: int
    clock_offset_ns: int


ChildOrder: TypeAlias = UnitOrder | SpareOrder | OutletOrder


class OfWire(msgspec.Struct):
    """A message about a wire at an input or output."""

    port: str
    wire: int


# To a child.


class Feed(OfWire, tag=True):
    """Attach the receiving end that comes along to an input, as its source or its standby."""


class Serve(OfWire, tag=True):
    """Send an output's elements to one more subscriber, whose sending end comes along."""

    queue: int
    blocks: bool


class Cut(OfWire, tag=True):
    """Detach an input from one of its sources."""


class End(OfWire, tag=True):
    """An input's source has died: take the elements that it has sent, then detach, even if another process holds its
    socket open.
    """


class Unserve(OfWire, tag=True):
    """A subscriber of an output has died: drop it, even if another process holds its socket open."""


class SwitchNow(msgspec.Struct, tag=True):
    """Switch to the standby now, without waiting for the active source."""

    port: str


class OpenOutlet(msgspec.Struct, tag=True):
    """Own a topic's address and send its elements to all that connect. The message carries the listening socket."""

    topic: str


class CloseOutlet(msgspec.Struct, tag=True):
    topic: str


class SetClock(msgspec.Struct, tag=True):
    """From now on the times of elements are the monotonic clock plus this offset."""

    offset_ns: int


class Export(msgspec.Struct, tag=True):
    """Make an input, the crossing, whose elements go to another host; at most `queue` wait if it `blocks`."""

    crossing: str
    host: str
    queue: int
    blocks: bool


class Import(msgspec.Struct, tag=True):
    """Make an output, the crossing, with the elements that another host exports."""

    crossing: str
    host: str


class Release(msgspec.Struct, tag=True):
    """Give up an export or import."""

    crossing: str


class BeginUnit(msgspec.Struct, tag=True):
    """Be this unit from now on, with the state of an earlier one."""

    unit: str
    state: bytes | None


class Activate(msgspec.Struct, tag=True):
    """Begin to work: all streams of the update that started the unit are connected."""


class Deactivate(msgspec.Struct, tag=True):
    """Give nothing until the next Activate: an undone update has disconnected the unit."""


class HoldSteps(msgspec.Struct, tag=True):
    """Begin no step before the state of another unit has come."""


class TellPlaces(msgspec.Struct, tag=True):
    """Tell `Places` of these inlets, once all are known. If an inlet is true, its place is its first element."""

    inlets: dict[str, bool]


class TellState(msgspec.Struct, tag=True):
    """Tell `StateTold` between two steps, once each inlet in `until` has received the element of this moment."""

    until: dict[str, Moment]


class GivenElement(msgspec.Struct, frozen=True):
    """An element that a unit has received and gives to the next one."""

    time_ns: int
    turn: int
    payload: bytes


class GivenInput(msgspec.Struct, frozen=True):
    """The part of a state that is an inlet's: no step is still to be made with an element up to the moment `done`.

    `elements` has those that the next unit has not received itself: they wait for a step, or are the latest.
    """

    done: Moment
    elements: list[GivenElement] = []

    @property
    def last(self) -> Moment:
        """The moment of the last element that the next unit need not receive itself."""
        return max([self.done, *((one.time_ns, one.turn) for one in self.elements)])


class TakeState(msgspec.Struct, tag=True):
    """Take the state of an earlier unit, if one is given, and begin at its place in each inlet of `inputs`. Elements of
    each output in `outputs` come after its moment.

    A unit that does not wait for a state continues with its own: it is not replaced after all.
    """

    state: bytes | None
    inputs: dict[str, GivenInput]
    outputs: dict[str, Moment]


class Finish(msgspec.Struct, tag=True):
    """Process the elements that have arrived, then end."""


class TellMark(msgspec.Struct, tag=True):
    """Tell the other host, for a unit there, once it has received everything that an export has got until now."""

    crossing: str
    unit: str


ToRelay: TypeAlias = Export | Import | Release | TellMark
ToChild: TypeAlias = (
    Feed
    | Serve
    | Cut
    | End
    | Unserve
    | SwitchNow
    | OpenOutlet
    | CloseOutlet
    | SetClock
    | ToRelay
    | BeginUnit
    | Activate
    | Deactivate
    | HoldSteps
    | TellPlaces
    | TellState
    | TakeState
    | Finish
)


# From a child.


class Ready(msgspec.Struct, tag=True):
    """The unit code is constructed, and waits for Activate; `cpu_ns` is the CPU time of this, in nanoseconds."""

    cpu_ns: int


class Prepared(msgspec.Struct, tag=True):
    """The unit code is constructed, and waits for BeginUnit.

    `changed_ns` has the files in the code folder that were imported, and when each was last changed.
    """

    cpu_ns: int
    changed_ns: dict[str, int]


class Switched(OfWire, tag=True):
    """The wire is its input's active source now."""


class Lost(OfWire, tag=True):
    """An input's active source has ended without a standby."""


class Trouble(msgspec.Struct, tag=True):
    """Unit code failed in a step. If `suppressed` is not 0, it stands for that many failures up to this step."""

    kind: str
    step: int
    text: str
    suppressed: int = 0


class Exhausted(msgspec.Struct, tag=True):
    """A source has ended: it has no more elements."""


class PortCounts(msgspec.Struct, frozen=True):
    """The elements that went through one port since the start, and those that wait there now.

    `dropped` elements had no room, `stale` ones were repeated by a new source, `skipped` ones found no partner of
    their time.
    """

    elements: int = 0
    dropped: int = 0
    stale: int = 0
    skipped: int = 0
    waiting: int = 0


Qualities: TypeAlias = dict[str, dict[str, Quality]]
"""By output and attribute."""


class UnitSign(msgspec.Struct, tag=True):
    """A sign of life, with counts since the start, and the state if it is to survive a restart."""

    steps: int
    errors: int
    inputs: dict[str, PortCounts]
    outputs: dict[str, PortCounts]
    state: bytes | None = None
    qualities: Qualities = {}


class Places(msgspec.Struct, tag=True):
    """The moment from which each inlet that was asked for gets every element."""

    moments: dict[str, Moment]


class StateTold(msgspec.Struct, tag=True):
    """A unit's state between two steps, with its place in each input, and the moment of each output's last element.

    `state` is empty if its code gives none. It is None if the unit does not know its place either, and does not pause.
    """

    state: bytes | None
    inputs: dict[str, GivenInput]
    outputs: dict[str, Moment]


class Flow(msgspec.Struct, frozen=True):
    """The traffic of a topic: elements per second, the median age at arrival in milliseconds, and counts.

    An element's age is counted from when its source element was made. Rate and age are over the last 3 seconds:
    `rate_hz` is 0 and `latency_ms` None if nothing came. `silent_s` is the time since the last element, None if none
    ever came; `dropped` counts elements without room on the way to the topic, and elements that subscribers have not
    fetched in time.
    """

    rate_hz: float = 0.0
    latency_ms: float | None = None
    elements: int = 0
    dropped: int = 0
    silent_s: float | None = None


class Flowing(msgspec.Struct, tag=True):
    """A sign of life of the outlets, with the figures of each topic."""

    flows: dict[str, Flow]


class Unserved(msgspec.Struct, tag=True):
    """Subscribers of a topic wait, since the outlets can't accept them. Sent once until they can again."""

    topic: str
    cause: str


class ImportUnused(msgspec.Struct, tag=True):
    """An import is no longer used; it has served so many inputs so far."""

    crossing: str
    served: int


class Marked(msgspec.Struct, tag=True):
    """Everything that came before the mark for a unit has been delivered to it."""

    crossing: str
    unit: str


class CrossingCounts(msgspec.Struct, frozen=True):
    """The counts of a stream to another host: offered elements, dropped ones, and those that have not arrived yet.

    `crowded` of the dropped ones had no room in the link, the others none at the receiver. `offered_bytes` were
    offered, `arrived_bytes` are known to have arrived.
    """

    elements: int = 0
    dropped: int = 0
    waiting: int = 0
    crowded: int = 0
    offered_bytes: int = 0
    arrived_bytes: int = 0

    def __add__(self, other: CrossingCounts) -> CrossingCounts:
        return CrossingCounts(
            **{name: getattr(self, name) + getattr(other, name) for name in CrossingCounts.__struct_fields__}
        )


FromRelay: TypeAlias = ImportUnused | Marked
FromChild: TypeAlias = (
    Ready
    | Prepared
    | Switched
    | Lost
    | Trouble
    | Exhausted
    | UnitSign
    | Places
    | StateTold
    | Flowing
    | Unserved
    | FromRelay
)


# To and from the nursery.


class Fork(msgspec.Struct, tag=True):
    """Make a child. The message carries the child's ends of the control connection and of the pipe for its output."""

    serial: int
    order: ChildOrder


class Kill(msgspec.Struct, tag=True):
    """Kill a child and the processes that it has started; with `dump` it first prints its stack."""

    serial: int
    dump: bool = False


class Interrupt(msgspec.Struct, tag=True):
    """Raise SystemExit in the code of a child that was told to finish."""

    serial: int


ToNursery: TypeAlias = Fork | Kill | Interrupt


class Forked(msgspec.Struct, tag=True):
    serial: int
    pid: int


class Gone(msgspec.Struct, tag=True):
    """A child has ended; `status` is negative for a signal."""

    serial: int
    status: int


class NotForked(msgspec.Struct, tag=True):
    """A child could not be made; `cause` says why."""

    serial: int
    cause: str


class Alive(msgspec.Struct, tag=True):
    """A sign of life of the nursery."""


FromNursery: TypeAlias = Forked | Gone | NotForked | Alive
