"""Events of running units, as typed values: the language between backend, supervisor and life-cycle."""

from __future__ import annotations

from typing import Literal, TypeAlias

import msgspec

from cfgplan.domain import Transformation
from cfgplan_runtime.children.messages import CrossingCounts, Flow, GivenInput, PortCounts, Qualities
from cfgplan_runtime.children.unit_order import order_digest
from cfgplan_runtime.streams.element import Moment

End: TypeAlias = Literal["died", "could not start", "refused a transition", "was given up"]
"""How a unit has ended without being told to; see `UnitDied`."""


class Event(msgspec.Struct, frozen=True):
    """An event; each kind is a class of its own."""


class UnitReady(Event, frozen=True):
    """A unit has started; `labor_us` is the CPU time of its start, in microseconds."""

    unit: str
    labor_us: int


class UnitActive(Event, frozen=True):
    """A unit that takes a while to begin works from now on."""

    unit: str


class UnitDied(Event, frozen=True):
    """A unit has ended without being told to; `cause` says why, and `how` is the verb of the sentence.

    A unit `died` if its process has ended, and `could not start` if that was before it was ready. A node with a
    lifecycle that `refused a transition` was killed. A unit `was given up` if the run has not started it, or can't
    reach it any more; its process may live, and its transformation gets no blame.
    """

    unit: str
    cause: str
    how: End = "died"

    @property
    def end(self) -> str:
        """Its end as the predicate of a sentence."""
        return f"{self.how}: {self.cause}"


class UnitStopped(Event, frozen=True):
    """A unit has ended as told."""

    unit: str


class SparePrepared(Event, frozen=True):
    """A process has constructed the code of a cold spare and waits; `labor_us` is the CPU time that this took."""

    unit: str
    labor_us: int


class SpareUsed(Event, frozen=True):
    """A unit starts in the process that was prepared for a cold spare; `UnitReady` follows."""

    unit: str
    spare: str


class SpareLost(Event, frozen=True):
    """The process that was prepared for a cold spare has ended or could not be prepared, or its code has changed.

    It is prepared again at once, then after 1, 2, 4 ... 300 s.
    """

    unit: str
    cause: str


class UnitFailed(Event, frozen=True):
    """Unit code has failed in a step, and the unit continues.

    If `suppressed` is not 0, the event reports that many repeats of an earlier failure, up to this step; `text` is that
    of the first failure. Repeats are reported at intervals that grow from one second to one minute.
    """

    unit: str
    what: str
    step: int
    text: str
    suppressed: int = 0


class UnitHung(Event, frozen=True):
    """A unit has given no sign of life for longer than its `hang` allows, and is killed."""

    unit: str
    silent_s: float


class UnitTooLarge(Event, frozen=True):
    """A unit uses more memory than its limit, and is killed."""

    unit: str
    memory_bytes: int


class UnitCutShort(Event, frozen=True):
    """A unit that was told to end had not ended after `after_s` seconds (`run: {stop: ...}`), and is killed.

    At its last sign of life, `waiting` elements waited at its inputs.
    """

    unit: str
    after_s: float
    waiting: int


class UnitPrinted(Event, frozen=True):
    """A line that a unit wrote to its standard output or error."""

    unit: str
    line: str


class SourceExhausted(Event, frozen=True):
    """A source has no more elements to give; its unit stays."""

    unit: str


class InputLost(Event, frozen=True):
    """The input `port` of a living unit, or that topic (`unit` is null), has lost its source: the wire of the number
    `wire`.
    """

    unit: str | None
    port: str
    wire: int


class WireSwitched(Event, frozen=True):
    """An input has switched to the stream of the wire with this number."""

    wire: int


class UnitStatus(Event, frozen=True):
    """A sign of life, with counts since the unit's start."""

    unit: str
    steps: int
    errors: int
    inputs: dict[str, PortCounts]
    outputs: dict[str, PortCounts]
    state: bytes | None = None
    qualities: Qualities = {}


class PlacesTold(Event, frozen=True):
    """The moment from which each inlet of a unit that was asked for gets every element."""

    unit: str
    moments: dict[str, Moment]


