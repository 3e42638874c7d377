"""A simulation of units on a clock of its own: for tests of the rooms above, and for experiments."""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field

from cfgplan.domain import InputPort, Stream, Transformation
from cfgplan_runtime.children.messages import Flow, GivenInput, PortCounts, Qualities
from cfgplan_runtime.streams.element import Moment
from cfgplan_runtime.supervision.backend import Failures, Inlet, Usage
from cfgplan_runtime.supervision.events import (
    Event,
    HostJoined,
    HostLost,
    InputLost,
    PlacesTold,
    SpareLost,
    SparePrepared,
    SpareUsed,
    StateTold,
    TopicsStatus,
    UnitActive,
    UnitDied,
    UnitReady,
    UnitStatus,
    UnitStopped,
    WireSwitched,
)


@dataclass
class Behaviour:
    """The behaviour of a transformation's units. Times in seconds; None is never.

    Costs are the transformation's own unless given: `labor_us` in microseconds of CPU time; `upkeep_us` in microseconds
    per second, a function of the clock that is called once per second. `dies_s` counts from readiness. A `quiet` unit
    sends no element; a `hung` one gives no sign of life and does not stop when told; each step of a `failing` one has
    an error; one that `leaves_process` leaves one behind that holds its sockets open. `says` gives,
    for a time of the clock, the quality of the outputs since the last sign of life.
    """

    start_s: float = 0.01
    activate_s: float | None = None
    """Seconds after which a unit that was told to begin works; None: at once."""
    dies_at_start: str | None = None
    dies_s: float | None = None
    stop_s: float = 0.002
    quiet: bool = False
    hung: bool = False
    failing: bool = False
    leaves_process: bool = False
    memory_bytes: int = 10 << 20
    labor_us: int | None = None
    upkeep_us: Callable[[float], float] | None = None
    says: Callable[[float], Qualities] | None = None

    def labor_of(self, transformation: Transformation) -> int:
        return transformation.labor_us if self.labor_us is None else self.labor_us


@dataclass
class _Unit:
    transformation: Transformation
    behaviour: Behaviour
    state: bytes | None
    host: str | None
    is_ready: bool = False
    is_active: bool = False
    is_activating: bool = False
    is_stopping: bool = False
    is_held: bool = False
    steps: int = 0
    used_us: float = 0.0
    used_until_s: float = 0.0
    """When `used_us` was last brought up to date."""

    def use(self, now_s: float) -> float:
        """CPU time since the unit was ready, in microseconds; added up second by second, as upkeep may vary."""
        while self.used_until_s < now_s:
            piece_end_s = min(now_s, math.floor(self.used_until_s) + 1.0)
            varies = self.behaviour.upkeep_us
            upkeep_us = self.transformation.upkeep_us if varies is None else varies(math.floor(self.used_until_s))
            self.used_us += upkeep_us * (piece_end_s - self.used_until_s)
            self.used_until_s = piece_end_s
        return self.used_us


@dataclass(frozen=True, eq=False)
class _Prepared:
    """The process of a cold spare: its host, and the time when a unit can start in it."""

    host: str | None
    ready_s: float
    usage: Usage


@dataclass
class _Input:
    active: int | None = None
    standby: int | None = None


