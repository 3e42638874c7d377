"""A fleet's backend: agents run units on their hosts; what feeds a unit on another host goes by the hosts' relays."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from math import inf
from pathlib import Path
from types import MappingProxyType
from typing import TypeAlias
from urllib.parse import unquote

import msgspec

from cfgplan.domain import MANAGER, Stream, Transformation
from cfgplan.errors import InputError
from cfgplan_runtime.children.messages import Flow, ImportUnused
from cfgplan_runtime.children.unit_order import unit_order
from cfgplan_runtime.fleet.adoption import adopt
from cfgplan_runtime.fleet.agent import alive_key, clock_key, digest_of, source_file
from cfgplan_runtime.fleet.clocks import CALLS, CALLS_AGAIN, CLOCK_S, HostClock, Reading, corrected, has_moved
from cfgplan_runtime.fleet.links import MISSED_SIGNS, Pulse, config, sign_period_s
from cfgplan_runtime.fleet.orders import (
    HEARD,
    REFUSE,
    SAY,
    ClockOrder,
    CloseTopicOrder,
    DiscardOrder,
    EventTold,
    FromAgent,
    GreetOrder,
    Held,
    KillOrder,
    LeaveOrder,
    OpenTopicOrder,
    Order,
    PrepareOrder,
    RenewOrder,
    Session,
    StartOrder,
    SwitchOrder,
    Talk,
    UsageTold,
    Welcome,
    event_of,
    read_session,
)
from cfgplan_runtime.fleet.routes import Counts, OrderTo, Routes
from cfgplan_runtime.fleet.tunnels import RemoteTopics, TunnelClient, TunnelServer
from cfgplan_runtime.streams.crossing import crossing_key
from cfgplan_runtime.streams.run_folder import RunFolder, is_alive
from cfgplan_runtime.streams.zenoh_link import ZenohLink
from cfgplan_runtime.supervision.backend import Found, Inlet, Usage
from cfgplan_runtime.supervision.events import (
    ClockMoved,
    CrossingsStatus,
    Event,
    HelperAlive,
    HostJoined,
    HostLost,
    InputLost,
    OutletsLost,
    OutletsOpened,
    OutOfDescriptors,
    SpareLost,
    TopicsStatus,
    UnitDied,
    UnitStopped,
    WireSwitched,
)

WAIT_S = 3.0
"""Seconds that hosts are waited for at the beginning."""
_LEAVE_S = 2.0
_CALL_S = 1.0


@dataclass(slots=True, eq=False)
class _HostState:
    """A host whose agent is alive. It counts as there once its clock is known."""

    name: str
    life: str
    """What tells this agent from one of the same name before it."""
    talk: Talk[FromAgent]
    pulse: Pulse
    is_there: bool = False
    reading: Reading | None = None
    """What its clock said last."""
    ahead_ns: int | None = None
    """How far its clock is ahead of the run's, as it was told."""
    shown_ns: int = 0
    """How far its time of day is ahead of that here, as was last told."""
    gone: threading.Event = field(default_factory=threading.Event)
    run: Path | None = None
    held: Held = field(default_factory=Held)
    """What ran there when it was greeted."""
    usage: dict[str, Usage] = field(default_factory=dict)
    flows: dict[str, Flow] = field(default_factory=dict)
    helpers: set[str] = field(default_factory=set)


@dataclass(frozen=True, slots=True)
class _Measured:
    """What a host's clock says; None if it does not answer."""

    host: _HostState
    reading: Reading | None


