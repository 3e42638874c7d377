"""What happens to running units, as typed events: the one language between backend, supervisor and life-cycle."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

from cfgplan_runtime.children.messages import CrossingCounts, Flow, PortCounts


@dataclass(frozen=True, slots=True)
class UnitReady:
    """A unit has started; `labor_us` is the CPU time that took, in microseconds."""

    unit: str
    labor_us: int


@dataclass(frozen=True, slots=True)
class UnitDied:
    """A unit has ended unasked, or could not start; `cause` says how."""

    unit: str
    cause: str


@dataclass(frozen=True, slots=True)
class UnitStopped:
    """A unit has ended as asked."""

    unit: str


@dataclass(frozen=True, slots=True)
class SparePrepared:
    """The code of a cold spare is constructed in a process that waits; `labor_us` is the CPU time that took."""

    unit: str
    labor_us: int


@dataclass(frozen=True, slots=True)
class SpareUsed:
    """A unit begins in the process that was prepared for a cold spare."""

    unit: str
    spare: str


@dataclass(frozen=True, slots=True)
class SpareLost:
    """The process that was prepared for a cold spare has ended unasked, or could not be prepared."""

    unit: str
    cause: str


@dataclass(frozen=True, slots=True)
class UnitFailed:
    """Unit code failed in a step, and the unit goes on.

    If `suppressed` is not 0, the event stands for that many failures up to this step; `text` is the first one's.
    """

    unit: str
    kind: str
    step: int
    text: str
    suppressed: int = 0


@dataclass(frozen=True, slots=True)
class UnitHung:
    """A unit has given no sign of life for longer than it may, and is killed."""

    unit: str
    silent_s: float


@dataclass(frozen=True, slots=True)
class UnitTooLarge:
    """A unit uses more memory than it may, and is killed."""

    unit: str
    memory_bytes: int


@dataclass(frozen=True, slots=True)
class UnitPrinted:
    """A line that a unit wrote to its standard output or error."""

    unit: str
    line: str


@dataclass(frozen=True, slots=True)
class SourceExhausted:
    """A source has no more elements to give; its unit stays."""

    unit: str


@dataclass(frozen=True, slots=True)
class InputLost:
    """An input of a living unit, or a topic (`unit` is None), has lost its source."""

    unit: str | None
    port: str
    wire: int


@dataclass(frozen=True, slots=True)
class WireSwitched:
    """An input goes on with the stream of this wire."""

    wire: int


@dataclass(frozen=True, slots=True)
class UnitStatus:
    """A sign of life, with counts since the unit's start."""

    unit: str
    steps: int
    errors: int
    inputs: dict[str, PortCounts]
    outputs: dict[str, PortCounts]
    state: bytes | None = None


@dataclass(frozen=True, slots=True)
class OutletsLost:
    """The process that owns the topics' addresses has died; a new one takes its place: OutletsOpened follows."""

    cause: str


@dataclass(frozen=True, slots=True)
class OutletsOpened:
    """The topics have their addresses again, and are to be fed."""


@dataclass(frozen=True, slots=True)
class TopicsStatus:
    """What comes on each topic, told about once a second."""

    flows: dict[str, Flow]


@dataclass(frozen=True, slots=True)
class CrossingsStatus:
    """What has gone from host to host: by stream and its two hosts, and by two hosts (stream "") for streams gone."""

    crossings: dict[tuple[str, str, str], CrossingCounts]


@dataclass(frozen=True, slots=True)
class HelperAlive:
    """A sign of life of a process that a backend needs beside the units; the next comes within `patience_s`.

    Only the supervisor gets it. Once the process is gone, `patience_s` is infinite.
    """

    helper: str
    patience_s: float


@dataclass(frozen=True, slots=True)
class HelperHung:
    """A process that a backend needs beside the units has given no sign of life, and is made anew."""

    helper: str
    silent_s: float


@dataclass(frozen=True, slots=True)
class OutOfDescriptors:
    """A process of the run has no file descriptor left, or no room on the disk for a topic's address.

    `cause` says what it can't do. Told once until it can again.
    """

    cause: str


@dataclass(frozen=True, slots=True)
class HostLost:
    """A host can't be reached any more: none of its units and topics will be heard of again, not even of their end."""

    host: str
    cause: str


@dataclass(frozen=True, slots=True)
class HostJoined:
    """A host is there, for the first time or again. Nothing of the run is on it.

    `ahead_us` is how far its time of day is ahead of the manager's, in microseconds. Times of elements are not: they go
    by the run's clock on every host.
    """

    host: str
    ahead_us: int = 0


@dataclass(frozen=True, slots=True)
class ClockMoved:
    """A host's time of day, or the manager's, was set: it is ahead by `ahead_us` now."""

    host: str
    ahead_us: int


@dataclass(frozen=True, slots=True)
class ElementsLost:
    """A host that was lost and is back had elements for others that had not come to them, as far as it knows."""

    host: str
    elements: int


@dataclass(frozen=True, slots=True)
class Applied:
    """A change set was carried out.

    `seconds` is the time of each phase; `unswitched` counts inputs whose new source had given nothing yet when the old
    one was taken away.
    """

    id: str
    seconds: dict[str, float]
    unswitched: int = 0


@dataclass(frozen=True, slots=True)
class RolledBack:
    """A change set failed and was undone."""

    id: str
    cause: str


SIGNS = (UnitStatus, TopicsStatus, CrossingsStatus)
"""Signs of life: they come often, and are not logged."""

Event: TypeAlias = (
    UnitReady
    | UnitDied
    | UnitStopped
    | SparePrepared
    | SpareUsed
    | SpareLost
    | UnitFailed
    | UnitHung
    | UnitTooLarge
    | UnitPrinted
    | SourceExhausted
    | InputLost
    | WireSwitched
    | UnitStatus
    | OutletsLost
    | OutletsOpened
    | TopicsStatus
    | CrossingsStatus
    | HelperAlive
    | HelperHung
    | OutOfDescriptors
    | HostLost
    | HostJoined
    | ClockMoved
    | ElementsLost
    | Applied
    | RolledBack
)