@dataclass
class SimulatedBackend:
    """A backend whose clock moves only in `wait` (straight to the next event) and `stall`.

    `behaviours` are by transformation, or by `TRANSFORMATION on HOST` for those on one host. `calls` lists the calls of
    its methods, in order. All hosts are there until `lose_host`; `lost_hosts` has those that are gone. An input
    switches `switch_s` seconds after its new source gives elements, and units give signs of life every `sign_period_s`
    seconds. `units`, `spares` (by id), `wires` (by number) and `topics` are those that exist now.
    """

    behaviours: dict[str, Behaviour] = field(default_factory=dict)
    switch_s: float = 0.005
    sign_period_s: float = 1.0
    calls: list[tuple[str, ...]] = field(default_factory=list)
    topics: dict[str, str | None] = field(default_factory=dict)
    """By topic that can be subscribed to: its host."""
    spares: dict[str, _Prepared] = field(default_factory=dict)
    lost_hosts: set[str] = field(default_factory=set)
    units: dict[str, _Unit] = field(default_factory=dict)
    wires: dict[int, tuple[Stream, Inlet]] = field(default_factory=dict)
    _now: float = 0.0
    _due: list[tuple[float, int, Event, _Unit | _Prepared | None]] = field(default_factory=list)
    _count: int = 0
    _inputs: dict[Inlet, _Input] = field(default_factory=dict)
    _gave_s: dict[str, float | None] = field(default_factory=dict)
    """By topic: when an element was last seen there."""

    id = "simulated"

    def found(self) -> None:
        return None

    def now(self) -> float:
        return self._now

    def wait(self, timeout_s: float | None) -> Sequence[Event]:
        end = None if timeout_s is None else self._now + timeout_s
        while self._due and (end is None or self._due[0][0] <= end):
            self._now = max(self._now, self._due[0][0])
            _, _, event, subject = heapq.heappop(self._due)
            if self._subject(event) is not subject:
                continue  # it is about an earlier unit or spare of this id
            if self._happens(event):
                return [event]
        if end is not None:
            self._now = end
        return []

    def wake(self) -> None:
        """Do nothing: no other thread waits."""

    def stall(self, seconds: float) -> None:
        """Let `seconds` pass without a wait. Its events come from the next `wait`."""
        self._now += seconds

    def fail(self, unit: str, cause: str = "killed by SIGKILL") -> None:
        """Let `unit` die now, of this `cause`."""
        self._later(0.0, UnitDied(unit, cause))

    def tell(self, event: Event) -> None:
        """Let an event happen now."""
        self._later(0.0, event)

    def lose_host(self, host: str, cause: str = "its link is cut") -> None:
        """Lose `host` with all its units, for this `cause`; only HostLost tells of it."""
        self.lost_hosts.add(host)
        for unit in [unit for unit, at in self.units.items() if at.host == host]:
            del self.units[unit]
        self.spares = {spare: at for spare, at in self.spares.items() if at.host != host}
        for topic in [topic for topic, at in self.topics.items() if at == host]:
            del self.topics[topic]
        for wire, (_, inlet) in list(self.wires.items()):
            if inlet.port not in self.topics if inlet.is_outlet else inlet.unit not in self.units:
                self._inputs.pop(self.wires.pop(wire)[1], None)
        self._later(0.0, HostLost(host, cause))

    def join_host(self, host: str) -> None:
        """Let a host be there again, with nothing on it."""
        self.lost_hosts.discard(host)
        self._later(0.0, HostJoined(host))

    def feeding(self, inlet: Inlet) -> Stream | None:
        """The stream that feeds an inlet now; None without one."""
        active = self._inputs.get(inlet, _Input()).active
        return None if active is None else self.wires[active][0]

    def take_hosts(self, hosts: Collection[str]) -> Collection[str]:  # noqa: ARG002
        return ()

    def leave_hosts(self, hosts: Collection[str]) -> None:
        """Do nothing: the only host is this computer."""

    def remember(self, label: str, host: str | None, failures: Failures | None) -> None:
        """Do nothing: all units end with this process."""

    def start(
        self, unit: str, transformation: Transformation, state: bytes | None, host: str | None, spare: str | None = None
    ) -> None:
        self.calls.append(("start", unit))
        if host in self.lost_hosts:
            return
        behaviour = self._behaviour(transformation, host)
        start_s, prepared = behaviour.start_s, self.spares.pop(spare or "", None)
        if prepared is not None and spare is not None:
            start_s = max(0.0, prepared.ready_s - self._now)
            self._later(0.0, SpareUsed(unit, spare))
        self.units[unit] = _Unit(transformation, behaviour, state, host, used_until_s=self._now + start_s)
        if behaviour.dies_at_start is not None:
            self._later(start_s, UnitDied(unit, behaviour.dies_at_start))
            return
        self._later(start_s, UnitReady(unit, behaviour.labor_of(transformation)))
        if behaviour.dies_s is not None:
            self._later(start_s + behaviour.dies_s, UnitDied(unit, "died of old age"))
        if not behaviour.hung:
            self._later(start_s + self.sign_period_s, UnitStatus(unit, 0, 0, {}, {}))

    def _behaviour(self, transformation: Transformation, host: str | None) -> Behaviour:
        of_all = self.behaviours.get(transformation.label, Behaviour())
        return self.behaviours.get(f"{transformation.label} on {host}", of_all)

    def prepare(self, spare: str, transformation: Transformation, host: str | None) -> None:
        self.calls.append(("prepare", spare))
        if host in self.lost_hosts:
            return
        behaviour = self._behaviour(transformation, host)
        labor_us, start_s = behaviour.labor_of(transformation), behaviour.start_s
        self.spares[spare] = _Prepared(host, self._now + start_s, Usage(labor_us, behaviour.memory_bytes))
        cause = behaviour.dies_at_start
        self._later(start_s, SparePrepared(spare, labor_us) if cause is None else SpareLost(spare, cause))

    def discard(self, spare: str) -> None:
        self.calls.append(("discard", spare))
        self.spares.pop(spare, None)

    def stop(self, unit: str) -> None:
        self.calls.append(("stop", unit))
        found = self.units.get(unit)
        if found is not None and not found.is_stopping:
            found.is_stopping = True
            if not found.behaviour.hung:
                self._later(found.behaviour.stop_s, UnitStopped(unit))

    def activate(self, unit: str) -> bool:
        self.calls.append(("activate", unit))
        found = self.units.get(unit)
        if found is None:
            return False
        found.is_activating = True
        if found.behaviour.activate_s is None:
            self._begin(unit)
            return False
        self._later(found.behaviour.activate_s, UnitActive(unit))
        return True

    def _begin(self, unit: str) -> None:
        self.units[unit].is_active, self.units[unit].is_activating = True, False
        for port in self._inputs.values():
            if port.standby is not None and self.wires[port.standby][0].unit == unit:
                self._switch_soon(port)

    def deactivate(self, unit: str) -> None:
        self.calls.append(("deactivate", unit))
        if unit in self.units:
            self.units[unit].is_active = self.units[unit].is_activating = False

    def hold(self, unit: str) -> None:
        self.calls.append(("hold", unit))
        if unit in self.units:
            self.units[unit].is_held = True

    def ask_places(self, unit: str, inlets: Mapping[str, bool]) -> None:  # noqa: ARG002
        self.calls.append(("ask places", unit))
        self._later(0.0, PlacesTold(unit, {}))

    def ask_state(self, unit: str, until: Mapping[str, Moment], successor: str) -> None:  # noqa: ARG002
        self.calls.append(("ask state", unit))
        self._later(0.0, StateTold(unit, self.units[unit].state or b"", {}, {}))

    def give_state(
        self,
        unit: str,
        state: bytes | None,
        inputs: Mapping[str, GivenInput],  # noqa: ARG002
        outputs: Mapping[str, Moment],  # noqa: ARG002
    ) -> None:
        self.calls.append(("give state", unit))
        if unit in self.units and self.units[unit].is_held:
            self.units[unit].state, self.units[unit].is_held = state, False

    def kill(self, unit: str, *, dump: bool = False) -> None:
        self.calls.append(("dump" if dump else "kill", unit))
        found = self.units.get(unit)
        if found is not None and not dump:
            self._later(0.0, UnitStopped(unit) if found.is_stopping else UnitDied(unit, "killed by SIGKILL"))

    def connect(self, wire: int, stream: Stream, inlet: Inlet, *, queue: int, blocks: bool) -> None:  # noqa: ARG002
        self.calls.append(("connect", str(stream), str(inlet)))
        if inlet.port not in self.topics if inlet.is_outlet else inlet.unit not in self.units:
            return
        self.wires[wire] = (stream, inlet)
        port = self._inputs.setdefault(inlet, _Input())
        if port.active is None:
            port.active = wire
            self._later(0.0, WireSwitched(wire))
            return
        port.standby = wire
        self._switch_soon(port)

    def _switch_soon(self, port: _Input) -> None:
        assert port.active is not None and port.standby is not None
        producer = self.units.get(self.wires[port.standby][0].unit)
        old = self.wires[port.active][0].unit  # the inlet waits for an old source that neither gives nor ends
        if producer is not None and producer.is_active and not producer.behaviour.quiet and self._gives(old):
            self._later(self.switch_s, WireSwitched(port.standby))

    def disconnect(self, wire: int, inlet: Inlet) -> None:
        self.calls.append(("disconnect", str(inlet)))
        self._end(wire)

    def end_wire(self, wire: int, stream: Stream, inlet: Inlet) -> None:
        self.calls.append(("end", str(stream), str(inlet)))
        self._end(wire)

    def switch_now(self, inlet: Inlet) -> None:
        self.calls.append(("switch", str(inlet)))
        port = self._inputs.get(inlet, _Input())
        if port.standby is not None:
            self._later(0.0, WireSwitched(port.standby))

    def open_outlet(self, topic: str, host: str | None) -> None:
        self.calls.append(("open", topic))
        if not self._gave_s:
            self._later(self.sign_period_s, TopicsStatus({}))
        if host not in self.lost_hosts:
            self.topics[topic] = host
        self._gave_s[topic] = None

    def close_outlet(self, topic: str) -> None:
        self.calls.append(("close", topic))
        self.topics.pop(topic, None)
        self._gave_s.pop(topic, None)

    def renew(self, helper: str) -> None:
        self.calls.append(("renew", helper))

    def usage(self, unit: str) -> Usage | None:
        found = self.units.get(unit)
        if found is None:
            return self.spares[unit].usage if unit in self.spares else None
        labor_us = found.behaviour.labor_of(found.transformation)
        return Usage(labor_us + round(found.use(self._now)), found.behaviour.memory_bytes)

    def pid(self, unit: str) -> int | None:  # noqa: ARG002
        return None

    def close(self) -> None:
        self.units.clear()
        self.topics.clear()
        self._due.clear()

    def _later(self, delay_s: float, event: Event) -> None:
        self._count += 1
        heapq.heappush(self._due, (self._now + delay_s, self._count, event, self._subject(event)))

    def _subject(self, event: Event) -> _Unit | _Prepared | None:
        """The unit or spare of an event; None if it does not exist."""
        match event:
            case UnitReady(unit) | UnitActive(unit) | UnitDied(unit) | UnitStopped(unit) | UnitStatus(unit):
                return self.units.get(unit)
            case SparePrepared(spare) | SpareLost(spare):
                return self.spares.get(spare)
        return None

    def _happens(self, event: Event) -> bool:
        """Let a due event take effect. Returns False if it no longer can."""
        match event:
            case WireSwitched(wire):
                return self._switch(wire)
            case UnitReady(unit) if unit in self.units:
                self.units[unit].is_ready = True
            case UnitActive(unit) if unit in self.units:
                if not self.units[unit].is_activating:
                    return False
                self._begin(unit)
            case UnitDied(unit) | UnitStopped(unit) if unit in self.units:
                has_orphan = self.units.pop(unit).behaviour.leaves_process
                for wire in [w for w, (stream, _) in self.wires.items() if stream.unit == unit and not has_orphan]:
                    self._end(wire)
                for wire in [wire for wire, (_, inlet) in self.wires.items() if inlet.unit == unit]:
                    self._inputs.pop(self.wires.pop(wire)[1], None)
            case TopicsStatus():
                self._later(self.sign_period_s, TopicsStatus(self._flows()))
            case UnitStatus(unit, steps, outputs=outputs) if unit in self.units:
                steps += 10
                of_unit = self.units[unit]
                errors = steps if of_unit.behaviour.failing else 0
                more = 10 if self._gives(unit) else 0
                given = {
                    port.name: PortCounts(outputs.get(port.name, PortCounts()).elements + more)
                    for port in of_unit.transformation.outputs
                }
                says = of_unit.behaviour.says
                said = says(self._now + self.sign_period_s) if says is not None and self._gives(unit) else {}
                self._later(self.sign_period_s, UnitStatus(unit, steps, errors, {}, given, qualities=said))
            case SpareLost(spare):
                return self.spares.pop(spare, None) is not None
            case UnitReady() | UnitActive() | UnitDied() | UnitStopped() | UnitStatus():
                return False
        return True

    def _flows(self) -> dict[str, Flow]:
        for topic in self._gave_s:
            stream = self.feeding(Inlet("", topic))
            if stream is not None and self._gives(stream.unit):
                self._gave_s[topic] = self._now
        return {
            topic: Flow(silent_s=None if gave_s is None else self._now - gave_s)
            for topic, gave_s in self._gave_s.items()
        }

    def _gives(self, unit: str, above: frozenset[str] = frozenset()) -> bool:
        """Whether a unit gives elements now: all that it needs must, but for units in `above`, which close a cycle."""
        found = self.units.get(unit)
        if (
            found is None
            or not (found.is_ready and found.is_active)
            or found.behaviour.quiet
            or found.behaviour.failing
        ):
            return False
        above |= {unit}
        return all(
            port.takes(sum(s.unit in above or self._gives(s.unit, above) for s in self._feeds(unit, port)))
            for port in found.transformation.needed_inputs
            if not port.service
        )

    def _feeds(self, unit: str, port: InputPort) -> list[Stream]:
        """The streams that feed an input now."""
        if port.count == 1:
            stream = self.feeding(Inlet(unit, port.name))
            return [] if stream is None else [stream]
        inlets = [inlet for inlet in self._inputs if inlet.unit == unit and inlet.input == port.name]
        return [stream for inlet in inlets if (stream := self.feeding(inlet)) is not None]

    def _switch(self, wire: int) -> bool:
        port = self._inputs.get(self.wires[wire][1]) if wire in self.wires else None
        if port is None or wire not in (port.active, port.standby):
            return False
        if wire == port.standby:
            port.active, port.standby = wire, None
        return True

    def _end(self, wire: int) -> None:
        """End a wire: its inlet switches to the standby, or has lost its input if there is none."""
        if wire not in self.wires:
            return
        inlet = self.wires[wire][1]
        port = self._inputs[inlet]
        if wire == port.standby:
            port.standby = None
        elif wire == port.active:
            port.active = None
            if port.standby is not None:
                self._later(0.0, WireSwitched(port.standby))
            elif inlet.is_outlet or inlet.unit in self.units:
                self._later(0.0, InputLost(inlet.unit or None, inlet.port, wire))
