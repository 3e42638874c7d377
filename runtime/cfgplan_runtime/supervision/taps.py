"""Taps: temporary topics that show a stream of a unit to observers. No unit waits for them, no update counts them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from cfgplan.domain import Stream
from cfgplan_runtime.streams.topic_names import TAPS
from cfgplan_runtime.supervision.backend import Backend, Inlet
from cfgplan_runtime.supervision.wiring import OUTLET_QUEUE


@dataclass
class _Tap:
    """An open tap: its stream, the host of its topic, and its present wire."""

    stream: Stream
    host: str | None
    wire: int = 0
    is_lost: bool = True
    """Whether the unit or outlet of its wire is gone."""


class Taps:
    """The taps of a run. `fresh_id` gives an id that no wire has, and `host_of` the host of a running unit."""

    def __init__(self, backend: Backend, fresh_id: Callable[[], int], host_of: Callable[[str], str | None]) -> None:
        self._backend = backend
        self._fresh_id = fresh_id
        self._host_of = host_of
        self._open: dict[str, _Tap] = {}
        """The open taps, by topic."""

    def open(self, stream: Stream) -> str:
        """Show a stream on a topic of its unit's host, and return the topic.

        A tap that lost its unit is connected to the next one.
        """
        topic, host = f"{TAPS}{stream}", self._host_of(stream.unit)
        if topic in self._open and host not in (None, self._open[topic].host):
            self.close(stream)
        tap = self._open.get(topic)
        if tap is None:
            tap = self._open[topic] = _Tap(stream, host)
            self._backend.open_outlet(topic, host)
        elif tap.is_lost:
            self._backend.end_wire(tap.wire, stream, Inlet("", topic))
        else:
            return topic
        tap.wire, tap.is_lost = self._fresh_id(), False
        self._backend.connect(tap.wire, stream, Inlet("", topic), queue=OUTLET_QUEUE, blocks=False)
        return topic

    def close(self, stream: Stream) -> None:
        """Remove the topic of a stream's tap, if there is one."""
        topic = f"{TAPS}{stream}"
        tap = self._open.pop(topic, None)
        if tap is not None:
            self._backend.end_wire(tap.wire, stream, Inlet("", topic))
            self._backend.close_outlet(topic)

    def note_loss(self, wire: int) -> None:
        """Note that a wire has lost its unit, if it is that of a tap."""
        for tap in self._open.values():
            tap.is_lost = tap.is_lost or tap.wire == wire

    def lose_unit(self, unit: str) -> None:
        """Note that a unit has ended."""
        for tap in self._open.values():
            tap.is_lost = tap.is_lost or tap.stream.unit == unit

    def lose_host(self, host: str) -> None:
        """Close the taps on a host that is gone, with its topics."""
        for tap in [tap for tap in self._open.values() if tap.host == host]:
            self.close(tap.stream)

    def note_new_outlets(self) -> None:
        """Connect all taps again, after the backend has replaced the addresses of the topics."""
        for tap in list(self._open.values()):
            tap.is_lost = True
            self.open(tap.stream)
