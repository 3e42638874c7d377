"""Units as processes of this machine, made by a nursery and connected by socket pairs."""

from __future__ import annotations

import selectors
import socket
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from cfgplan.domain import Stream, Transformation
from cfgplan_runtime.children.control import ControlConnection
from cfgplan_runtime.children.messages import (
    CloseOutlet,
    Cut,
    Exhausted,
    Feed,
    Finish,
    Forked,
    FromChild,
    Lost,
    OpenOutlet,
    OutletOrder,
    Ready,
    Serve,
    Status,
    Switched,
    SwitchNow,
    Trouble,
    UnitOrder,
)
from cfgplan_runtime.children.unit_order import unit_order
from cfgplan_runtime.processes.child_process import ChildProcess, cause_of_end
from cfgplan_runtime.processes.cpu_clock import cpu_us, memory_bytes
from cfgplan_runtime.processes.nursery_link import NurseryLink
from cfgplan_runtime.streams.channel import socket_pair
from cfgplan_runtime.streams.run_folder import RunFolder
from cfgplan_runtime.supervision.backend import Inlet, Usage
from cfgplan_runtime.supervision.events import (
    Event,
    InputLost,
    OutletsLost,
    SourceExhausted,
    UnitDied,
    UnitFailed,
    UnitPrinted,
    UnitReady,
    UnitStatus,
    UnitStopped,
    WireSwitched,
)

OUTLETS = ""
_OUTLET_QUEUE = 1024


