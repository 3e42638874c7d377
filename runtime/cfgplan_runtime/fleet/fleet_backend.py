"""A fleet's backend: agents run units on their hosts; what feeds a unit on another host goes by the hosts' relays."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from math import inf
from pathlib import Path
from types import MappingProxyType
from typing import TypeAlias
from urllib.parse import unquote

import msgspec

from cfgplan.domain import ComputationUnit, Host, Publication, Stream, Subscription, Transformation
from cfgplan.errors import InputError
from cfgplan_runtime.children.messages import Export, Flow, Import, ImportUnused, Release
from cfgplan_runtime.children.unit_order import unit_order
from cfgplan_runtime.fleet.agent import alive_key, clock_key, digest_of, source_file
from cfgplan_runtime.fleet.certificates import MANAGER
from cfgplan_runtime.fleet.links import config
from cfgplan_runtime.fleet.orders import (
    HEARD,
    REFUSE,
    SAY,
    ClockOrder,
    CloseTopicOrder,
    ConnectOrder,
    CutOrder,
    EndWireOrder,
    EventTold,
    FromAgent,
    GreetOrder,
    Held,
    KillOrder,
    LeaveOrder,
    OpenTopicOrder,
    Order,
    RenewOrder,
    Session,
    StartOrder,
    StopOrder,
    SwitchOrder,
    Talk,
    UsageTold,
    Welcome,
    event_of,
    read_session,
)
from cfgplan_runtime.processes.process_backend import RELAY
from cfgplan_runtime.streams.crossing import crossing_key
from cfgplan_runtime.streams.run_folder import RunFolder, is_alive
from cfgplan_runtime.streams.zenoh_link import ZenohLink
from cfgplan_runtime.supervision.backend import Found, FoundWire, Inlet, Usage
from cfgplan_runtime.supervision.events import (
    Event,
    HelperAlive,
    HostJoined,
    HostLost,
    InputLost,
    OutletsLost,
    OutletsOpened,
    OutOfDescriptors,
    TopicsStatus,
    UnitDied,
    UnitStopped,
    WireSwitched,
)

WAIT_S = 3.0
"""Seconds that hosts are waited for at the beginning."""
_LEAVE_S = 2.0
_CALLS = 30
"""The shortest of so many calls tells how far a host's clock is ahead."""
_CALL_S = 1.0


@dataclass(slots=True, eq=False)
class _HostState:
    """A host whose agent is alive. It counts as there once its clock is known."""

    name: str
    life: str
    """What tells this agent from one of the same name before it."""
    talk: Talk[FromAgent]
    is_there: bool = False
    ahead_ns: int = 0
    """How far its clock is ahead of this computer's monotonic one."""
    run: Path | None = None
    held: Held = field(default_factory=Held)
    """What ran there when it was greeted."""
    usage: dict[str, Usage] = field(default_factory=dict)
    flows: dict[str, Flow] = field(default_factory=dict)
    helpers: set[str] = field(default_factory=set)


@dataclass(slots=True, eq=False)
class _Crossing:
    """A stream on its way to another host. It is released once all of the `connected` wires are gone."""

    name: str
    wire: int
    """The wire from the unit to its host's relay."""
    stream: Stream
    source: str
    target: str
    blocks: bool
    connected: int = 0


@dataclass(frozen=True, slots=True)
class _Route:
    """A wire's way: within one host, or over a crossing."""

    wire: int
    stream: Stream
    inlet: Inlet
    source: str
    target: str
    crossing: _Crossing | None

    @property
    def local_stream(self) -> Stream:
        """What feeds the inlet on its host."""
        return self.stream if self.crossing is None else Stream(RELAY, self.crossing.name)


@dataclass(frozen=True, slots=True)
class _Measured:
    """How far a host's clock is ahead; None if it does not answer."""

    host: _HostState
    ahead_ns: int | None


_Arrival: TypeAlias = "tuple[str, bytes, bytes] | tuple[str, bool] | _Measured | None"


