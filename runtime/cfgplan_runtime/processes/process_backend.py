"""Units as processes of this machine, made by a nursery and connected by socket pairs."""

from __future__ import annotations

import errno
import resource
import socket
import time
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from math import inf
from pathlib import Path

import msgspec

from cfgplan.domain import Stream, Transformation
from cfgplan_runtime.children import messages
from cfgplan_runtime.children.control import ControlConnection
from cfgplan_runtime.children.program_source import code_file, names_program
from cfgplan_runtime.children.unit_order import unit_order
from cfgplan_runtime.processes.child_process import (
    ChildProcess,
    PrintedLines,
    cause_of_end,
    changed_ns,
    kill_group,
)
from cfgplan_runtime.processes.cpu_group import CpuGroup
from cfgplan_runtime.processes.nursery_link import NurseryLink
from cfgplan_runtime.streams.channel import socket_pair
from cfgplan_runtime.streams.element import Moment
from cfgplan_runtime.streams.ends import Ends, Waker
from cfgplan_runtime.streams.run_folder import RunFolder
from cfgplan_runtime.supervision import events
from cfgplan_runtime.supervision.backend import Failures, Inlet, Usage
from cfgplan_runtime.supervision.delays import doubling_s

OUTLETS, RELAY = "", "/relay"
"""Names of the outlets among children, and of this process's own relay; no unit has one of them."""
_NO_PROCESS = 0
"""The relay's number among children."""
_NO_DESCRIPTOR = (errno.EMFILE, errno.ENFILE)
OUTLETS_HELPER, NURSERY_HELPER = "outlets", "nursery"
HELPER_S = 10.0
"""Seconds that a helper may be silent."""
_HELPER_START_S = 60.0
"""Seconds until the first sign of life: the nursery imports modules first."""
_OUTLET_QUEUE = 1024
_SPARES_LOOK_S = 1.0
"""Seconds between two checks for spares that hang or whose code has changed."""
PREPARE_S = 30.0
"""Seconds that a spare may take to be prepared."""
_AGAIN_S, _MOST_AGAIN_S, _GOOD_LIFE_S = 0.1, 5.0, 10.0
"""Seconds until outlets that were lost twice in a row are replaced, doubled for each further loss up to the second
value. After a life of the third value, a loss counts as the first.
"""


