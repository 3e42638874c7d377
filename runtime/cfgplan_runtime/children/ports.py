"""The ports of a child process: inlets and outputs, rewired by control messages."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from cfgplan_runtime.children.control import ControlConnection
from cfgplan_runtime.children.messages import (
    Cut,
    End,
    Feed,
    FromChild,
    Lost,
    PortCounts,
    Serve,
    SetClock,
    Switched,
    SwitchNow,
    ToChild,
    Unserve,
)
from cfgplan_runtime.streams.channel import Receiver, Sender
from cfgplan_runtime.streams.element import BEFORE_ALL, Element, Moment, Outgoing
from cfgplan_runtime.streams.ends import Ends
from cfgplan_runtime.streams.inlet import InputQueue


def _nothing() -> None:
    pass


def _no_input(_: str) -> None:
    pass


@dataclass(slots=True)
class UnitInput:
    """An inlet and the receivers of its wires."""

    name: str
    inlet: InputQueue
    take: Callable[[Element], None]
    """Called with each element that the inlet delivers."""
    has_room: Callable[[], bool]
    """False if the producers have to wait."""
    lose: Callable[[], None] = _nothing
    """Called when it has lost its source."""
    pause: Callable[[], None] = _nothing
    """Called when its source pauses, and no other takes its place."""
    is_still: bool = False
    """Whether its source paused when this was last looked at."""
    receivers: dict[int, Receiver] = field(default_factory=dict)
    announced: int | None = None
    """The active source that was last reported to the supervisor."""
    elements: int = 0
    is_paused: bool = False


@dataclass(slots=True)
class UnitOutput:
    """An output and its subscriptions."""

    senders: list[Sender] = field(default_factory=list)
    elements: int = 0
    dropped_before: int = 0
    served: int = 0
    """The number of subscriptions so far."""
    last: Moment = BEFORE_ALL
    """The moment of the last element."""


class Ports:
    """All ports of this process. The process waits only in `wait`."""

    def __init__(
        self,
        control: ControlConnection[ToChild],
        order: Callable[[ToChild, list[socket.socket]], None],
        make_input: Callable[[str], UnitInput | None] = _no_input,
        clock_offset_ns: int = 0,
    ) -> None:
        """`make_input` makes an input when it is first connected; it returns None for an unknown name.

        The run's clock, on which elements have their times, is the monotonic clock plus `clock_offset_ns`.
        """
        self.inputs: dict[str, UnitInput] = {}
        self.outputs: dict[str, UnitOutput] = {}
        self.has_ended = False
        self._control = control
        self._order = order
        self._make_input = make_input
        self._clock_offset_ns = clock_offset_ns
        self.ends = Ends()
        self.ends.watch(control.socket, self._hear)

    def now_ns(self) -> int:
        """The present time on the run's clock, in nanoseconds."""
        return time.monotonic_ns() + self._clock_offset_ns

    def say(self, message: FromChild) -> None:
        """Send a message to the supervisor."""
        self._control.send(message)
        self.ends.write(self._control.socket, is_waiting=self._control.is_waiting)

    def emit(self, port: str, element: Outgoing) -> None:
        """Send an element to every subscriber of an output."""
        output = self.outputs[port]
        output.elements += 1
        output.last = element.time_ns, element.turn
        for sender in output.senders:
            had_rest = sender.depth
            sender.offer(element)
            if sender.is_closed or (sender.depth and not had_rest):
                self._after_sending(output, sender)

    def pause(self, port: str) -> None:
        """Tell every subscriber of an output that it gives nothing until its next element."""
        output = self.outputs[port]
        for sender in list(output.senders):
            sender.pause()
            self._after_sending(output, sender)

    def skip(self, port: str, count: int) -> None:
        """Let every subscriber of an output see that so many elements were dropped before it."""
        for sender in self.outputs[port].senders:
            sender.skip(count)

    @property
    def must_wait(self) -> bool:
        """Whether a blocking subscriber has no room."""
        return any(map(self.is_full, self.outputs))

    def is_full(self, port: str) -> bool:
        """Whether a blocking subscriber of an output has no room."""
        return any(sender.is_full for sender in self.outputs[port].senders)

    @property
    def is_flushed(self) -> bool:
        return not any(sender.depth for output in self.outputs.values() for sender in output.senders)

    def drain(self) -> None:
        """Deliver the elements that have arrived, then discard later ones."""
        for name, port in self.inputs.items():
            self.take_in(name)
            port.take = _ignore

    def take_in(self, port: str) -> None:
        """Deliver the elements that have arrived at an input."""
        for wire in list(self.inputs[port].receivers):
            self._read(self.inputs[port], wire)

    def add_sender(self, port: str, sender: Sender) -> None:
        output = self.outputs[port]
        output.senders.append(sender)
        output.served += 1
        sender.tell_place(output.last, output.elements)
        self.ends.watch(sender.socket, lambda: self._peer_spoke(output, sender))

    def close_output(self, port: str) -> None:
        for sender in list(self.outputs[port].senders):
            self._remove_sender(self.outputs[port], sender)
        del self.outputs[port]

    def end_output(self, port: str) -> bool:
        """Close the subscriptions of an output to which everything was sent. Returns whether none is left."""
        output = self.outputs[port]
        for sender in [sender for sender in output.senders if not sender.depth]:
            self._remove_sender(output, sender)
        return not output.senders

    def close_input(self, port: str) -> None:
        for receiver in self.inputs.pop(port).receivers.values():
            self._close(receiver)

    def close(self) -> None:
        """Close all sockets but the connection to the supervisor."""
        for name in list(self.inputs):
            self.close_input(name)
        for name in list(self.outputs):
            self.close_output(name)
        self.ends.close()

    def resume(self) -> None:
        """Resume reading from inputs that have room again."""
        for port in self.inputs.values():
            if port.is_paused and port.has_room():
                port.is_paused = False
                for wire in list(port.receivers):
                    self._watch_receiver(port, wire)

    def input_counts(self) -> dict[str, PortCounts]:
        counts: dict[str, PortCounts] = {}
        for name, port in self.inputs.items():
            counts[name] = PortCounts(port.elements, port.inlet.dropped, port.inlet.stale)
        return counts

    def output_counts(self) -> dict[str, PortCounts]:
        counts: dict[str, PortCounts] = {}
        for name, output in self.outputs.items():
            dropped, waiting = output.dropped_before, 0
            for sender in output.senders:
                dropped, waiting = dropped + sender.dropped, max(waiting, sender.depth)
            counts[name] = PortCounts(output.elements, dropped, waiting=waiting)
        return counts

    def _hear(self) -> None:
        if not self._control.flush():
            return
        self.ends.write(self._control.socket, is_waiting=self._control.is_waiting)
        for message, sockets in self._control.receive():
            match message:
                case Feed(port, wire) if not self._has_input(port) or not sockets:  # there was no descriptor left
                    for end in sockets:
                        end.close()
                    self.say(Lost(port, wire))
                case Feed(port, wire):
                    self._feed(port, wire, sockets[0])
                case Serve(port, wire, queue, blocks) if sockets and port in self.outputs:
                    self.add_sender(port, Sender(sockets[0], queue=queue, blocks=blocks, wire=wire))
                case Cut(port, wire) if port in self.inputs:
                    self._cut(port, wire)
                case End(port, wire) if port in self.inputs:
                    self._read(self.inputs[port], wire)
                    self._cut(port, wire)
                case Unserve(port, wire) if port in self.outputs:
                    self._unserve(self.outputs[port], wire)
                case Serve() | Cut() | End() | Unserve():  # no descriptor was left, or a topic or crossing is gone
                    for end in sockets:
                        end.close()
                case SwitchNow(port):
                    self._switch_now(self.inputs[port])
                case SetClock(offset_ns):
                    self._clock_offset_ns = offset_ns
                case _:
                    self._order(message, sockets)
        if self._control.has_ended:
            self.has_ended = True

    def _has_input(self, name: str) -> bool:
        """Whether an input has this name, by now."""
        made = None if name in self.inputs else self._make_input(name)
        if made is not None:
            self.inputs[name] = made
        return name in self.inputs

    def _feed(self, name: str, wire: int, end: socket.socket) -> None:
        port = self.inputs[name]
        port.receivers[wire] = Receiver(end)
        port.inlet.attach(wire)
        if not port.is_paused:
            self._watch_receiver(port, wire)
        self._settle(port, [])

    def _cut(self, name: str, wire: int) -> None:
        port = self.inputs[name]
        self._settle(port, port.inlet.end(wire))
        if port.inlet.active is None:
            port.lose()

    def _unserve(self, output: UnitOutput, wire: int) -> None:
        for sender in [sender for sender in output.senders if sender.wire == wire]:
            self._remove_sender(output, sender)

    def _switch_now(self, port: UnitInput) -> None:
        if port.inlet.standby is not None and port.inlet.active is not None:
            self._read(port, port.inlet.active)
        self._settle(port, port.inlet.switch((self.now_ns(), 0)))

    def _watch_receiver(self, port: UnitInput, wire: int) -> None:
        self.ends.watch(port.receivers[wire].socket, lambda: self._read(port, wire))

    def _read(self, port: UnitInput, wire: int) -> None:
        receiver = port.receivers.get(wire)
        if receiver is None:
            return
        for element in receiver.read():
            self._settle(port, port.inlet.accept(wire, element))
        if receiver.is_paused and wire in port.receivers:
            self._settle(port, port.inlet.pause(wire))
        if receiver.has_ended and wire in port.receivers:
            self._settle(port, port.inlet.end(wire))
            if port.inlet.active is None:
                port.lose()
                self.say(Lost(port.name, wire))
        if not port.is_paused and not port.has_room():
            port.is_paused = True
            for other in port.receivers.values():
                self.ends.unwatch(other.socket)

    def _settle(self, port: UnitInput, elements: list[Element]) -> None:
        """Deliver elements, close the receivers that the inlet no longer needs, and report a switch and a pause."""
        port.elements += len(elements)
        for element in elements:
            port.take(element)
        if len(port.receivers) > len(port.inlet.sources):
            for wire in port.receivers.keys() - port.inlet.sources:
                self._close(port.receivers.pop(wire))
        if port.inlet.active != port.announced:
            port.announced = port.inlet.active
            if port.announced is not None:
                self.say(Switched(port.name, port.announced))
        if port.inlet.is_paused != port.is_still:
            port.is_still = port.inlet.is_paused
            if port.is_still:
                port.pause()

    def _close(self, receiver: Receiver) -> None:
        self.ends.unwatch(receiver.socket)
        receiver.close()

    def _peer_spoke(self, output: UnitOutput, sender: Sender) -> None:
        """A receiver's socket is ready. If the receiver is gone, close the sender."""
        sender.attend()
        self._after_sending(output, sender)

    def _after_sending(self, output: UnitOutput, sender: Sender) -> None:
        if sender.is_closed:
            self._remove_sender(output, sender)
            return
        self.ends.write(sender.socket, is_waiting=sender.depth > 0)

    def _remove_sender(self, output: UnitOutput, sender: Sender) -> None:
        output.dropped_before += sender.dropped
        output.senders = [other for other in output.senders if other is not sender]
        self.ends.unwatch(sender.socket)
        sender.give_up()
        sender.socket.close()


def _ignore(_: Element) -> None:
    """Discard an element that comes after its input was drained."""
