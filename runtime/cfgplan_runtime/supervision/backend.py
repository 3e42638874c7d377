"""The protocol between the supervisor and the backend that runs the units."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence, Set
from dataclasses import dataclass, field
from typing import Protocol

from cfgplan.domain import ComputationUnit, Host, Stream, Transformation
from cfgplan_runtime.children.messages import GivenInput
from cfgplan_runtime.children.unit_order import order_digest
from cfgplan_runtime.streams.element import Moment
from cfgplan_runtime.streams.inlet import port_of
from cfgplan_runtime.streams.topic_names import is_tap
from cfgplan_runtime.supervision.events import Event


@dataclass(frozen=True, slots=True, order=True)
class Inlet:
    """The end of a stream: an input port of a unit, or (`unit` is "") a topic's outlet.

    An input that takes several streams has an inlet for each: `port` is then `port/1`, `port/2` and so on.
    """

    unit: str
    port: str

    @property
    def is_outlet(self) -> bool:
        return not self.unit

    @property
    def is_tap(self) -> bool:
        """Whether it is the outlet of a tap."""
        return self.is_outlet and is_tap(self.port)

    @property
    def input(self) -> str:
        """The input port of the unit."""
        return port_of(self.port)

    def __str__(self) -> str:
        return self.port if self.is_outlet else f"{self.unit}/{self.port}"


@dataclass(frozen=True, slots=True)
class Usage:
    """The usage of a unit: CPU time since its start in microseconds, memory now in bytes; `pid` is its process."""

    cpu_us: int
    memory_bytes: int
    pid: int | None = None


@dataclass(frozen=True, slots=True)
class FoundWire:
    """An existing wire; see `supervision.wiring.Wire`."""

    id: int
    stream: Stream
    inlet: Inlet
    has_switched: bool


@dataclass(frozen=True, slots=True)
class StoppingUnit:
    """A unit that was told to stop, of the transformation `label`, on a host, `told_s` seconds before it was found.

    It may take `stop_s` seconds to end; None if its transformation has no `stop`. `state_name` is that of its state, if
    it has one.
    """

    label: str
    host: str
    told_s: float = 0.0
    stop_s: float | None = None
    state_name: str | None = None


@dataclass(frozen=True, slots=True)
class Found:
    """The units, with their transformations and hosts, wires and topics that an earlier supervisor has left running.

    `labor_us` has the units that are ready, and the cold spares that are prepared; `topics` the host of each topic's
    target. `stopping` has by id the units that were told to stop and have not ended; apart from it, only wires name
    them. `states` has the last state of each state's name, and `ages_s` the seconds since each unit was started.
    `last_wire` is the highest number of a wire so far. The `inactive` units were never told to begin.
    """

    units: tuple[ComputationUnit, ...]
    library: tuple[Transformation, ...]
    hosts: tuple[Host, ...]
    labor_us: Mapping[str, int]
    wires: tuple[FoundWire, ...]
    topics: Mapping[str, str | None]
    stopping: Mapping[str, StoppingUnit] = field(default_factory=dict)
    states: Mapping[str, bytes] = field(default_factory=dict)
    ages_s: Mapping[str, float] = field(default_factory=dict)
    last_wire: int = 0
    inactive: Set[str] = frozenset()


@dataclass(frozen=True, slots=True)
class Failures:
    """A transformation has failed `number` times in a row on a host; `cause` is that of the last failure.

    It must not be started there for another `left_s` seconds.
    """

    transformation: Transformation
    host: str | None
    number: int
    left_s: float
    cause: str

    @property
    def digest(self) -> str:
        """The digest of the order that starts a unit. The next manager gets it with FailuresKept."""
        return order_digest(self.transformation)


class Backend(Protocol):
    """Runs units and connects them. No method waits for its effect: that comes as an event from `wait`.

    Call all methods but `wake` from the thread that made the backend. A host of None means this computer, in a problem
    without hosts. Orders for a host that has not joined have no effect, and no event follows.
    """

    @property
    def id(self) -> str:
        """The run's id, which distinguishes its topics from those of other runs."""

    def found(self) -> Found | None:
        """The units that run from the beginning; None if none do. Called once."""

    def now(self) -> float:
        """Seconds on a monotonic clock."""

    def wait(self, timeout_s: float | None) -> Sequence[Event]:
        """The events since the last call. If there are none, waits up to `timeout_s` for the first."""

    def wake(self) -> None:
        """Make `wait` return. Thread-safe."""

    def take_hosts(self, hosts: Collection[str]) -> Collection[str]:
        """Use these hosts too. Returns those for which HostJoined or HostLost follows; on one computer none."""

    def leave_hosts(self, hosts: Collection[str]) -> None:
        """Free these hosts for other runs. Their units are ended."""

    def remember(self, label: str, host: str | None, failures: Failures | None) -> None:
        """Keep the failures of a transformation on a host for the next manager, if units outlive this one; None: forget
        them. The next manager gets FailuresKept.
        """

    def start(
        self, unit: str, transformation: Transformation, state: bytes | None, host: str | None, spare: str | None = None
    ) -> None:
        """Start a unit on a host: UnitReady or UnitDied follows, or HostLost.

        The unit makes no step before `activate`. It starts in the process that was prepared as `spare`, if that still
        runs and its code has not changed: SpareUsed is reported first. The spare is gone in any case.
        """

    def prepare(self, spare: str, transformation: Transformation, host: str | None) -> None:
        """Construct the code of a cold spare, so that a unit can start at once: SparePrepared or SpareLost follows.

        SpareLost is reported later too, if the process ends or its code changes. An earlier spare of that name is
        discarded. A backend may do nothing here, and report nothing: a start then takes the usual time.
        """

    def discard(self, spare: str) -> None:
        """End the process of a spare, without an event."""

    def stop(self, unit: str) -> None:
        """Ask a unit to process the elements that it has received, then end: UnitStopped (or UnitDied) follows.

        A second call interrupts code that still blocks, if possible.
        """

    def kill(self, unit: str, *, dump: bool = False) -> None:
        """End a unit at once: UnitDied follows, or UnitStopped if it had been asked to stop.

        With `dump` it first prints its stack.
        """

    def activate(self, unit: str) -> bool:
        """Let a started unit begin to work. Returns whether UnitActive or UnitDied follows: a lifecycle node of ROS 2
        takes a while. Other nodes of ROS work as soon as they run.
        """

    def deactivate(self, unit: str) -> None:
        """Let a unit give nothing until `activate`, and keep the elements that it gets."""

    def hold(self, unit: str) -> None:
        """Let a started unit keep the elements that it gets, and make no step before `give_state`."""

    def ask_places(self, unit: str, inlets: Mapping[str, bool]) -> None:
        """Ask a unit from which moment on these inlets get every element: PlacesTold follows once all of them know.

        Inlets that are true know it from their first element on.
        """

    def ask_state(self, unit: str, until: Mapping[str, Moment], successor: str) -> None:
        """Ask a unit for its state, with which the unit `successor` continues: StateTold follows between two steps,
        once each inlet in `until` has received the element of its moment.
        """

    def give_state(
        self, unit: str, state: bytes | None, inputs: Mapping[str, GivenInput], outputs: Mapping[str, Moment]
    ) -> None:
        """Give a unit that was told to `hold` the state of another, if there is one. Its steps begin after it, at the
        place of each inlet in `inputs`; the elements of each output in `outputs` come after this moment.

        A unit that was asked for its state, and is not replaced after all, continues with its own state instead.
        """

    def connect(self, wire: int, stream: Stream, inlet: Inlet, *, queue: int, blocks: bool) -> None:
        """Let `stream` feed `inlet`, at once or as the standby of its present source: WireSwitched follows."""

    def disconnect(self, wire: int, inlet: Inlet) -> None:
        """Remove a wire from its inlet, whether it is the source or the standby."""

    def end_wire(self, wire: int, stream: Stream, inlet: Inlet) -> None:
        """One end of a wire is gone: close the other after the elements that were sent, even if other processes hold
        the wire open.
        """

    def switch_now(self, inlet: Inlet) -> None:
        """Switch an inlet to its standby without waiting for its present source."""

    def open_outlet(self, topic: str, host: str | None) -> None:
        """Give a topic its address on a host; None if its target has none. Called again after HostJoined."""

    def close_outlet(self, topic: str) -> None:
        """Remove a topic's address."""

    def renew(self, helper: str) -> None:
        """Replace a helper process that gives no sign of life: OutletsLost or UnitDied may follow."""

    def usage(self, unit: str) -> Usage | None:
        """The usage so far of a unit, or of a prepared spare; None if it does not run."""

    def pid(self, unit: str) -> int | None:
        """The process id of a unit; None if it has none."""

    def close(self) -> None:
        """Stop everything at once and leave nothing behind."""