class StateTold(Event, frozen=True):
    """A unit's state between two steps, with its place in each input, and the moment of each output's last element.

    The state is empty if the unit's code gives none, and null if the unit does not know its place either.
    """

    unit: str
    state: bytes | None
    inputs: dict[str, GivenInput]
    outputs: dict[str, Moment]


class StateNotExact(Event, frozen=True):
    """A new unit replaces `before`, but has not got its state exactly: it goes on from the last known one, if any."""

    unit: str
    before: str
    cause: str


class OutletsLost(Event, frozen=True):
    """The process that owns the topics' addresses has died; a new one replaces it: `OutletsOpened` follows."""

    cause: str


class OutletsOpened(Event, frozen=True):
    """The topics have their addresses again, and wait for their wires."""


class TopicsStatus(Event, frozen=True):
    """The figures of each topic, about once a second."""

    flows: dict[str, Flow]


class CrossingsStatus(Event, frozen=True):
    """The traffic between hosts: by stream and its two hosts, and by two hosts (stream "") for streams that
    have ended.
    """

    crossings: dict[tuple[str, str, str], CrossingCounts]


class HelperAlive(Event, frozen=True):
    """A sign of life of a process that a backend needs beside the units; the next comes within `patience_s`.

    Only the supervisor gets it. Once the process is gone, `patience_s` is infinite.
    """

    helper: str
    patience_s: float


class HelperHung(Event, frozen=True):
    """A helper process of the run (nursery, outlets) has given no sign of life, and is replaced."""

    helper: str
    silent_s: float


class CertificateEnds(Event, frozen=True):
    """The certificate of a host, or of the manager, expires within 30 days; its links end when it expires.

    The run reports it once a day; `ends` is the time at which it expires.
    """

    host: str
    ends: str
    days_left: int


class OutOfDescriptors(Event, frozen=True):
    """A process of the run has no file descriptor left, or no room on the disk for a topic's address.

    `cause` names the failed action. Reported once until the action succeeds again.
    """

    cause: str


class HostLost(Event, frozen=True):
    """A host can't be reached any more: its units and topics count as gone, without a `UnitDied` for each of them."""

    host: str
    cause: str


class HostJoined(Event, frozen=True):
    """A host has joined, for the first time or again. No units of the run are on it.

    Its time of day is `ahead_us` microseconds ahead of the manager's. Times of elements are not affected: every host
    takes them from the run's clock.
    """

    host: str
    ahead_us: int = 0


class ClockMoved(Event, frozen=True):
    """The time of day of a host, or of the manager, was set; the host's is now `ahead_us` microseconds ahead."""

    host: str
    ahead_us: int


class ElementsLost(Event, frozen=True):
    """A lost host is back. As far as it knows, this number of its `elements` for other hosts had not arrived."""

    host: str
    elements: int


class UnitFound(Event, frozen=True):
    """An earlier manager has left this unit running; it was started `age_s` seconds ago."""

    unit: str
    age_s: float


class FailuresKept(Event, frozen=True):
    """A host tells the next manager that a transformation has failed there `number` times in a row.

    It must not be started there for another `left_s` seconds. `cause` is the cause of the last failure, `digest` the
    digest of the order that started the failed units.
    """

    transformation: str
    host: str
    number: int
    left_s: float
    cause: str
    digest: str

    def is_of(self, transformation: Transformation | None) -> bool:
        """Whether a transformation starts its units in the same way as those that have failed."""
        return transformation is not None and order_digest(transformation) == self.digest


class Applied(Event, frozen=True):
    """The change set `id` was carried out.

    `seconds` has the duration of each phase. `unswitched` counts the inputs whose old source was removed before the new
    one had sent anything.
    """

    id: str
    seconds: dict[str, float]
    unswitched: int = 0


class RolledBack(Event, frozen=True):
    """A change set failed and was undone."""

    id: str
    cause: str


SIGNS = (UnitStatus, TopicsStatus, CrossingsStatus, HelperAlive, UnitActive, PlacesTold, StateTold)
"""Signs of life and answers to the supervisor: they come often, and are not logged."""