class FleetBackend:
    """The backend of a manager. Of `hosts`, those that are not there after `wait_s` are told as lost.

    `connect` names agents' endpoints; `folder` is what `units.py:Class` is
    relative to here: files there are compared with each host's. A unit or topic whose host is None goes to the first
    host that is there. What runs on the hosts by the transformations of `library` is `found`, all else there is ended.
    Raises InputError, also if another manager has a host, unless this one `takes_over`. Nobody takes over who sees
    fewer than half of the hosts.
    """

    def __init__(
        self,
        hosts: Sequence[str],
        run_folder: RunFolder,
        *,
        connect: Sequence[str],
        certificates: Path | None = None,
        folder: Path | None = None,
        library: Mapping[str, Transformation] = MappingProxyType({}),
        wait_s: float = WAIT_S,
        takes_over: bool = False,
    ) -> None:
        self._folder = folder or Path.cwd()
        self._inbox: queue.SimpleQueue[_Arrival] = queue.SimpleQueue()
        self._events: list[Event] = []
        self._hosts: dict[str, _HostState] = {}
        self._units: dict[str, str] = {}
        self._topics: dict[str, tuple[str | None, str]] = {}
        """By topic: the host that was asked for, and the one where it is."""
        self._unplaced: set[str] = set()
        """Topics for which no host was asked, while none is there."""
        self._routes: dict[int, _Route] = {}
        self._crossings: dict[str, _Crossing] = {}
        self._shared: dict[tuple[Stream, str, bool], _Crossing] = {}
        """The crossings that more inputs may be fed by: stream, host, and whether it may wait."""
        self._serial = 0
        self._term = 1
        self._library = library
        self._is_beginning = True
        """Until all hosts were waited for: what they run is adopted then, and ended later."""
        self._takes_over = takes_over
        """Whether hosts are taken from a living manager; only at the beginning, so that nobody takes them back."""
        self._seen: dict[str, str] = {}
        """The hosts that were alive before any was greeted, and what tells their agents from earlier ones."""
        self._is_greeting = False
        self._rival = ""
        """A host that obeys another manager."""
        self.run_folder = run_folder
        self._link = ZenohLink(config(connect=connect, certificates=certificates, mode="peer"))
        for kind in (SAY, HEARD, REFUSE):
            self._link.hear(crossing_key("*", kind, MANAGER, "*"), lambda *came: self._inbox.put(came))
        self._link.watch(f"{alive_key('*')}/*", lambda *came: self._inbox.put(came))
        self._link.live(f"{alive_key(MANAGER)}/{self.id}")
        try:
            self._await(hosts, wait_s)
        except InputError:
            self.close()
            raise

    @property
    def id(self) -> str:
        return self.run_folder.id

    def found(self) -> Found | None:
        held = {name: host.held for name, host in self._hosts.items() if host.is_there}
        self._adopt_clocks()
        self._adopt_units(held)
        self._adopt_crossings(held)
        wires = self._adopt_wires(held)
        for name, one in held.items():
            for topic, asked in one.topics.items():
                self._topics[topic] = (asked, name)
                self._show(topic, name)
        if not (self._units or self._topics):
            return None
        labels = {unit: held[host].units[unit].label for unit, host in self._units.items()}
        labor_us = {unit: held[host].units[unit].labor_us for unit, host in self._units.items()}
        return Found(
            tuple(_as_wired(unit, labels[unit], host, wires) for unit, host in sorted(self._units.items())),
            tuple(self._library[label] for label in sorted(set(labels.values()))),
            tuple(Host(host) for host in sorted(set(self._units.values()))),
            {unit: labor for unit, labor in labor_us.items() if labor is not None},
            tuple(wires),
            {topic: asked for topic, (asked, _) in self._topics.items()},
        )

    def now(self) -> float:
        return time.monotonic()

    def wake(self) -> None:
        self._inbox.put(None)

    def wait(self, timeout_s: float | None) -> Sequence[Event]:
        end_s = inf if timeout_s is None else self.now() + timeout_s
        is_awake = self._hear_all()
        while not (is_awake or self._events or self.now() >= end_s):
            due_s = min((host.talk.due_s() for host in self._hosts.values()), default=inf)
            left_s = min(end_s, due_s) - self.now()
            with suppress(queue.Empty):
                arrival = self._inbox.get(timeout=None if left_s == inf else max(0.0, left_s))
                is_awake = self._hear(arrival)
            is_awake = self._hear_all() or is_awake
        events, self._events = self._events, []
        return events

    def start(self, unit: str, transformation: Transformation, state: bytes | None, host: str | None) -> None:
        there = self._place(host)
        if there is None:
            return
        self._units[unit] = there
        file = source_file(transformation.source or "", self._folder)
        digest = None if file is None else digest_of(file)
        self._say(there, StartOrder(transformation.label, unit_order(unit, transformation, state), digest))

    def stop(self, unit: str) -> None:
        self._say(self._units.get(unit), StopOrder(unit))

    def kill(self, unit: str, *, dump: bool = False) -> None:
        self._say(self._units.get(unit), KillOrder(unit, dump))

    def connect(self, wire: int, stream: Stream, inlet: Inlet, *, queue: int, blocks: bool) -> None:
        source, target = self._units.get(stream.unit), self._host_of(inlet)
        if target is None:
            return
        if source is None:
            self._events.append(InputLost(inlet.unit or None, inlet.port, wire))
            return
        crossing = None if source == target else self._cross(stream, source, target, queue=queue, blocks=blocks)
        if crossing is not None:
            crossing.connected += 1
        route = self._routes[wire] = _Route(wire, stream, inlet, source, target, crossing)
        self._say(target, ConnectOrder(wire, route.local_stream, inlet, queue, blocks))

    def disconnect(self, wire: int, inlet: Inlet) -> None:
        self._routes.pop(wire, None)
        self._say(self._host_of(inlet), CutOrder(wire, inlet))

    def end_wire(self, wire: int, stream: Stream, inlet: Inlet) -> None:
        route = self._routes.pop(wire, None)
        if route is None:
            return
        crossing = route.crossing
        has_consumer = inlet.is_outlet or inlet.unit in self._units
        if crossing is not None and has_consumer and self._is_there(route.source):
            # What the source has given is under way, and its end comes behind it.
            self._say(route.source, EndWireOrder(crossing.wire, stream, Inlet(RELAY, crossing.name)))
        else:
            self._say(route.target, EndWireOrder(wire, route.local_stream, inlet))

    def switch_now(self, inlet: Inlet) -> None:
        self._say(self._host_of(inlet), SwitchOrder(inlet))

    def open_outlet(self, topic: str, host: str | None) -> None:
        there = self._place(host)
        if there is not None:
            self._topics[topic] = (host, there)
            self._say(there, OpenTopicOrder(topic, host))
            self._show(topic, there)
        elif host is None:
            self._unplaced.add(topic)

    def close_outlet(self, topic: str) -> None:
        _, there = self._topics.pop(topic, (None, ""))
        self._unplaced.discard(topic)
        self.run_folder.forget(topic)
        self._say(there, CloseTopicOrder(topic))

    def renew(self, helper: str) -> None:
        host, _, name = helper.partition(": ")
        self._say(host, RenewOrder(name))

    def usage(self, unit: str) -> Usage | None:
        host = self._hosts.get(self._units.get(unit, ""))
        return None if host is None else host.usage.get(unit)

    def pid(self, unit: str) -> int | None:
        usage = self.usage(unit)
        return None if usage is None else usage.pid

    def close(self) -> None:
        for name in self._hosts:
            self._say(name, LeaveOrder())
        end_s = self.now() + _LEAVE_S
        while any(not host.talk.is_done for host in self._hosts.values()) and self.now() < end_s:
            self.wait(0.05)
        self._link.close()

    def _await(self, hosts: Sequence[str], wait_s: float) -> None:
        """Wait until all hosts are there, at most `wait_s`, and tell of those that are not."""
        end_s = self.now() + wait_s
        while not self._seen.keys() >= set(hosts) and self.now() < end_s:
            self._hear_once(end_s)
        few = [host for host in hosts if host in self._seen]
        if self._takes_over and 2 * len(few) < len(hosts):
            message = f"{len(few)} of {len(hosts)} hosts can be reached: who sees fewer than half does not take over"
            raise InputError.of(message, mend="run it where more hosts can be reached")
        self._is_greeting = True
        for name, life in self._seen.items():
            self._greet(name, life, "")
        joined, events = set[str](), list[Event]()
        while not joined >= self._seen.keys() and self.now() < end_s + _CALL_S:
            self._hear_once(end_s + _CALL_S)
            if self._rival:
                mend = "stop the other run first, or add --take-over"
                raise InputError.of(f"another run has host {self._rival!r}", mend=mend)
            joined |= {event.host for event in self._events if isinstance(event, HostJoined)}
            events += self._events
            self._events.clear()
        self._is_beginning = self._takes_over = False
        self._events += [*events, *(HostLost(host, "it has no agent") for host in hosts if host not in joined)]

    def _adopt_clocks(self) -> None:
        """Go on with the differences between clocks that there are: an element's time is shifted there and back."""
        known = [host for host in self._hosts.values() if host.is_there and host.held.ahead_ns is not None]
        for host in known:
            host.ahead_ns = known[0].ahead_ns + (host.held.ahead_ns or 0) - (known[0].held.ahead_ns or 0)
            self._say(host.name, ClockOrder(host.ahead_ns))

    def _adopt_units(self, held: Mapping[str, Held]) -> None:
        """Keep the units that were started as they would be now, and end all others."""
        for host, one in held.items():
            for unit, known in one.units.items():
                transformation = self._library.get(known.label)
                if transformation is not None and unit_order(unit, transformation, None) == known.order:
                    self._units[unit] = host
                else:
                    self._say(host, KillOrder(unit, dump=False))

    def _adopt_crossings(self, held: Mapping[str, Held]) -> None:
        for source, one in held.items():
            for name, export in one.exports.items():
                target = export.order.host
                self._serial = max(self._serial, -export.wire)
                if export.stream is None or target not in held or name not in held[target].imports:
                    self._say(source, Release(name))
                    continue
                stream, blocks = export.stream, export.order.blocks
                connected = held[target].imports[name].connected
                crossing = _Crossing(name, export.wire, stream, source, target, blocks, connected)
                self._crossings[name] = crossing
                if stream.unit in self._units:
                    self._shared[stream, target, blocks] = crossing

    def _adopt_wires(self, held: Mapping[str, Held]) -> list[FoundWire]:
        """Keep the wires between units that were kept, and end all others."""
        found = []
        for target, one in held.items():
            for known in one.wires:
                crossing = self._crossings.get(known.stream.port) if known.stream.unit == RELAY else None
                stream = known.stream if crossing is None else crossing.stream
                is_wanted = known.inlet.is_outlet or known.inlet.unit in self._units
                if stream.unit not in self._units or not is_wanted:
                    self._say(target, CutOrder(known.wire, known.inlet))
                    continue
                source = self._units[stream.unit]
                self._routes[known.wire] = _Route(known.wire, stream, known.inlet, source, target, crossing)
                found.append(FoundWire(known.wire, stream, known.inlet, known.has_switched))
        return found

    def _hear_once(self, end_s: float) -> None:
        """Wait for something to arrive, or for something to be sent, and handle it."""
        due_s = min((host.talk.due_s() for host in self._hosts.values()), default=inf)
        with suppress(queue.Empty):
            self._hear(self._inbox.get(timeout=max(0.0, min(end_s, due_s) - self.now())))
        self._hear_all()

    def _hear_all(self) -> bool:
        """Handle what has arrived, then send what is due. Returns whether to return to the caller."""
        is_awake = False
        with suppress(queue.Empty):
            while True:
                is_awake = self._hear(self._inbox.get_nowait()) or is_awake
        for host in list(self._hosts.values()):
            host.talk.pump(self.now())
            if host.talk.is_broken:
                self._greet(host.name, host.life, "messages were lost")
        return is_awake

    def _hear(self, arrival: _Arrival) -> bool:
        match arrival:
            case None:
                return True
            case _Measured(host, ahead_ns) if self._hosts.get(host.name) is host:
                self._welcome(host, ahead_ns)
            case (str(key), bool(is_alive)):
                self._note_life(key, is_alive)
            case (str(key), bytes(head), bytes(payload)):
                self._hear_agent(key, head, payload)
        return False

    def _note_life(self, key: str, is_alive: bool) -> None:
        _, name, _, life = key.split("/")
        if name == MANAGER:
            return
        host = self._hosts.get(unquote(name))
        if not self._is_greeting:
            if is_alive:
                self._seen[unquote(name)] = life
            else:
                self._seen.pop(unquote(name), None)
        elif is_alive and (host is None or host.life != life):
            self._greet(unquote(name), life, "its agent was started again")
        elif not is_alive and host is not None and host.life == life:
            self._lose(host, "its agent is gone, or can't be reached")

    def _greet(self, name: str, life: str, cause: str) -> None:
        """Begin anew with a host."""
        if name in self._hosts:
            self._lose(self._hosts[name], cause)
        self._serial += 1
        session = Session(self._term, self.id, self._serial)
        host = self._hosts[name] = _HostState(name, life, Talk(self._link, MANAGER, name, session, FromAgent))
        host.talk.say(GreetOrder(adopts=self._is_beginning), self.now())

    def _lose(self, host: _HostState, cause: str) -> None:
        del self._hosts[host.name]
        self._events += [HelperAlive(f"{host.name}: {helper}", inf) for helper in host.helpers]
        if not host.is_there:
            return
        self._units = {unit: at for unit, at in self._units.items() if at != host.name}
        self._shared = {key: one for key, one in self._shared.items() if host.name not in (one.source, one.target)}
        for crossing in [one for one in self._crossings.values() if one.target == host.name]:
            self._release(crossing)
        self._events.append(HostLost(host.name, cause))
        moved = [topic for topic, (asked, at) in self._topics.items() if at == host.name and asked is None]
        for topic in [topic for topic, (_, at) in self._topics.items() if at == host.name]:
            self.run_folder.forget(topic)
            del self._topics[topic]
        for topic in moved:
            self.open_outlet(topic, None)
        if moved:
            self._events += [OutletsLost(f"{host.name} is gone"), OutletsOpened()]

    def _hear_agent(self, key: str, head: bytes, payload: bytes) -> None:
        *_, kind, _, name = key.split("/")
        session = read_session(name)
        host = next((one for one in self._hosts.values() if one.talk.session == session), None)
        if host is None:
            return
        if kind == REFUSE:
            self._heed(host, payload)
            return
        try:
            for message in host.talk.hear(kind, head, payload, self.now()):
                self._understand(host, message)
        except msgspec.MsgspecError as error:
            self._lose(host, f"its agent is of another version of cfgplan: {error}")

    def _heed(self, host: _HostState, refusal: bytes) -> None:
        """A host obeys a later manager: yield to it if that is alive, unless this one is to take over."""
        try:
            term, is_obeyed = map(int, refusal.split())
        except ValueError:
            return  # of another version, or of nobody
        if is_obeyed and not self._takes_over:
            self._rival = host.name
            self.wake()
            self._lose(host, "it obeys a later manager")
        else:
            self._term = max(self._term, term + 1)
            self._greet(host.name, host.life, "it obeyed a manager that is gone")

    def _understand(self, host: _HostState, message: FromAgent) -> None:
        match message:
            case Welcome(run, held):
                host.held = held
                path = Path(run)
                host.run = path if is_alive(path) else None
                threading.Thread(target=self._measure, args=(host,), daemon=True).start()
            case EventTold():
                self._note(host, event_of(message))
            case UsageTold(usage):
                host.usage.update(usage)
            case ImportUnused(crossing, served):
                known = self._crossings.get(crossing)
                if known is not None and known.connected == served:
                    self._release(known)

    def _measure(self, host: _HostState) -> None:
        """Ask a host's clock; runs in a thread of its own."""
        found: list[tuple[int, int]] = []
        for _ in range(_CALLS):
            before_ns = time.monotonic_ns()
            for _, answer in self._link.ask(clock_key(host.name), _CALL_S):
                after_ns = time.monotonic_ns()
                found.append((after_ns - before_ns, int(answer) - (before_ns + after_ns) // 2))
        self._inbox.put(_Measured(host, min(found)[1] if found else None))

    def _welcome(self, host: _HostState, ahead_ns: int | None) -> None:
        if ahead_ns is None:
            self._greet(host.name, host.life, "its clock does not answer")
            return
        host.ahead_ns, host.is_there = ahead_ns, True
        self._say(host.name, ClockOrder(ahead_ns))
        self._events.append(HostJoined(host.name, (ahead_ns - time.time_ns() + time.monotonic_ns()) // 1000))
        if self._unplaced:
            unplaced, self._unplaced = self._unplaced, set()
            for topic in unplaced:
                self.open_outlet(topic, None)
            self._events.append(OutletsOpened())

    def _note(self, host: _HostState, event: Event) -> None:
        match event:
            case UnitDied(unit) | UnitStopped(unit):
                self._units.pop(unit, None)
                host.usage.pop(unit, None)
                self._shared = {key: one for key, one in self._shared.items() if key[0].unit != unit}
            case WireSwitched(wire) if wire in self._routes:
                inlet = self._routes[wire].inlet
                self._routes = {n: one for n, one in self._routes.items() if one.inlet != inlet or n >= wire}
            case InputLost(_, _, wire):
                self._routes.pop(wire, None)
            case HelperAlive(helper, patience_s):
                host.helpers.add(helper)
                event = HelperAlive(f"{host.name}: {helper}", patience_s)
            case TopicsStatus(flows):
                host.flows = dict(flows)
                event = TopicsStatus({topic: flow for one in self._hosts.values() for topic, flow in one.flows.items()})
            case OutOfDescriptors(cause):
                event = OutOfDescriptors(f"{host.name}: {cause}")
        self._events.append(event)

    def _cross(self, stream: Stream, source: str, target: str, *, queue: int, blocks: bool) -> _Crossing:
        """The crossing of a stream to a host: the one that there is, or a new one."""
        key = (stream, target, blocks)
        if key not in self._shared:
            self._serial += 1
            name, wire = f"{self.id}-{self._serial}", -self._serial
            crossing = self._shared[key] = _Crossing(name, wire, stream, source, target, blocks)
            self._crossings[name] = crossing
            shift_ns = self._hosts[target].ahead_ns - self._hosts[source].ahead_ns
            self._say(target, Import(name, source, shift_ns))
            self._say(source, Export(name, target, queue, blocks))
            self._say(source, ConnectOrder(wire, stream, Inlet(RELAY, name), queue, blocks))
        return self._shared[key]

    def _release(self, crossing: _Crossing) -> None:
        del self._crossings[crossing.name]
        self._shared = {key: one for key, one in self._shared.items() if one is not crossing}
        for host in (crossing.source, crossing.target):
            self._say(host, Release(crossing.name))

    def _say(self, host: str | None, order: Order) -> None:
        """Give an order to a host; does nothing if it is not there."""
        if host is not None and self._is_there(host):
            self._hosts[host].talk.say(order, self.now())

    def _is_there(self, host: str) -> bool:
        return host in self._hosts and self._hosts[host].is_there

    def _place(self, host: str | None) -> str | None:
        """The host for something; None if it is not there."""
        if host is None:
            return min((name for name in self._hosts if self._is_there(name)), default=None)
        return host if self._is_there(host) else None

    def _show(self, topic: str, host: str) -> None:
        """Have a topic be found in this run's folder, if its host is on this computer."""
        run = self._hosts[host].run
        if run is not None:
            self.run_folder.show(topic, run)

    def _host_of(self, inlet: Inlet) -> str | None:
        if inlet.is_outlet:
            return self._topics[inlet.port][1] if inlet.port in self._topics else None
        return self._units.get(inlet.unit)


def _as_wired(unit: str, label: str, host: str, wires: Sequence[FoundWire]) -> ComputationUnit:
    """A unit as its wires tell it."""
    feeds = tuple(Subscription(one.inlet.port, one.stream) for one in wires if one.inlet.unit == unit)
    published = tuple(
        Publication(one.stream.port, one.inlet.port) for one in wires if one.inlet.is_outlet and one.stream.unit == unit
    )
    return ComputationUnit(unit, label, feeds, published, host)