class ProcessBackend:
    """A backend of processes. Call all its methods from one thread, which must outlive it.

    Units and spares are put into the group `cpu`, if given, as soon as they have started.
    """

    def __init__(
        self,
        *,
        folder: Path | None = None,
        preload: Sequence[str] = (),
        base: Path | None = None,
        cpu: CpuGroup | None = None,
    ) -> None:
        _raise_descriptor_limit()
        self._cpu = cpu
        self._code_folder = str((folder or Path.cwd()).resolve())
        self._ends = Ends()
        self._waker = Waker()
        self._ends.watch(self._waker.socket, self._waker.hear)
        try:
            self.run_folder = RunFolder(base)  # last: where no descriptor is left, no folder is
        except BaseException:
            self._ends.close()
            self._waker.close()
            raise
        self._events: list[events.Event] = []
        self._children: dict[int, ChildProcess] = {}
        self._by_name: dict[str, ChildProcess] = {}
        self._spares: dict[str, ChildProcess] = {}
        """Cold spares by id; none of these is in `_by_name`."""
        self._look_due_s = 0.0
        self._topics: list[str] = []
        self._unopened: set[str] = set()
        """Topics whose address could not be made. The next connection to one tries again."""
        self._serial = 0
        self.clock_offset_ns = time.time_ns() - time.monotonic_ns()
        """The difference of this computer's clock from the monotonic one, in nanoseconds."""
        self._ahead_ns = 0
        """The difference of this computer's clock from the run's, on which elements have their times."""
        self.run_folder.tell_clock(self.clock_offset_ns)
        self._nursery = NurseryLink(self.run_folder.id, ("numpy", "numpy.random", *preload))
        self._nursery_socket: socket.socket | None = None
        self._outlets_lost = 0
        """The number of losses of the outlets in a row."""
        self._outlets_since_s = 0.0
        self._outlets_due_s: float | None = None
        """The time at which the outlets will be replaced; None while they run."""
        self._is_short = False
        """Whether the last wire failed for lack of a descriptor."""
        self._from_relay: list[messages.FromRelay] = []

    @property
    def id(self) -> str:
        return self.run_folder.id

    @property
    def code_folder(self) -> Path:
        """The folder of sources such as `units.py:Class`."""
        return Path(self._code_folder)

    def found(self) -> None:
        return None

    def now(self) -> float:
        return time.monotonic()

    def wake(self) -> None:
        self._waker.wake()

    def wait(self, timeout_s: float | None) -> Sequence[events.Event]:
        if self._outlets_due_s is not None:
            left_s = max(0.0, self._outlets_due_s - self.now())
            timeout_s = left_s if timeout_s is None else min(timeout_s, left_s)
        if self._events:
            timeout_s = 0.0
        if self._nursery_socket is not None:
            self._ends.write(self._nursery_socket, is_waiting=self._nursery.is_waiting)
        self._ends.wait(timeout_s)
        if self._outlets_due_s is not None and self._outlets_due_s <= self.now():
            self._start_outlets()
        if self._look_due_s <= self.now():
            self._look_due_s = self.now() + _SPARES_LOOK_S
            self._watch_spares()
            for child in self._children.values():
                if note := child.printed.left_out():
                    self._events.append(events.UnitPrinted(child.name, note))
                if child.is_printing and not child.printed.is_enough:
                    self._watch_print(child)
        happened, self._events = self._events, []
        return happened

    def take_hosts(self, hosts: Collection[str]) -> Collection[str]:  # noqa: ARG002
        return ()

    def leave_hosts(self, hosts: Collection[str]) -> None:
        """Do nothing: the only host is this computer."""

    def remember(self, label: str, host: str | None, failures: Failures | None) -> None:
        """Do nothing: all units end with this process."""

    def start(
        self,
        unit: str,
        transformation: Transformation,
        state: bytes | None,
        host: str | None,  # noqa: ARG002
        spare: str | None = None,
    ) -> None:
        self.start_unit(unit_order(unit, transformation, state), spare)

    def start_unit(self, order: messages.UnitOrder, spare: str | None = None) -> None:
        """Start a unit with this computer's code and clock; see `Backend.start`."""
        prepared = None if spare is None else self._spares.get(spare)
        if spare is None or prepared is None or prepared.changed_file() is not None:
            self.discard(spare or "")
            self._fork(order.unit, self._here(order))
            return
        del self._spares[spare]
        prepared.name, prepared.is_spare, prepared.trouble = order.unit, False, ""
        self._by_name[order.unit] = prepared
        self._events.append(events.SpareUsed(order.unit, spare))
        self._tell(prepared, messages.BeginUnit(order.unit, order.state))

    def prepare(self, spare: str, transformation: Transformation, host: str | None) -> None:  # noqa: ARG002
        self.prepare_unit(unit_order(spare, transformation, None))

    def prepare_unit(self, order: messages.UnitOrder) -> None:
        """Prepare a spare with this computer's code and clock; see `Backend.prepare`."""
        self.discard(order.unit)
        child = self._fork(order.unit, messages.SpareOrder(self._here(order)))
        place = code_file(order.source, self.code_folder)
        changed = changed_ns(place)
        if child is not None:
            child.due_s = self.now() + PREPARE_S
            child.changed_ns = {} if changed is None else {str(place): changed}

    def discard(self, spare: str) -> None:
        child = self._spares.pop(spare, None)
        if child is not None:
            self._nursery.kill(child.serial)

    def correct_clock(self, ahead_ns: int) -> None:
        """From now on subtract `ahead_ns` from this computer's clock for elements' times."""
        self._ahead_ns = ahead_ns
        self.run_folder.tell_clock(self.clock_offset_ns - ahead_ns)
        for child in self._children.values():
            if child.name != RELAY:
                self._tell(child, messages.SetClock(self.clock_offset_ns - ahead_ns))

    def open_relay(self) -> socket.socket:
        """The relay's end of its connection: wires from and to RELAY go there. Raises OSError."""
        ours, theirs = socket.socketpair()
        relay = ChildProcess(_NO_PROCESS, RELAY, ControlConnection(ours, messages.FromChild), PrintedLines(ours))
        self._children[_NO_PROCESS] = self._by_name[RELAY] = relay
        self._ends.watch(ours, lambda: self._hear(relay))
        return theirs

    def warm_up(self) -> None:
        """Start the nursery now, so that later starts of units are fast. Raises OSError."""
        if not self._nursery.is_open:
            self._nursery_socket = self._nursery.open()
            self._ends.watch(self._nursery_socket, self._hear_nursery)
            self._events.append(events.HelperAlive(NURSERY_HELPER, _HELPER_START_S))

    def tell_relay(self, message: messages.ToRelay) -> None:
        """Send a message to the relay."""
        self._tell(self._by_name[RELAY], message)

    def heard_from_relay(self) -> list[messages.FromRelay]:
        """The relay's messages since the last call."""
        heard, self._from_relay = self._from_relay, []
        return heard

    def stop(self, unit: str) -> None:
        child = self._by_name.get(unit)
        if child is not None and child.is_stopping:
            self._nursery.interrupt(child.serial)
        elif child is not None:
            child.is_stopping = True
            self._tell(child, messages.Finish())

    def kill(self, unit: str, *, dump: bool = False) -> None:
        child = self._by_name.get(unit)
        if child is not None:
            self._nursery.kill(child.serial, dump=dump)

    def activate(self, unit: str) -> bool:
        self._tell_unit(unit, messages.Activate())
        return False

    def deactivate(self, unit: str) -> None:
        self._tell_unit(unit, messages.Deactivate())

    def hold(self, unit: str) -> None:
        self._tell_unit(unit, messages.HoldSteps())

    def ask_places(self, unit: str, inlets: Mapping[str, bool]) -> None:
        self._tell_unit(unit, messages.TellPlaces(dict(inlets)))

    def ask_state(self, unit: str, until: Mapping[str, Moment], successor: str) -> None:  # noqa: ARG002
        self._tell_unit(unit, messages.TellState(dict(until)))

    def give_state(
        self, unit: str, state: bytes | None, inputs: Mapping[str, messages.GivenInput], outputs: Mapping[str, Moment]
    ) -> None:
        self._tell_unit(unit, messages.TakeState(state, dict(inputs), dict(outputs)))

    def _tell_unit(self, unit: str, message: messages.ToChild) -> None:
        child = self._by_name.get(unit)
        if child is not None:
            self._tell(child, message)

    def connect(self, wire: int, stream: Stream, inlet: Inlet, *, queue: int, blocks: bool) -> None:
        if inlet.is_outlet and inlet.port in self._unopened and OUTLETS in self._by_name:
            self._open(self._by_name[OUTLETS], inlet.port)
        try:
            sender, receiver = socket_pair()
        except OSError as error:
            self._events.append(events.InputLost(inlet.unit or None, inlet.port, wire))
            self._run_short(f"{stream} can't be connected to {inlet}", error)
            return
        self._is_short = bool(self._unopened)
        producer, consumer = self._by_name.get(stream.unit), self._by_name.get(inlet.unit)
        if consumer is None:
            receiver.close()
        else:
            self._tell(consumer, messages.Feed(inlet.port, wire), [receiver])
        if producer is None:
            sender.close()
        else:
            self._tell(producer, messages.Serve(stream.port, wire, queue, blocks), [sender])

    def disconnect(self, wire: int, inlet: Inlet) -> None:
        child = self._by_name.get(inlet.unit)
        if child is not None:
            self._tell(child, messages.Cut(inlet.port, wire))

    def end_wire(self, wire: int, stream: Stream, inlet: Inlet) -> None:
        producer, consumer = self._by_name.get(stream.unit), self._by_name.get(inlet.unit)
        if consumer is not None:
            self._tell(consumer, messages.End(inlet.port, wire))
        if producer is not None:
            self._tell(producer, messages.Unserve(stream.port, wire))

    def switch_now(self, inlet: Inlet) -> None:
        child = self._by_name.get(inlet.unit)
        if child is not None:
            self._tell(child, messages.SwitchNow(inlet.port))

    def open_outlet(self, topic: str, host: str | None) -> None:  # noqa: ARG002
        self._topics.append(topic)
        if OUTLETS in self._by_name:
            self._open(self._by_name[OUTLETS], topic)
        elif self._outlets_due_s is None:
            self._start_outlets()

    def close_outlet(self, topic: str) -> None:
        self._topics.remove(topic)
        self._unopened.discard(topic)
        self.run_folder.forget(topic)
        if OUTLETS in self._by_name:
            self._tell(self._by_name[OUTLETS], messages.CloseOutlet(topic))

    def renew(self, helper: str) -> None:
        if helper == NURSERY_HELPER:
            self._nursery.end()
        else:
            self.kill(OUTLETS)

    def usage(self, unit: str) -> Usage | None:
        child = self._by_name.get(unit) or self._spares.get(unit)
        used = None if child is None else child.usage()
        return None if child is None or used is None else Usage(*used, child.pid)

    def pid(self, unit: str) -> int | None:
        child = self._by_name.get(unit)
        return None if child is None else child.pid

    def close(self) -> None:
        self._nursery.close()
        for child in list(self._children.values()):
            self._forget(child)
        self._ends.close()
        self._waker.close()
        self.run_folder.close()
        if self._cpu is not None:
            self._cpu.close()

    def _start_outlets(self) -> None:
        self._outlets_due_s, self._outlets_since_s = None, self.now()
        order = messages.OutletOrder(str(self.run_folder.path), _OUTLET_QUEUE, self.clock_offset_ns - self._ahead_ns)
        child = self._fork(OUTLETS, order)
        if child is not None:
            self._events.append(events.HelperAlive(OUTLETS_HELPER, _HELPER_START_S))
            if self._outlets_lost:
                self._events.append(events.OutletsOpened())
            for topic in self._topics:
                self._open(child, topic)

    def _open(self, outlets: ChildProcess, topic: str) -> None:
        try:
            self._tell(outlets, messages.OpenOutlet(topic), [self.run_folder.listen(topic)])
            self._unopened.discard(topic)
        except OSError as error:
            self._unopened.add(topic)
            self._run_short(f"topic {topic} can't be opened", error)

    def _run_short(self, what: str, error: OSError) -> None:
        if not self._is_short:
            self._is_short = True
            mend = "; raise the limit of open files (ulimit -n)" if error.errno in _NO_DESCRIPTOR else ""
            self._events.append(events.OutOfDescriptors(f"{what}: {error.strerror}{mend}"))

    def _lose_outlets(self, cause: str) -> None:
        """Report that the outlets were lost. The first replacement is immediate; after losses in a row it
        waits longer.
        """
        lived_well = self.now() - self._outlets_since_s >= _GOOD_LIFE_S
        self._outlets_lost = 1 if lived_well else self._outlets_lost + 1
        self._events += [events.HelperAlive(OUTLETS_HELPER, inf), events.OutletsLost(cause)]
        if self._topics:
            self._outlets_due_s = self.now() + doubling_s(self._outlets_lost, _AGAIN_S, _MOST_AGAIN_S)

    def _fork(self, name: str, order: messages.ChildOrder) -> ChildProcess | None:
        """Start a child. If the system has no room, report the child as dead and return None."""
        ends: list[socket.socket] = []
        try:
            self.warm_up()
            ends += socket.socketpair()
            ends += socket.socketpair()
        except OSError as error:
            for end in ends:
                end.close()
            cause = f"no process can be made: {error.strerror}"
            if isinstance(order, messages.SpareOrder):
                self._events.append(events.SpareLost(name, cause))
            else:
                self._tell_end(name, cause, "could not start", was_asked=False)
            return None
        self._serial += 1
        ours, theirs, printed, printing = ends
        child = ChildProcess(self._serial, name, ControlConnection(ours, messages.FromChild), PrintedLines(printed))
        child.is_spare = isinstance(order, messages.SpareOrder)
        of_unit = order.order if isinstance(order, messages.SpareOrder) else order
        child.is_program = isinstance(of_unit, messages.UnitOrder) and names_program(of_unit.source)
        self._children[child.serial] = (self._spares if child.is_spare else self._by_name)[name] = child
        self._ends.watch(ours, lambda: self._hear(child))
        self._watch_print(child)
        self._nursery.fork(child.serial, order, [theirs, printing])
        return child

    def _hear_nursery(self) -> None:
        self._events.append(events.HelperAlive(NURSERY_HELPER, HELPER_S))
        for message in self._nursery.hear():
            child = None if isinstance(message, messages.Alive) else self._children.get(message.serial)
            match message:
                case messages.Forked(_, pid) if child is not None:
                    child.pid = pid
                    if self._cpu is not None and child.name != OUTLETS:
                        self._cpu.take(pid)
                    self._tell_ready(child)
                case messages.Gone(_, status) if child is not None:
                    self._remove_dead(child, status)
                case messages.NotForked(_, cause) if child is not None:
                    child.trouble, child.how = cause, "could not start"
                    self._remove_dead(child, 0)
        if self._nursery.has_died:
            self._lose_nursery()

    def _lose_nursery(self) -> None:
        assert self._nursery_socket is not None
        self._ends.unwatch(self._nursery_socket)
        self._nursery.close()
        self._events.append(events.HelperAlive(NURSERY_HELPER, inf))
        for child in [child for child in self._children.values() if child.serial != _NO_PROCESS]:
            if child.pid is not None:
                kill_group(child.pid)  # the child is dead, but what it has started may live
            child.trouble = child.trouble or "killed, since the process that starts units has died"
            self._remove_dead(child, 0)

    def _remove_dead(self, child: ChildProcess, status: int) -> None:
        """Read the last messages of a dead child, then report its death."""
        for message, _ in child.control.receive():
            self._understand(child, message)
        self._events.extend(events.UnitPrinted(child.name, line) for line in child.printed.rest())
        is_wanted = self._spares.get(child.name) is child
        self._forget(child)
        cause = cause_of_end(child, status)
        if not child.is_spare:
            self._tell_end(child.name, cause, child.how, was_asked=child.is_stopping)
        elif is_wanted:
            self._events.append(events.SpareLost(child.name, cause))

    def _tell_end(self, name: str, cause: str, how: events.End, *, was_asked: bool) -> None:
        if name == OUTLETS:
            self._lose_outlets(cause)
        else:
            self._events.append(events.UnitStopped(name) if was_asked else events.UnitDied(name, cause, how))

    def _forget(self, child: ChildProcess) -> None:
        self._children.pop(child.serial, None)
        names = self._spares if child.is_spare else self._by_name
        if names.get(child.name) is child:
            del names[child.name]
        for end in (child.control.socket, child.printed.socket):
            self._ends.unwatch(end)
        child.control.close()
        child.printed.socket.close()

    def _hear(self, child: ChildProcess) -> None:
        child.control.flush()
        for message, _ in child.control.receive():
            self._understand(child, message)
        if child.control.has_ended:
            # The nursery reports how the child ended; if only the connection has, the nursery kills the child.
            self._ends.unwatch(child.control.socket)
            self._nursery.kill(child.serial)
        else:
            self._ends.write(child.control.socket, is_waiting=child.control.is_waiting)

    def _watch_print(self, child: ChildProcess) -> None:
        self._ends.watch(child.printed.socket, lambda: self._hear_print(child))

    def _hear_print(self, child: ChildProcess) -> None:
        lines, is_open = child.printed.read()
        self._events.extend(events.UnitPrinted(child.name, line) for line in lines)
        child.is_printing = is_open
        if not is_open or child.printed.is_enough:
            self._ends.unwatch(child.printed.socket)

    def _understand(self, child: ChildProcess, message: messages.FromChild) -> None:
        name = child.name
        match message:
            case messages.Ready(cpu_ns):
                child.labor_us = cpu_ns // 1000
                self._tell_ready(child)
            case messages.Prepared(cpu_ns, changed):
                # A file may have changed after it was read: the time from before that wins.
                child.due_s, child.changed_ns = inf, changed | child.changed_ns
                if self._spares.get(name) is child:
                    self._events.append(events.SparePrepared(name, cpu_ns // 1000))
            case messages.Switched(_, wire):
                self._events.append(events.WireSwitched(wire))
            case messages.Lost(port, wire):
                self._events.append(events.InputLost(name or None, port, wire))
            case messages.Trouble("exited" | "failed", step, text):
                child.trouble = f"{text.strip()} (in step {step})" if step else text.strip()
                child.how = "could not start" if child.labor_us is None else "died"
            case messages.Trouble(kind, step, text, suppressed):
                self._events.append(events.UnitFailed(name, kind, step, text, suppressed))
            case messages.Exhausted():
                self._events.append(events.SourceExhausted(name))
            case messages.Flowing(flows):
                self._events += [events.HelperAlive(OUTLETS_HELPER, HELPER_S), events.TopicsStatus(flows)]
            case messages.ImportUnused() | messages.Marked():
                self._from_relay.append(message)
            case messages.Unserved(topic, cause):
                self._events.append(events.OutOfDescriptors(f"subscribers of {topic} wait: {cause}"))
            case messages.Places(moments):
                self._events.append(events.PlacesTold(name, moments))
            case messages.StateTold(state, inputs, outputs):
                self._events.append(events.StateTold(name, state, inputs, outputs))
            case messages.UnitSign(steps, errors, inputs, outputs, state, qualities):
                child.steps = steps
                self._events.append(events.UnitStatus(name, steps, errors, inputs, outputs, state, qualities))

    def _tell_ready(self, child: ChildProcess) -> None:
        """Report a unit as ready once its message and its process id have come, in either order."""
        if child.name != OUTLETS and child.pid is not None and child.labor_us is not None:
            self._events.append(events.UnitReady(child.name, child.labor_us))

    def _here(self, order: messages.UnitOrder) -> messages.UnitOrder:
        """An order with this computer's code folder and clock."""
        offset_ns = self.clock_offset_ns - self._ahead_ns
        return msgspec.structs.replace(order, folder=self._code_folder, clock_offset_ns=offset_ns)

    def _watch_spares(self) -> None:
        """End the spares whose code has changed, and those that hang, once they have printed where."""
        for child in self._spares.values():
            changed, hangs = child.changed_file(), child.due_s <= self.now()
            if changed is not None:
                child.trouble = f"{changed} has changed since it was prepared"
            elif hangs and not child.trouble:
                child.trouble = f"was not prepared within {PREPARE_S:g} s"
                self._nursery.kill(child.serial, dump=True)
                continue
            if changed is not None or hangs:
                self._nursery.kill(child.serial)

    def _tell(self, child: ChildProcess, message: object, sockets: Sequence[socket.socket] = ()) -> None:
        child.control.send(message, sockets)  # type: ignore[arg-type]
        if not child.control.has_ended:
            self._ends.write(child.control.socket, is_waiting=child.control.is_waiting)


def _raise_descriptor_limit() -> None:
    """Let this process and its children open as many files as the system allows: a unit takes several."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft != hard:
        with suppress(OSError, ValueError):  # where "no limit" is more than the system really allows
            resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
