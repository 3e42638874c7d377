"""The agent of a host: keeps the host's units, wires and topics, and obeys the manager with the highest term.

It outlives managers: units keep running without one.
"""

from __future__ import annotations

import secrets
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from math import inf
from pathlib import Path
from typing import Literal

import msgspec

from cfgplan import __version__
from cfgplan.domain import MANAGER
from cfgplan.errors import InputError
from cfgplan_runtime.children.messages import Export, Import, Marked, Release, TellMark
from cfgplan_runtime.children.program_source import ProgramSource
from cfgplan_runtime.children.unit_order import digest_of
from cfgplan_runtime.fleet import orders
from cfgplan_runtime.fleet.certificates import Validity, ending
from cfgplan_runtime.fleet.clocks import HostClock, clock_key
from cfgplan_runtime.fleet.heartbeats import Answering
from cfgplan_runtime.fleet.links import LEASE_S, PRIVATE, Lives, config, sign_period_s
from cfgplan_runtime.fleet.relay import Relay
from cfgplan_runtime.fleet.tunnels import TunnelServer
from cfgplan_runtime.fleet.twins import Twins
from cfgplan_runtime.fleet.ways import RouteWatch, alive_key, reach
from cfgplan_runtime.processes.cpu_group import CpuGroup
from cfgplan_runtime.processes.process_backend import RELAY, ProcessBackend
from cfgplan_runtime.streams.crossing import crossing_key
from cfgplan_runtime.streams.zenoh_link import ZenohLink
from cfgplan_runtime.supervision import events
from cfgplan_runtime.supervision.backend import Inlet

USAGE_PERIOD_S = 0.5
_MOST_SUPERSEDED = 16
_SILENCE_S = 5.0
"""Seconds without a message of the manager after which the hand-overs of states that it has left are undone."""
LINK_S = 2.0
"""Seconds that a starting agent waits for its first link."""


def source_file(source: str, folder: Path) -> Path | None:
    """The file of `units.py:Class`; None if a source names a module."""
    place = source.rpartition(":")[0]
    return folder / place if place.endswith(".py") else None