class ProcessBackend:
    """A backend of processes. All its methods are called from one thread, which must outlive it."""

    def __init__(self, *, folder: Path | None = None, preload: Sequence[str] = (), base: Path | None = None) -> None:
        self.run_folder = RunFolder(base)
        self._code_folder = str((folder or Path.cwd()).resolve())
        self._selector = selectors.DefaultSelector()
        self._bell, self._bell_rope = socket.socketpair()
        for bell in (self._bell, self._bell_rope):
            bell.setblocking(False)
        self._selector.register(self._bell, selectors.EVENT_READ, self._hear_bell)
        self._events: list[Event] = []
        self._children: dict[int, ChildProcess] = {}
        self._by_name: dict[str, ChildProcess] = {}
        self._topics: list[str] = []
        self._serial = 0
        self._clock_offset_ns = time.time_ns() - time.monotonic_ns()
        self._nursery = NurseryLink(("numpy", "numpy.random", *preload))
        self._nursery_socket: socket.socket | None = None

    def now(self) -> float:
        return time.monotonic()

    def wake(self) -> None:
        """Let `wait` return; the one method for other threads."""
        with suppress(OSError):
            self._bell_rope.send(b"!")

    def wait(self, timeout_s: float | None) -> Sequence[Event]:
        if self._events:
            timeout_s = 0.0
        for key, _ in self._selector.select(timeout_s):
            if key.fileobj.fileno() != -1:  # type: ignore[union-attr]
                key.data()
        events, self._events = self._events, []
        return events

    def start(self, unit: str, transformation: Transformation, state: bytes | None) -> None:
        order = unit_order(unit, transformation, state, self._code_folder, self._clock_offset_ns)
        self._fork(unit, order)

    def stop(self, unit: str) -> None:
        child = self._by_name.get(unit)
        if child is not None:
            child.is_stopping = True
            self._tell(child, Finish())

    def kill(self, unit: str, *, dump: bool = False) -> None:
        child = self._by_name.get(unit)
        if child is not None:
            self._nursery.kill(child.serial, dump=dump)

    def connect(self, wire: int, stream: Stream, inlet: Inlet, *, queue: int, blocks: bool) -> None:
        sender, receiver = socket_pair()
        producer, consumer = self._by_name.get(stream.unit), self._by_name.get(inlet.unit)
        if consumer is None:
            receiver.close()
        else:
            self._tell(consumer, Feed(inlet.port, wire), [receiver])
        if producer is None:
            sender.close()
        else:
            self._tell(producer, Serve(stream.port, wire, queue, blocks), [sender])

    def disconnect(self, wire: int, inlet: Inlet) -> None:
        child = self._by_name.get(inlet.unit)
        if child is not None:
            self._tell(child, Cut(inlet.port, wire))

    def switch_now(self, inlet: Inlet) -> None:
        child = self._by_name.get(inlet.unit)
        if child is not None:
            self._tell(child, SwitchNow(inlet.port))

    def open_outlet(self, topic: str) -> None:
        self._topics.append(topic)
        if OUTLETS in self._by_name:
            self._tell(self._by_name[OUTLETS], OpenOutlet(topic), [self.run_folder.listen(topic)])
        else:
            self._start_outlets()

    def close_outlet(self, topic: str) -> None:
        self._topics.remove(topic)
        self.run_folder.forget(topic)
        if OUTLETS in self._by_name:
            self._tell(self._by_name[OUTLETS], CloseOutlet(topic))

    def usage(self, unit: str) -> Usage | None:
        child = self._by_name.get(unit)
        if child is None or child.pid is None:
            return None
        cpu, memory = cpu_us(child.pid), memory_bytes(child.pid)
        return None if cpu is None or memory is None else Usage(cpu, memory)

    def pid(self, unit: str) -> int | None:
        """The process id of a unit."""
        child = self._by_name.get(unit)
        return None if child is None else child.pid

    def close(self) -> None:
        self._nursery.close()
        for child in list(self._children.values()):
            self._forget(child)
        self._selector.close()
        for bell in (self._bell, self._bell_rope):
            bell.close()
        self.run_folder.close()

    def _start_outlets(self) -> None:
        child = self._fork(OUTLETS, OutletOrder(str(self.run_folder.path), _OUTLET_QUEUE))
        for topic in self._topics:
            self._tell(child, OpenOutlet(topic), [self.run_folder.listen(topic)])

    def _fork(self, name: str, order: UnitOrder | OutletOrder) -> ChildProcess:
        if not self._nursery.is_open:
            self._nursery_socket = self._nursery.open()
            self._selector.register(self._nursery_socket, selectors.EVENT_READ, self._hear_nursery)
        self._serial += 1
        ours, theirs = socket.socketpair()
        printed, printing = socket.socketpair()
        printed.setblocking(False)
        child = ChildProcess(self._serial, name, ControlConnection(ours, FromChild), printed)
        self._children[child.serial] = self._by_name[name] = child
        self._selector.register(ours, selectors.EVENT_READ, lambda: self._hear(child))
        self._selector.register(printed, selectors.EVENT_READ, lambda: self._hear_print(child))
        self._nursery.fork(child.serial, order, [theirs, printing])
        return child

    def _hear_bell(self) -> None:
        with suppress(BlockingIOError):
            self._bell.recv(4096)

    def _hear_nursery(self) -> None:
        for message in self._nursery.hear():
            child = self._children.get(message.serial)
            if child is None:
                continue
            if isinstance(message, Forked):
                child.pid = message.pid
            else:
                self._bury(child, message.status)
        if self._nursery.has_died:
            self._lose_nursery()

    def _lose_nursery(self) -> None:
        assert self._nursery_socket is not None
        self._selector.unregister(self._nursery_socket)
        self._nursery.close()
        for child in list(self._children.values()):
            child.trouble = child.trouble or "killed together with the nursery"
            self._bury(child, 0)

    def _bury(self, child: ChildProcess, status: int) -> None:
        """Hear a dead child's last words, then say that it is gone."""
        for message, _ in child.control.receive():
            self._understand(child, message)
        while self._hear_print(child):
            pass
        self._forget(child)
        cause = cause_of_end(child, status)
        if child.name == OUTLETS:
            self._events.append(OutletsLost(cause))
            if self._topics and self._nursery.works:
                self._start_outlets()
        elif child.is_stopping:
            self._events.append(UnitStopped(child.name))
        else:
            self._events.append(UnitDied(child.name, cause))

    def _forget(self, child: ChildProcess) -> None:
        self._children.pop(child.serial, None)
        if self._by_name.get(child.name) is child:
            del self._by_name[child.name]
        for end in (child.control.socket, child.printed):
            with suppress(KeyError, ValueError):
                self._selector.unregister(end)
        child.control.close()
        child.printed.close()

    def _hear(self, child: ChildProcess) -> None:
        child.control.flush()
        for message, _ in child.control.receive():
            self._understand(child, message)
        if child.control.has_ended:
            # The nursery tells how it ended, and ends it if that was only its connection.
            self._selector.unregister(child.control.socket)
            self._nursery.kill(child.serial)
        else:
            self._watch_control(child)

    def _hear_print(self, child: ChildProcess) -> bool:
        lines, is_open = child.printed_lines()
        self._events.extend(UnitPrinted(child.name, line) for line in lines)
        if not is_open:
            with suppress(KeyError, ValueError):
                self._selector.unregister(child.printed)
        return bool(lines) and is_open

    def _understand(self, child: ChildProcess, message: FromChild) -> None:
        name = child.name
        match message:
            case Ready(cpu_ns):
                child.is_ready = True
                if name != OUTLETS:
                    self._events.append(UnitReady(name, cpu_ns // 1000))
            case Switched(_, wire):
                self._events.append(WireSwitched(wire))
            case Lost(port, wire):
                self._events.append(InputLost(name or None, port, wire))
            case Trouble("exited" | "failed", step, text):
                child.trouble = f"{text.strip()} (in step {step})" if step else text.strip()
            case Trouble(kind, step, text, suppressed):
                self._events.append(UnitFailed(name, kind, step, text, suppressed))
            case Exhausted():
                self._events.append(SourceExhausted(name))
            case Status(steps, errors, inputs, outputs, state):
                child.steps = steps
                self._events.append(UnitStatus(name, steps, errors, inputs, outputs, state))

    def _tell(self, child: ChildProcess, message: object, sockets: Sequence[socket.socket] = ()) -> None:
        child.control.send(message, sockets)  # type: ignore[arg-type]
        if not child.control.has_ended:
            self._watch_control(child)

    def _watch_control(self, child: ChildProcess) -> None:
        events = selectors.EVENT_READ | (selectors.EVENT_WRITE if child.control.is_waiting else 0)
        with suppress(KeyError):
            self._selector.modify(child.control.socket, events, lambda: self._hear(child))
