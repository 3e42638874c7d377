"""The taps of ROS nodes: topics in the run's folder, on which observers see messages that the relay passes on."""

from __future__ import annotations

import socket
from contextlib import suppress

from cfgplan_runtime.errors import EncodingError
from cfgplan_runtime.streams.channel import Sender, widen
from cfgplan_runtime.streams.element import Outgoing
from cfgplan_runtime.streams.ends import Ends
from cfgplan_runtime.streams.payload import PayloadEncoder
from cfgplan_runtime.streams.run_folder import RunFolder

_QUEUE = 4
"""The most messages that wait for a slow observer."""


class ShownTaps:
    """The topics of open taps, and their observers. A slow observer loses the oldest messages."""

    def __init__(self, ends: Ends, run_folder: RunFolder) -> None:
        self._ends, self._run_folder = ends, run_folder
        self._listeners: dict[str, socket.socket] = {}
        self._observers: dict[str, list[Sender]] = {}
        self._encoder = PayloadEncoder()

    def open(self, topic: str) -> None:
        """Open a tap's topic. Raises OSError."""
        listener = self._listeners[topic] = self._run_folder.listen(topic)
        listener.setblocking(False)
        self._observers[topic] = []
        self._ends.watch(listener, lambda: self._accept(topic, listener))

    def close(self, topic: str) -> None:
        """Remove a tap's topic, if it is open."""
        listener = self._listeners.pop(topic, None)
        if listener is None:
            return
        self._run_folder.forget(topic)
        self._ends.unwatch(listener)
        listener.close()
        for observer in self._observers[topic]:
            self._leave(topic, observer)
        del self._observers[topic]

    def close_all(self) -> None:
        """Remove the topics of all taps."""
        for topic in list(self._listeners):
            self.close(topic)

    def show(self, topic: str, time_ns: int, value: object, skipped: int) -> None:
        """Send a value to the observers of a tap, with the time of its message in nanoseconds since 1970.

        `skipped` messages before it were not passed on.
        """
        try:
            parts = self._encoder.encode(value)
        except EncodingError as error:
            parts = self._encoder.encode(str(error))
        for observer in list(self._observers.get(topic, ())):
            observer.skip(skipped)
            observer.offer(Outgoing(time_ns, 0, list(parts)))
            self._look_at(topic, observer)

    def _accept(self, topic: str, listener: socket.socket) -> None:
        with suppress(OSError):  # none waits any more, or no descriptor is left: the observer tries again
            end, _ = listener.accept()
            widen(end)
            observer = Sender(end, queue=_QUEUE, blocks=False)
            self._observers[topic].append(observer)
            self._ends.watch(end, lambda: self._hear(topic, observer))

    def _hear(self, topic: str, observer: Sender) -> None:
        """An observer has gone, or can take more."""
        observer.attend()
        self._look_at(topic, observer)

    def _look_at(self, topic: str, observer: Sender) -> None:
        if observer.is_closed:
            self._leave(topic, observer)
        else:
            self._ends.write(observer.socket, is_waiting=observer.depth > 0)

    def _leave(self, topic: str, observer: Sender) -> None:
        self._observers[topic] = [other for other in self._observers[topic] if other is not observer]
        self._ends.unwatch(observer.socket)
        observer.give_up()
        observer.socket.close()
