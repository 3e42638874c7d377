"""What the supervisor asks of whatever runs the units."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from cfgplan.domain import ComputationUnit, Host, Stream, Transformation
from cfgplan_runtime.streams.inlet import port_of
from cfgplan_runtime.supervision.events import Event


@dataclass(frozen=True, slots=True, order=True)
class Inlet:
    """Where a stream may lead: an input port of a unit, or (`unit` is "") a topic's outlet.

    An input that takes several streams has an inlet for each: `port` is then `port/1`, `port/2` and so on.
    """

    unit: str
    port: str

    @property
    def is_outlet(self) -> bool:
        return not self.unit

    @property
    def input(self) -> str:
        """The input port of the unit."""
        return port_of(self.port)

    def __str__(self) -> str:
        return self.port if self.is_outlet else f"{self.unit}/{self.port}"


@dataclass(frozen=True, slots=True)
class Usage:
    """What a unit has used: CPU time since its start in microseconds, memory now in bytes; `pid` is its process."""

    cpu_us: int
    memory_bytes: int
    pid: int | None = None


@dataclass(frozen=True, slots=True)
class FoundWire:
    """A wire that is there already; see `supervision.wiring.Wire`."""

    id: int
    stream: Stream
    inlet: Inlet
    has_switched: bool


@dataclass(frozen=True, slots=True)
class Found:
    """What an earlier supervisor has left running: its units, with their transformations and hosts, wires and topics.

    `labor_us` has the units that are ready, and the cold spares that are prepared; `topics` the host of each topic's
    target. Units that were told to stop and have not ended are `stopping`, with their
    hosts; only the wires name them too.
    """

    units: tuple[ComputationUnit, ...]
    library: tuple[Transformation, ...]
    hosts: tuple[Host, ...]
    labor_us: Mapping[str, int]
    wires: tuple[FoundWire, ...]
    topics: Mapping[str, str | None]
    stopping: Mapping[str, str] = field(default_factory=dict)


class Backend(Protocol):
    """Runs units and connects them. No method waits for its effect: that comes as an event from `wait`.

    All methods but `wake` are called from the thread that made the backend. A host is None where the problem has no
    hosts: that is this computer. Orders for a host that is not there have no effect, and no event follows.
    """

    @property
    def id(self) -> str:
        """The run's id, which tells its topics from those of other runs."""

    def found(self) -> Found | None:
        """What runs from the beginning; None if nothing does. Called once."""

    def now(self) -> float:
        """Seconds on a clock that only rises."""

    def wait(self, timeout_s: float | None) -> Sequence[Event]:
        """The events since the last call. If there are none, waits up to `timeout_s` for the first."""

    def wake(self) -> None:
        """Let `wait` return; for any thread."""

    def take_hosts(self, hosts: Collection[str]) -> Collection[str]:
        """Use these hosts too. Returns those of which HostJoined or HostLost follows; on one computer none."""

    def leave_hosts(self, hosts: Collection[str]) -> None:
        """Leave these hosts to others. Their units are ended."""

    def start(
        self, unit: str, transformation: Transformation, state: bytes | None, host: str | None, spare: str | None = None
    ) -> None:
        """Start a unit on a host: UnitReady or UnitDied follows, or HostLost.

        It begins in the process that was prepared as `spare`, if that is there and its code has not changed: SpareUsed
        is told first. In no case is the spare there any more.
        """

    def prepare(self, spare: str, transformation: Transformation, host: str | None) -> None:
        """Construct the code of a cold spare, so that a unit begins at once: SparePrepared or SpareLost follows.

        SpareLost is told later too, if it ends unasked or its code changes. Another of that name is discarded. A
        backend may do nothing here, and tell nothing: a start then takes as long as any.
        """

    def discard(self, spare: str) -> None:
        """End what was prepared: nothing follows."""

    def stop(self, unit: str) -> None:
        """Ask a unit to process what it has taken in, then end: UnitStopped (or UnitDied) follows.

        Asked again, code that still blocks is interrupted, where that can be done.
        """

    def kill(self, unit: str, *, dump: bool = False) -> None:
        """End a unit at once: UnitDied follows, or UnitStopped if it had been asked to stop.

        With `dump` it first prints where it is.
        """

    def ask_state(self, unit: str) -> None:
        """Ask a unit for its state: UnitStatus follows at once, where the backend keeps states."""

    def give_state(self, unit: str, state: bytes) -> None:
        """Let a unit that has begun go on with the state of another."""

    def connect(self, wire: int, stream: Stream, inlet: Inlet, *, queue: int, blocks: bool) -> None:
        """Let `stream` feed `inlet`, at once or as the standby of what feeds it: WireSwitched follows."""

    def disconnect(self, wire: int, inlet: Inlet) -> None:
        """Take a wire away from its inlet, whether it is the source or the standby."""

    def end_wire(self, wire: int, stream: Stream, inlet: Inlet) -> None:
        """One end of a wire is gone: close the other after what was sent, even if others hold the wire open."""

    def switch_now(self, inlet: Inlet) -> None:
        """Switch an inlet to its standby without waiting for its present source."""

    def open_outlet(self, topic: str, host: str | None) -> None:
        """Give a topic its address on a host; None: where its target has none. Called again after HostJoined."""

    def close_outlet(self, topic: str) -> None:
        """Take a topic's address away."""

    def renew(self, helper: str) -> None:
        """Replace a helper process that gives no sign of life: OutletsLost or UnitDied may follow."""

    def usage(self, unit: str) -> Usage | None:
        """What a unit, or a spare that is prepared, has used so far; None if it does not run."""

    def pid(self, unit: str) -> int | None:
        """The process id of a unit; None if it has none."""

    def close(self) -> None:
        """Stop everything at once and leave nothing behind."""