class Agent:
    """One host's part of a fleet. Call all methods from the thread that made it.

    Sources such as `units.py:Class` are relative to `folder` on this host. The folder of its topics is made in `base`.
    `cpu` is the group that limits the CPU time of its units. Raises InputError if the agent can't listen, or if the
    fleet already has its name.
    """

    def __init__(
        self,
        name: str,
        *,
        listen: Sequence[str] = (),
        connect: Sequence[str] = (),
        certificates: Path | None = None,
        folder: Path | None = None,
        preload: Sequence[str] = (),
        base: Path | None = None,
        say: Callable[[str], None] = lambda _: None,
        cpu: CpuGroup | None = None,
    ) -> None:
        if name == MANAGER:
            raise InputError.of(f"no host can be called {MANAGER!r}: name it otherwise")
        self.name = name
        self._life = life = secrets.token_hex(4)
        """The id of this process, by which managers tell it from another agent of its name."""
        self._tell_user = say
        self._arrived: deque[tuple[str, bytes, bytes]] = deque()
        self._channel: orders.ReliableChannel[orders.Order] | None = None
        self._held = orders.Held()
        self._states: dict[str, orders.HeldState] = {}
        """The last state of the units of each state's name, also of units that have ended."""
        self._stopping: dict[str, tuple[str, ...]] = {}
        """Units that stop once each of these crossings that still exists has delivered a mark for them."""
        self._marked: set[tuple[str, str]] = set()
        """The marks that have come, as crossing and unit."""
        self._ending: set[str] = set()
        """Units from before the last greeting that have not ended yet. Until they have, orders wait, and the agent
        sends nothing.
        """
        self._owes_welcome = False
        self._lost = 0
        """Elements that had not reached other hosts when their crossings ended, not yet reported to the manager."""
        self._orders: deque[orders.Order] = deque()
        self._heard_s = inf
        """When the last message of the obeyed manager came; infinite once the hand-overs that it left are undone."""
        self._managers = Lives()
        self._is_left = False
        """Whether the present manager has ended its run. Its key may stay alive for a moment."""
        self._unreadable: tuple[orders.Session, orders.OtherVersionError] | None = None
        """The last session with an order that this version can't read. It is refused as a whole."""
        self._superseded: dict[str, tuple[float, orders.Session]] = {}
        """For each manager that was obeyed before: when it is told next that its session is over, and the session. Told
        at once, it would replan with the hosts that have not heard of the new one yet. Told once, it might be
        suspended.
        """
        self._usage_due_s = 0.0
        self._failure: BaseException | None = None
        """The error that ends this agent."""
        # Bad endpoints and certificates are refused before a process is started.
        given = config(listen, connect, certificates)
        self._validity = None if certificates is None else Validity(certificates, name)
        with ExitStack() as stack:
            self._backend = ProcessBackend(folder=folder, preload=preload, base=base, cpu=cpu)
            stack.callback(self._backend.close)
            self._link = ZenohLink(given)
            stack.callback(self._link.close)
            self._refuse_twin(connect)
            self._answer()
            self._backend.warm_up()
            self._relay = Relay(name, self._link, self._backend.open_relay(), self._note_failure)
            stack.callback(self._relay.close)
            self._heartbeats = Answering(reach(listen, ()).listens, self._note_question)
            stack.callback(self._heartbeats.close)
            stack.callback(TunnelServer(self._link, name, life, self._backend.run_folder.path).close)
            key, twins = f"{alive_key(name)}/{life}", Twins(name, life, self._note_failure)
            self._link.live(key)
            self._link.give_signs(key, sign_period_s(), twins.sign)
            self._link.hear(f"{alive_key(name)}/*", lambda key, _, payload: twins.hear(key.rpartition("/")[2], payload))
            stack.callback(RouteWatch(self._link, key, listen, connect, certificates, self._note_failure, say).close)
            self._stack = stack.pop_all()

    def run(self) -> None:
        """Work until an exception, such as a signal handler's, then end everything that runs here."""
        with self._stack:
            while True:
                self._step()

    def _refuse_twin(self, connect: Sequence[str]) -> None:
        """Raise InputError if the fleet has an agent of this name. One that was just killed seems alive for a while.

        Without a link no agent is visible, so the agent first waits for a link to another computer.
        """
        link_s, is_far = time.monotonic() + LINK_S, any(not one.startswith(f"{PRIVATE}/") for one in connect)
        while is_far and not self._link.linked and time.monotonic() < link_s:
            time.sleep(0.02)
        end_s = time.monotonic() + 2 * LEASE_S
        while self._link.alive(f"{alive_key(self.name)}/*"):
            if time.monotonic() > end_s:
                raise InputError.of(f"the fleet has an agent {self.name!r} already", mend="give it another --name")
            time.sleep(0.1)

    def _answer(self) -> None:
        offset_ns = self._backend.clock_offset_ns
        self._link.answer(clock_key(self.name, self._life), HostClock(lambda: time.monotonic_ns() + offset_ns).answer)
        self._link.answer(orders.topics_key(self.name), self._topics_told)
        self._link.answer(orders.held_key(self.name), self._held_told)
        self._link.watch(f"{alive_key(MANAGER)}/*", self._note_manager)
        self._link.hear(f"{alive_key(MANAGER)}/*", lambda key, *_: self._note_manager(key, is_alive=True))
        for kind in (orders.SAY, orders.HEARD):
            self._link.hear(crossing_key(MANAGER, kind, self.name, "*"), self._take)

    def _topics_told(self) -> bytes:
        """Called by threads of the link."""
        channel, held = self._channel, self._held
        run = "" if channel is None else channel.session.manager
        return msgspec.json.encode(orders.TopicsReport(run, list(held.topics), held.ahead_ns or 0))

    def _held_told(self) -> bytes:
        """Called by threads of the link."""
        return msgspec.json.encode(msgspec.structs.replace(self._held, now_s=time.monotonic()))

    def _note_manager(self, key: str, is_alive: bool) -> None:
        """Called by threads of the link, as `_take` is."""
        self._managers.note(key, time.monotonic(), is_alive=is_alive)

    def _note_question(self, manager: str) -> None:
        """Called by the thread of the heartbeats."""
        self._note_manager(f"{alive_key(MANAGER)}/{manager}", is_alive=True)

    def _take(self, key: str, head: bytes, payload: bytes) -> None:
        """Called by threads of the link."""
        self._arrived.append((key, head, payload))
        self._backend.wake()

    def _note_failure(self, error: BaseException) -> None:
        """Called by the relay's thread, and by those of the way and the link."""
        self._failure = error
        self._backend.wake()

    def _step(self) -> None:
        if self._failure is not None:
            raise self._failure
        for event in self._backend.wait(self._patience_s()):
            self._tell(event)
        for message in self._backend.heard_from_relay():
            if isinstance(message, Marked):
                self._marked.add((message.crossing, message.unit))
            else:
                self._say(message)
        while self._arrived:
            self._hear(*self._arrived.popleft())
        while not self._ending and (self._owes_welcome or self._orders):
            if self._owes_welcome:
                self._owes_welcome = False
                run = str(self._backend.run_folder.path)
                self._held.now_s = time.monotonic()
                beats, states = self._heartbeats.places, dict(self._states)
                self._say(orders.Welcome(run, self._held, beats, states, __version__, orders.digest_of_fields()))
                if self._lost:
                    self._say(orders.report_of(events.ElementsLost(self.name, self._lost)))
                    self._lost = 0
            else:
                self._obey(self._orders.popleft())
        self._stop_due()
        now_s = time.monotonic()
        self._undo_handovers(now_s)
        self._tell_superseded(now_s)
        if self._validity is not None and (ends := self._validity.warning()) is not None:
            self._tell_user(ending(ends))
            self._say(orders.report_of(ends))
        if now_s >= self._usage_due_s:
            self._usage_due_s = now_s + USAGE_PERIOD_S
            self._tell_usage([*self._held.units, *self._held.spares])
        if self._channel is not None:
            self._channel.pump(now_s)

    def _patience_s(self) -> float:
        due_s = self._usage_due_s
        if self._channel is not None:
            due_s = min(due_s, self._channel.due_s())
        return max(0.0, due_s - time.monotonic())

    def _say(self, message: orders.FromAgent) -> None:
        if self._channel is not None and not self._ending:
            self._channel.say(message)

    def _hear(self, key: str, head: bytes, payload: bytes) -> None:
        *_, kind, _, name = key.split("/")
        session = orders.read_session(name)
        if session is None or session.life != self._life:
            return
        if self._unreadable is not None and session == self._unreadable[0]:
            self._refuse_unreadable(*self._unreadable)
            return
        channel = self._channel
        if channel is None or session != channel.session:
            if kind == orders.HEARD:
                return
            if channel is not None and not _supersedes(session, channel.session):
                self._refuse(session, channel.session, is_obeyed=self._has_living_manager)
                return
            if channel is None and self._unreadable is not None and self._is_superseded(session):
                self._refuse(session, self._unreadable[0], is_obeyed=False)
                return
            channel = orders.ReliableChannel(self._link, self.name, MANAGER, session, orders.Order)
        try:
            heard = channel.hear(kind, head, payload, time.monotonic())
        except orders.OtherVersionError as error:
            self._refuse_unreadable(session, error)
            return
        if channel is not self._channel:
            self._enter(channel)
        self._heard_s = time.monotonic()
        self._orders += heard
        self._is_left = self._is_left or any(isinstance(order, orders.LeaveOrder) for order in heard)

    def _is_superseded(self, session: orders.Session) -> bool:
        """Whether a session has ended for a later manager. It can't go on in the middle, but its manager may greet."""
        return any(session == earlier for _, earlier in self._superseded.values())

    def _enter(self, channel: orders.ReliableChannel[orders.Order]) -> None:
        """Obey the manager of a new session."""
        before = self._channel
        if before is not None and channel.session.manager != before.session.manager:
            self._superseded[before.session.manager] = time.monotonic() + LEASE_S, before.session
            if len(self._superseded) > _MOST_SUPERSEDED:
                del self._superseded[next(iter(self._superseded))]
            self._held.term = before.session.term
        self._channel = channel
        self._orders.clear()
        self._is_left = False

    def _refuse_unreadable(self, session: orders.Session, error: orders.OtherVersionError) -> None:
        """Refuse a session with an order that this version can't read. No order that came with it is carried out, the
        units keep running, and each further message of the session's manager is refused, too.
        """
        if self._unreadable is None or self._unreadable[0] != session:
            self._unreadable = session, error
            theirs = f"cfgplan {error.theirs}" if error.theirs else "an unknown version of cfgplan"
            self._tell_user(
                f"the orders of a run that has {theirs} are refused, since this agent has cfgplan {__version__} and "
                f"can't read them ({error}): install the same version on both, and start this agent again"
            )
        if self._channel is not None and self._channel.session == session:
            self._channel = None
            self._orders.clear()
        put = self._link.publisher(crossing_key(self.name, orders.REFUSE, MANAGER, str(session)), "orders")
        put(b"", f"{orders.OTHER_VERSION} {__version__} {error}".encode())

    def _is_alive(self, manager: str) -> bool:
        return self._managers.has(f"{alive_key(MANAGER)}/{manager}", time.monotonic())

    @property
    def _has_living_manager(self) -> bool:
        """Whether the manager of this channel is alive, and its run not over."""
        return self._channel is not None and not self._is_left and self._is_alive(self._channel.session.manager)

    def _tell_superseded(self, now_s: float) -> None:
        """Tell earlier managers that are alive, repeatedly, that a later one is obeyed while that one is alive."""
        if self._channel is None:
            return
        for manager, (due_s, session) in self._superseded.items():
            if now_s >= due_s and manager != self._channel.session.manager:
                self._superseded[manager] = now_s + LEASE_S / 2, session
                if self._is_alive(manager) and self._has_living_manager:
                    self._refuse(session, self._channel.session, is_obeyed=True)

    def _refuse(self, session: orders.Session, later: orders.Session, *, is_obeyed: bool) -> None:
        """Tell a manager that a later one is obeyed, and whether that one is alive (`is_obeyed`)."""
        put = self._link.publisher(crossing_key(self.name, orders.REFUSE, MANAGER, str(session)), "orders")
        put(b"", f"{later.term} {int(is_obeyed)}".encode())

    def _obey(self, order: orders.Order) -> None:
        backend, held = self._backend, self._held
        match order:
            case orders.GreetOrder(adopts, secret):
                self._owes_welcome = True
                if self._channel is not None:
                    self._heartbeats.obey(self._channel.session.manager, secret)
                if self._validity is not None:
                    self._validity.tell_again()
                if not adopts:
                    self._lost += self._relay.lost
                    self._end_everything()
            case orders.LeaveOrder():
                self._end_everything()
                self._held.failures.clear()
            case orders.KeepFailuresOrder(label, None):
                held.failures.pop(label, None)
            case orders.KeepFailuresOrder(label, orders.HeldFailures() as failures):
                failures.at_s = time.monotonic()
                held.failures[label] = failures
            case orders.ClockOrder(ahead_ns):
                held.ahead_ns = ahead_ns
                backend.correct_clock(ahead_ns)
            case orders.StartOrder():
                self._start(order)
            case orders.PrepareOrder():
                self._prepare(order)
            case orders.DiscardOrder(spare):
                held.spares.pop(spare, None)
                backend.discard(spare)
            case orders.StopOrder(unit, after):
                self._stopping[unit] = after
                if unit in held.units and held.units[unit].stop is None:
                    held.units[unit].stop = orders.HeldStop(time.monotonic())
            case orders.KillOrder(unit, dump):
                if self._stopping.pop(unit, None) is not None:
                    backend.stop(unit)
                backend.kill(unit, dump=dump)
            case orders.ActivateOrder(unit, is_active):
                if unit in held.units:
                    held.units[unit].is_active = is_active
                (backend.activate if is_active else backend.deactivate)(unit)
            case orders.HoldOrder(unit):
                self._note_handover(unit, "waits")
                backend.hold(unit)
            case orders.AskPlacesOrder(unit, inlets):
                backend.ask_places(unit, inlets)
            case orders.AskStateOrder(unit, until, successor):
                self._note_handover(unit, "is asked", successor)
                backend.ask_state(unit, until, successor)
            case orders.GiveStateOrder(unit, state, inputs, outputs):
                self._note_handover(unit, "has it")
                backend.give_state(unit, state, inputs, outputs)
            case orders.ConnectOrder(wire, stream, inlet, queue, blocks):
                self._hold_wire(order)
                backend.connect(wire, stream, inlet, queue=queue, blocks=blocks)
            case orders.CutOrder(wire, inlet):
                held.forget_wires(lambda one: one.wire == wire)
                backend.disconnect(wire, inlet)
            case orders.EndWireOrder(wire, stream, inlet):
                held.forget_wires(lambda one: one.wire == wire)
                backend.end_wire(wire, stream, inlet)
            case orders.SwitchOrder(inlet):
                backend.switch_now(inlet)
            case orders.OpenTopicOrder(topic, host):
                if topic not in held.topics:
                    backend.open_outlet(topic, None)
                held.topics[topic] = host
            case orders.CloseTopicOrder(topic) if topic in held.topics:
                del held.topics[topic]
                held.forget_wires(lambda one: one.inlet == Inlet("", topic))
                backend.close_outlet(topic)
            case orders.RenewOrder(helper):
                backend.renew(helper)
            case Export(crossing):
                held.exports[crossing] = orders.HeldExport(order)
                backend.tell_relay(order)
            case Import(crossing):
                held.imports[crossing] = orders.HeldImport(order)
                backend.tell_relay(order)
            case Release(crossing):
                self._tell_usage(())  # its last counts
                held.exports.pop(crossing, None)
                held.imports.pop(crossing, None)
                self._marked = {mark for mark in self._marked if mark[0] != crossing}
                backend.tell_relay(order)
            case TellMark():
                backend.tell_relay(order)

    def _note_handover(self, unit: str, part: Literal["waits", "has it", "is asked"], successor: str = "") -> None:
        if unit in self._held.units:
            self._held.units[unit].handover, self._held.units[unit].successor = part, successor

    def _undo_handovers(self, now_s: float) -> None:
        """If the manager is silent, let the units continue that pause since they have told it their state, and end the
        new units that wait for one. A manager acknowledges each report of usage, also while it waits for units.
        """
        if now_s - self._heard_s < _SILENCE_S:
            return
        self._heard_s = inf
        for unit, held in self._held.units.items():
            if held.handover == "is asked" and held.stop is None:
                self._backend.give_state(unit, None, {}, {})
            elif held.handover == "waits":
                self._backend.kill(unit)

    def _hold_wire(self, order: orders.ConnectOrder) -> None:
        held = self._held
        if order.inlet.unit == RELAY and order.inlet.port in held.exports:
            export = held.exports[order.inlet.port]
            export.wire, export.stream = order.wire, order.stream
            return
        held.forget_wires(lambda one: one.inlet == order.inlet)
        held.wires.append(orders.HeldWire(order.wire, order.stream, order.inlet))
        held.last_wire = max(held.last_wire, order.wire)
        if order.stream.unit == RELAY and order.stream.port in held.imports:
            held.imports[order.stream.port].connected += 1

    def _end_everything(self) -> None:
        held = self._held
        self._ending = set(held.units)
        for unit in held.units:
            self._backend.kill(unit)
        for spare in held.spares:
            self._backend.discard(spare)
        for topic in held.topics:
            self._backend.close_outlet(topic)
        for crossing in (*held.exports, *held.imports):
            self._backend.tell_relay(Release(crossing))
        self._held = orders.Held(held.term, units=held.units, failures=held.failures)
        self._states.clear()
        self._stopping.clear()
        self._marked.clear()

    def _stop_due(self) -> None:
        """Stop the units that have processed all elements sent before their order to stop."""
        for unit, after in list(self._stopping.items()):
            if all((crossing, unit) in self._marked or crossing not in self._held.imports for crossing in after):
                del self._stopping[unit]
                self._backend.stop(unit)
                if unit in self._held.units and (stop := self._held.units[unit].stop) is not None:
                    stop.is_told = True

    def _start(self, start: orders.StartOrder) -> None:
        unit = start.order.unit
        if start.spare is not None:
            self._held.spares.pop(start.spare, None)
        fault = self._fault_of_code(start)
        if fault:
            self._backend.discard(start.spare or "")
            self._say(orders.report_of(events.UnitDied(unit, fault, "could not start")))
            return
        order = msgspec.structs.replace(start.order, state=None)
        self._held.units[unit] = orders.HeldUnit(start.label, order, since_s=time.monotonic())
        self._keep_state(unit, start.order.state)
        self._backend.start_unit(start.order, start.spare)

    def _keep_state(self, unit: str, state: bytes | None) -> None:
        """Keep a state of a unit for the next manager."""
        held = None if unit in self._ending else self._held.units.get(unit)
        name = None if held is None else held.order.state_name
        if state and name is not None:
            ahead_ns = self._held.ahead_ns or 0
            now_ns = time.monotonic_ns() + self._backend.clock_offset_ns - ahead_ns
            self._states[name] = orders.HeldState(now_ns, state)

    def _prepare(self, prepare: orders.PrepareOrder) -> None:
        spare, fault = prepare.order.unit, self._fault_of_code(prepare)
        if fault:
            self._say(orders.report_of(events.SpareLost(spare, fault)))
            return
        self._held.spares[spare] = orders.HeldUnit(prepare.label, prepare.order)
        self._backend.prepare_unit(prepare.order)

    def _fault_of_code(self, order: orders.StartOrder | orders.PrepareOrder) -> str:
        """The reason why the code on this host can't carry out an order; empty if it can.

        Programs are not compared with the manager's: hosts with other processors need other ones.
        """
        try:
            program = ProgramSource.read(order.order.source)
            if program is not None:
                program.file(self._backend.code_folder)
        except InputError as error:
            return f"on {self.name}: {error}"
        file = source_file(order.order.source, self._backend.code_folder)
        if order.digest is None or file is None or digest_of(file) == order.digest:
            return ""
        is_there = "another version than the manager's" if file.exists() else "not there"
        return f"on {self.name}, {file} is {is_there}"

    def _tell(self, event: events.Event) -> None:
        held = self._held
        match event:
            case events.WireSwitched(wire) | events.InputLost(_, _, wire) if wire < 0:
                return  # a wire of the relay's
            case events.UnitDied(unit) | events.UnitStopped(unit) if unit in self._ending:
                self._ending.discard(unit)
                del held.units[unit]
                return
            case events.WireSwitched(wire):
                for one in held.wires:
                    one.has_switched = one.has_switched or one.wire == wire
            case events.InputLost(_, _, wire):
                held.forget_wires(lambda one: one.wire == wire)
            case events.UnitDied(unit) | events.UnitStopped(unit):
                held.units.pop(unit, None)
                held.forget_wires(lambda one: one.inlet.unit == unit)
            case events.UnitReady(unit, labor_us):
                held.units[unit].labor_us = labor_us
                self._tell_usage([unit])
            case events.UnitStatus(unit) | events.StateTold(unit):
                self._keep_state(unit, event.state)
            case events.SparePrepared(spare, labor_us):
                held.spares[spare].labor_us = labor_us
            case events.SpareLost(spare):
                held.spares.pop(spare, None)
        self._say(orders.report_of(event))

    def _tell_usage(self, units: Iterable[str]) -> None:
        usage = {unit: used for unit in units if (used := self._backend.usage(unit)) is not None}
        crossings = self._relay.counts()
        if usage or crossings:
            self._say(orders.UsageReport(usage, crossings))


def _supersedes(session: orders.Session, other: orders.Session) -> bool:
    """Whether an agent leaves the session `other` for this one."""
    if session.manager == other.manager and session.term == other.term:
        return session.greeting > other.greeting
    return session.term > other.term
