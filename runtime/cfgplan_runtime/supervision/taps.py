"""Taps: temporary topics that show a stream of a unit to observers. No unit waits for them, no update counts them."""

from __future__ import annotations

from collections.abc import Callable

from cfgplan.domain import Stream
from cfgplan_runtime.supervision.backend import Backend, Inlet
from cfgplan_runtime.supervision.wiring import OUTLET_QUEUE

TAPS = "/cfgplan/taps/"
"""The beginning of the topic of each tap; the stream follows."""


class Taps:
    """The taps of a run. `fresh_id` gives an id that no wire has."""

    def __init__(self, backend: Backend, fresh_id: Callable[[], int]) -> None:
        self._backend = backend
        self._fresh_id = fresh_id
        self._wires: dict[str, tuple[int, Stream]] = {}
        """The wire of each open tap, by topic."""
        self._lost: set[int] = set()
        """The wires whose unit or outlet is gone."""

    def open(self, stream: Stream) -> str:
        """Show a stream on a topic, and return the topic. A tap that lost its unit is connected to the next one."""
        topic = f"{TAPS}{stream}"
        if topic not in self._wires:
            self._backend.open_outlet(topic, None)
        elif self._wires[topic][0] not in self._lost:
            return topic
        else:
            self._end(topic)
        self._wires[topic] = wire, _ = self._fresh_id(), stream
        self._backend.connect(wire, stream, Inlet("", topic), queue=OUTLET_QUEUE, blocks=False)
        return topic

    def close(self, stream: Stream) -> None:
        """Remove the topic of a stream's tap, if there is one."""
        topic = f"{TAPS}{stream}"
        if topic in self._wires:
            self._end(topic)
            del self._wires[topic]
            self._backend.close_outlet(topic)

    def note_loss(self, wire: int) -> None:
        """Note that a wire has lost its unit, if it is that of a tap."""
        if any(wire == known for known, _ in self._wires.values()):
            self._lost.add(wire)

    def note_new_outlets(self) -> None:
        """Connect all taps again, after the backend has replaced the addresses of the topics."""
        for wire, stream in list(self._wires.values()):
            self._lost.add(wire)
            self.open(stream)

    def _end(self, topic: str) -> None:
        wire, stream = self._wires[topic]
        self._lost.discard(wire)
        self._backend.end_wire(wire, stream, Inlet("", topic))