_Arrival: TypeAlias = "tuple[str, bytes, bytes] | tuple[str, bool] | tuple[str, float] | _Measured | None"


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
        self._spares: dict[str, str] = {}
        self._topics: dict[str, tuple[str | None, str]] = {}
        """By topic: the host that was asked for, and the one where it is."""
        self._unplaced: set[str] = set()
        """Topics for which no host was asked, while none is there."""
        self._routes = Routes(run_folder.id)
        self._counts = Counts()
        self._clock_offset_ns = time.time_ns() - time.monotonic_ns()
        self._clock = HostClock(lambda: time.monotonic_ns() + self._clock_offset_ns)
        self._run_ahead_ns = 0
        """How far this process's clock is ahead of the run's, which may be an earlier manager's."""
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
        self._round_s = inf
        """When it was last looked what had arrived."""
        self._left_alone: set[str] = set()
        """Agents that are alive and can't be given orders; what tells them from others, as in `_seen`."""
        self._rival = ""
        """A host that obeys another manager."""
        self.run_folder = run_folder
        self._link = _linked(connect, certificates, wait_s)
        for kind in (SAY, HEARD, REFUSE):
            self._link.hear(crossing_key(None, kind, MANAGER, "*"), lambda *came: self._inbox.put(came))
        self._link.watch(f"{alive_key(None)}/*", lambda *came: self._inbox.put(came))
        self._link.hear(f"{alive_key(None)}/*", lambda key, *_: self._inbox.put((key, self.now())))
        self._tunnels = TunnelServer(self._link, MANAGER, self.id, run_folder.path)
        self._reaching = TunnelClient(self._link)
        self._topics_elsewhere = RemoteTopics(self._reaching, run_folder)
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
        adopted = adopt(self.id, held, self._library)
        self._units, self._spares = dict(adopted.units), dict(adopted.spares)
        self._topics, self._routes = dict(adopted.topics), adopted.routes
        self._give(adopted.orders)
        for topic, (_, host) in self._topics.items():
            self._show(topic, host)
        return adopted.found

    def now(self) -> float:
        return time.monotonic()

    def wake(self) -> None:
        self._inbox.put(None)

    def wait(self, timeout_s: float | None) -> Sequence[Event]:
        end_s = inf if timeout_s is None else self.now() + timeout_s
        is_awake = self._hear_all()
        while not (is_awake or self._events or self.now() >= end_s):
            with suppress(queue.Empty):
                arrival = self._inbox.get(timeout=self._patience_s(end_s))
                is_awake = self._hear(arrival)
            is_awake = self._hear_all() or is_awake
        events, self._events = self._events, []
        return events

    def start(
        self, unit: str, transformation: Transformation, state: bytes | None, host: str | None, spare: str | None = None
    ) -> None:
        there = self._place(host)
        if spare is not None and self._spares.get(spare) != there:
            self.discard(spare)
            spare = None
        self._spares.pop(spare or "", None)
        if there is None:
            return
        self._units[unit] = there
        order = unit_order(unit, transformation, state)
        self._say(there, StartOrder(transformation.label, order, self._digest(transformation), spare))

    def prepare(self, spare: str, transformation: Transformation, host: str | None) -> None:
        there = self._place(host)
        if there is None:
            return
        self._spares[spare] = there
        order = unit_order(spare, transformation, None)
        self._say(there, PrepareOrder(transformation.label, order, self._digest(transformation)))

    def discard(self, spare: str) -> None:
        self._say(self._spares.pop(spare, None), DiscardOrder(spare))

    def stop(self, unit: str) -> None:
        if unit in self._units:
            self._give(self._routes.stop(unit, self._units[unit]))

    def kill(self, unit: str, *, dump: bool = False) -> None:
        self._say(self._units.get(unit), KillOrder(unit, dump))

    def connect(self, wire: int, stream: Stream, inlet: Inlet, *, queue: int, blocks: bool) -> None:
        source, target = self._units.get(stream.unit), self._host_of(inlet)
        if target is None:
            return
        if source is None:
            self._events.append(InputLost(inlet.unit or None, inlet.port, wire))
            return
        self._give(self._routes.connect(wire, stream, inlet, source, target, queue=queue, blocks=blocks))

    def disconnect(self, wire: int, inlet: Inlet) -> None:
        self._give(self._routes.disconnect(wire, inlet, self._host_of(inlet)))

    def end_wire(self, wire: int, stream: Stream, inlet: Inlet) -> None:  # noqa: ARG002
        source = self._routes.source_of(wire)
        has_consumer = inlet.is_outlet or inlet.unit in self._units
        self._give(self._routes.end(wire, has_both_ends=has_consumer and source is not None and self._is_there(source)))

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
        self._topics_elsewhere.hide(topic)
        self._say(there, CloseTopicOrder(topic))

    def renew(self, helper: str) -> None:
        host, _, name = helper.partition(": ")
        self._say(host, RenewOrder(name))

    def usage(self, unit: str) -> Usage | None:
        host = self._hosts.get(self._units.get(unit) or self._spares.get(unit, ""))
        return None if host is None else host.usage.get(unit)

    def pid(self, unit: str) -> int | None:
        usage = self.usage(unit)
        return None if usage is None else usage.pid

    def close(self) -> None:
        for name, host in self._hosts.items():
            host.gone.set()
            self._say(name, LeaveOrder())
        end_s = self.now() + _LEAVE_S
        while any(not host.talk.is_done for host in self._hosts.values()) and self.now() < end_s:
            self.wait(0.05)
        for end in (self._topics_elsewhere, self._reaching, self._tunnels, self._link):
            end.close()

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
        self._begin_clocks()
        self._events += [*events, *(HostLost(host, "it has no agent") for host in hosts if host not in joined)]

    def _hear_once(self, end_s: float) -> None:
        """Wait for something to arrive, or for something to be sent, and handle it."""
        with suppress(queue.Empty):
            self._hear(self._inbox.get(timeout=self._patience_s(end_s)))
        self._hear_all()

    def _patience_s(self, end_s: float) -> float:
        """Seconds until something is to be sent, but never longer than signs of life take."""
        due_s = min((host.talk.due_s() for host in self._hosts.values()), default=inf)
        return max(0.0, min(min(end_s, due_s) - self.now(), sign_period_s()))

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
        self._lose_silent()
        return is_awake

    def _lose_silent(self) -> None:
        """Lose hosts of which nothing was heard for a lease, unless it was this process that heard nothing."""
        now_s, before_s, self._round_s = self.now(), self._round_s, self.now()
        for host in list(self._hosts.values()):
            if now_s - before_s >= MISSED_SIGNS * sign_period_s():
                host.pulse.note(now_s)
            elif host.pulse.is_lost(now_s):
                self._lose(host, f"nothing was heard of it for {now_s - host.pulse.last_s:.1f} s")

    def _hear(self, arrival: _Arrival) -> bool:
        match arrival:
            case None:
                return True
            case _Measured(host, Reading() as reading) if self._hosts.get(host.name) is host:
                self._note_clock(host, reading)
            case _Measured(host, None) if self._hosts.get(host.name) is host and not host.is_there:
                self._greet(host.name, host.life, "its clock does not answer")
            case (str(key), bool(is_alive)):
                self._note_life(key, is_alive)
            case (str(key), float(at_s)):
                self._note_sign(key, at_s)
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
        elif is_alive and host is not None:
            host.pulse.note(self.now())
        elif not is_alive and host is not None and host.life == life and host.pulse.is_steady(self.now()):
            self._lose(host, "its agent is gone")

    def _note_sign(self, key: str, at_s: float) -> None:
        """Note a sign of life. It is told of who is alive by Zenoh too, but not of everyone after a link was cut."""
        _, name, _, life = key.split("/")
        if life not in self._left_alone:
            self._note_life(key, is_alive=True)
        host = self._hosts.get(unquote(name))
        if host is not None and host.life == life:
            host.pulse.note(at_s)

    def _greet(self, name: str, life: str, cause: str) -> None:
        """Begin anew with a host."""
        if name in self._hosts:
            self._lose(self._hosts[name], cause)
        self._serial += 1
        session = Session(self._term, self.id, self._serial)
        talk: Talk[FromAgent] = Talk(self._link, MANAGER, name, session, FromAgent)
        host = self._hosts[name] = _HostState(name, life, talk, Pulse(self.now(), self.now()))
        host.talk.say(GreetOrder(adopts=self._is_beginning))

    def _lose(self, host: _HostState, cause: str) -> None:
        del self._hosts[host.name]
        host.gone.set()
        self._reaching.lose(host.name, host.life)
        self._events += [HelperAlive(f"{host.name}: {helper}", inf) for helper in host.helpers]
        if not host.is_there:
            return
        self._units = {unit: at for unit, at in self._units.items() if at != host.name}
        self._spares = {spare: at for spare, at in self._spares.items() if at != host.name}
        self._give(self._routes.forget_host(host.name))
        self._events.append(HostLost(host.name, cause))
        moved = [topic for topic, (asked, at) in self._topics.items() if at == host.name and asked is None]
        for topic in [topic for topic, (_, at) in self._topics.items() if at == host.name]:
            self._topics_elsewhere.hide(topic)
            del self._topics[topic]
        for topic in moved:
            self.open_outlet(topic, None)
        if moved:
            self._events += [OutletsLost(f"{host.name} is gone"), OutletsOpened()]

    def _hear_agent(self, key: str, head: bytes, payload: bytes) -> None:
        _, name, kind, _, session = key.split("/")
        host = self._hosts.get(unquote(name))
        if host is None or host.talk.session != read_session(session):
            return
        if kind == REFUSE:
            self._heed(host, payload)
            return
        try:
            for message in host.talk.hear(kind, head, payload, self.now()):
                self._understand(host, message)
        except msgspec.MsgspecError as error:
            self._left_alone.add(host.life)
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
            self._left_alone.add(host.life)
            self._lose(host, "it obeys a later manager")
        else:
            self._term = max(self._term, term + 1)
            self._greet(host.name, host.life, "it obeyed a manager that is gone")

    def _understand(self, host: _HostState, message: FromAgent) -> None:
        match message:
            case Welcome(run, held):
                host.held, host.ahead_ns = held, held.ahead_ns
                path = Path(run)
                host.run = path if is_alive(path) else None
                threading.Thread(target=self._measure, args=(host,), daemon=True).start()
            case EventTold():
                self._note(host, event_of(message))
            case UsageTold(usage, crossings):
                host.usage.update(usage)
                counts = self._counts.after(crossings, self._routes)
                if counts:
                    self._events.append(CrossingsStatus(counts))
            case ImportUnused(crossing, served):
                self._give(self._routes.note_unused(crossing, served))

    def _measure(self, host: _HostState) -> None:
        """Read a host's clock again and again; runs in a thread of its own."""
        calls, key = CALLS, clock_key(host.name)
        while not host.gone.is_set():
            reading = self._clock.read(lambda: (answer for _, answer in self._link.ask(key, _CALL_S)), calls)
            self._inbox.put(_Measured(host, reading))
            calls = CALLS_AGAIN
            host.gone.wait(CLOCK_S)

    def _note_clock(self, host: _HostState, reading: Reading) -> None:
        """A host whose clock is known is there."""
        host.reading, was_there, host.is_there = reading, host.is_there, True
        if not self._is_beginning:
            self._correct(host, reading)
        if not was_there or has_moved(host.shown_ns, reading):
            host.shown_ns = reading.day_ahead_ns
            kind = ClockMoved if was_there else HostJoined
            self._events.append(kind(host.name, reading.day_ahead_ns // 1000))
        if not was_there and self._unplaced:
            unplaced, self._unplaced = self._unplaced, set()
            for topic in unplaced:
                self.open_outlet(topic, None)
            self._events.append(OutletsOpened())

    def _begin_clocks(self) -> None:
        """Go on with the clock of an earlier manager, so that no element is taken for older than it is."""
        known = {host: host.reading for host in self._hosts.values() if host.reading is not None}
        for host, reading in known.items():
            if host.ahead_ns is not None:
                self._run_ahead_ns = host.ahead_ns - reading.ahead_ns
                break
        self.run_folder.tell_clock(self._clock_offset_ns - self._run_ahead_ns)
        for host, reading in known.items():
            self._correct(host, reading)

    def _correct(self, host: _HostState, reading: Reading) -> None:
        """Have a host correct its clock by what is certain."""
        before_ns, measured_ns = host.ahead_ns, reading.ahead_ns + self._run_ahead_ns
        host.ahead_ns = measured_ns if before_ns is None else corrected(before_ns, measured_ns, reading.doubt_ns)
        if host.ahead_ns != before_ns:
            self._say(host.name, ClockOrder(host.ahead_ns))

    def _note(self, host: _HostState, event: Event) -> None:
        match event:
            case UnitDied(unit) | UnitStopped(unit) if self._units.get(unit, host.name) != host.name:
                return  # another of that id is kept elsewhere
            case UnitDied(unit) | UnitStopped(unit):
                self._units.pop(unit, None)
                host.usage.pop(unit, None)
                self._routes.forget_unit(unit)
            case SpareLost(spare):
                self._spares.pop(spare, None)
                host.usage.pop(spare, None)
            case WireSwitched(wire):
                self._routes.note_switch(wire)
            case InputLost(_, _, wire):
                self._routes.forget(wire)
            case HelperAlive(helper, patience_s):
                host.helpers.add(helper)
                event = HelperAlive(f"{host.name}: {helper}", patience_s)
            case TopicsStatus(flows):
                host.flows = dict(flows)
                event = TopicsStatus({topic: flow for one in self._hosts.values() for topic, flow in one.flows.items()})
            case OutOfDescriptors(cause):
                event = OutOfDescriptors(f"{host.name}: {cause}")
        self._events.append(event)

    def _give(self, orders: Iterable[OrderTo]) -> None:
        for host, order in orders:
            self._say(host, order)

    def _say(self, host: str | None, order: Order) -> None:
        """Give an order to a host; does nothing if it is not there."""
        if host is not None and self._is_there(host):
            self._hosts[host].talk.say(order)

    def _digest(self, transformation: Transformation) -> str | None:
        file = source_file(transformation.source or "", self._folder)
        return None if file is None else digest_of(file)

    def _is_there(self, host: str) -> bool:
        return host in self._hosts and self._hosts[host].is_there

    def _place(self, host: str | None) -> str | None:
        """The host for something; None if it is not there."""
        if host is None:
            return min((name for name in self._hosts if self._is_there(name)), default=None)
        return host if self._is_there(host) else None

    def _show(self, topic: str, host: str) -> None:
        """Have a topic be found in this run's folder."""
        there = self._hosts[host]
        if there.run is None:
            self._topics_elsewhere.show(topic, host, there.life)
        else:
            self.run_folder.show(topic, there.run)

    def _host_of(self, inlet: Inlet) -> str | None:
        if inlet.is_outlet:
            return self._topics[inlet.port][1] if inlet.port in self._topics else None
        return self._units.get(inlet.unit)


def _linked(connect: Sequence[str], certificates: Path | None, wait_s: float) -> ZenohLink:
    """A link with the agents at these endpoints; through the only one to all others, if it is there in time."""
    if len(connect) == 1:
        with suppress(InputError):
            return ZenohLink(config(connect=connect, certificates=certificates, mode="client", reach_s=wait_s))
    return ZenohLink(config(connect=connect, certificates=certificates))
