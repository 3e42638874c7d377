"""The process that owns the topics' addresses: it sends the elements of each topic to all connected subscribers."""

from __future__ import annotations

import socket
import time

from cfgplan_runtime.children import messages
from cfgplan_runtime.children.control import ControlConnection
from cfgplan_runtime.children.ports import Ports, UnitInput, UnitOutput
from cfgplan_runtime.streams.channel import Sender, widen
from cfgplan_runtime.streams.element import Element, Outgoing
from cfgplan_runtime.streams.inlet import InputQueue
from cfgplan_runtime.streams.meter import Meter

_STATUS_PERIOD_S = 1.0
NO_DESCRIPTOR = "no file descriptor is left: raise the limit of open files (ulimit -n)"


class OutletChild:
    """The outlets of one run. A slow consumer loses the oldest elements, and delays no other."""

    def __init__(self, order: messages.OutletOrder, control: ControlConnection[messages.ToChild]) -> None:
        self._queue = order.queue
        self._ports = Ports(control, self._obey, clock_offset_ns=order.clock_offset_ns)
        self._listeners: dict[str, socket.socket] = {}
        self._meters: dict[str, Meter] = {}
        self._paused: dict[str, socket.socket] = {}
        """Listeners without accepts for lack of a descriptor, by topic: new subscribers wait."""
        self._is_short = False
        self._is_finishing = False

    def run(self) -> None:
        """Relay until told to finish, or until the supervisor is gone."""
        self._ports.say(messages.Ready(time.process_time_ns()))
        due = time.monotonic()
        while not self._ports.has_ended and not self._is_finishing:
            self._ports.ends.wait(max(0.0, due - time.monotonic()))
            if time.monotonic() >= due:
                due = time.monotonic() + _STATUS_PERIOD_S
                self._ports.say(messages.Flowing(self._flows()))
                self._accept_again()

    def _flows(self) -> dict[str, messages.Flow]:
        now_s, taken, given = time.monotonic(), self._ports.input_counts(), self._ports.output_counts()
        return {
            topic: messages.Flow(**meter.figures(taken[topic].dropped + given[topic].dropped, now_s))
            for topic, meter in self._meters.items()
        }

    def _obey(self, message: messages.ToChild, sockets: list[socket.socket]) -> None:
        match message:
            case messages.OpenOutlet(topic) if sockets:
                self._open(topic, sockets[0])
            case messages.OpenOutlet(topic):
                self._run_short(topic)
            case messages.CloseOutlet(topic) if topic in self._listeners:
                self._ports.ends.unwatch(self._listeners[topic])
                self._paused.pop(topic, None)
                self._listeners.pop(topic).close()
                self._ports.close_input(topic)
                self._ports.close_output(topic)
                del self._meters[topic]
            case messages.Finish():
                self._is_finishing = True

    def _open(self, topic: str, listener: socket.socket) -> None:
        listener.setblocking(False)
        self._listeners[topic] = listener
        meter = self._meters[topic] = Meter(time.monotonic())

        def relay(element: Element) -> None:
            meter.note((self._ports.now_ns() - element.time_ns) / 1e9, time.monotonic())
            self._ports.emit(topic, Outgoing(element.time_ns, element.turn, [element.payload]))

        self._ports.outputs[topic] = UnitOutput()
        self._ports.inputs[topic] = UnitInput(topic, InputQueue(self._queue), relay, lambda: True)
        self._watch(topic, listener)

    def _watch(self, topic: str, listener: socket.socket) -> None:
        self._ports.ends.watch(listener, lambda: self._accept(topic, listener))

    def _accept(self, topic: str, listener: socket.socket) -> None:
        try:
            consumer, _ = listener.accept()
        except BlockingIOError:
            return
        except OSError:
            self._ports.ends.unwatch(listener)
            self._paused[topic] = listener
            self._run_short(topic)
            return
        self._is_short = False
        widen(consumer)
        self._ports.add_sender(topic, Sender(consumer, queue=self._queue, blocks=False))

    def _run_short(self, topic: str) -> None:
        if not self._is_short:
            self._is_short = True
            self._ports.say(messages.Unserved(topic, NO_DESCRIPTOR))

    def _accept_again(self) -> None:
        paused, self._paused = self._paused, {}
        for topic, listener in paused.items():
            self._watch(topic, listener)
