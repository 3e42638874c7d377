"""The process that owns the topics' addresses: relays what feeds a topic to whoever has connected to it."""

from __future__ import annotations

import socket
import time

from cfgplan_runtime.children.control import ControlConnection
from cfgplan_runtime.children.messages import CloseOutlet, Finish, OpenOutlet, OutletOrder, Ready, Status, ToChild
from cfgplan_runtime.children.ports import InputPort, OutputPort, Ports
from cfgplan_runtime.streams.channel import Sender, widen
from cfgplan_runtime.streams.element import Element, Outgoing
from cfgplan_runtime.streams.inlet import Inlet

_STATUS_PERIOD_S = 1.0


class OutletChild:
    """The outlets of one run. A consumer that is slow loses the oldest elements, and delays nobody."""

    def __init__(self, order: OutletOrder, control: ControlConnection[ToChild]) -> None:
        self._queue = order.queue
        self._ports = Ports(control, self._obey)
        self._listeners: dict[str, socket.socket] = {}
        self._is_finishing = False

    def run(self) -> None:
        """Relay until told to finish, or until the supervisor is gone."""
        self._ports.say(Ready(time.process_time_ns()))
        due = time.monotonic()
        while not self._ports.has_ended and not self._is_finishing:
            self._ports.wait(max(0.0, due - time.monotonic()))
            if time.monotonic() >= due:
                due = time.monotonic() + _STATUS_PERIOD_S
                self._ports.say(Status(0, 0, self._ports.input_counts(), self._ports.output_counts()))

    def _obey(self, message: ToChild, sockets: list[socket.socket]) -> None:
        match message:
            case OpenOutlet(topic):
                self._open(topic, sockets[0])
            case CloseOutlet(topic):
                self._ports.unwatch(self._listeners[topic])
                self._listeners.pop(topic).close()
                self._ports.close_input(topic)
                self._ports.close_output(topic)
            case Finish():
                self._is_finishing = True

    def _open(self, topic: str, listener: socket.socket) -> None:
        listener.setblocking(False)
        self._listeners[topic] = listener

        def relay(element: Element) -> None:
            self._ports.emit(topic, Outgoing(element.time_ns, element.turn, [element.payload]))

        self._ports.outputs[topic] = OutputPort()
        self._ports.inputs[topic] = InputPort(topic, Inlet(self._queue), relay, lambda: True)
        self._ports.watch(listener, lambda: self._accept(topic, listener))

    def _accept(self, topic: str, listener: socket.socket) -> None:
        try:
            consumer, _ = listener.accept()
        except OSError:
            return
        widen(consumer)
        self._ports.add_sender(topic, Sender(consumer, queue=self._queue, blocks=False))
