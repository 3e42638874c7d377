"""The relay of a host: a thread of its agent that sends streams to other hosts, once to each, and receives theirs.

An export is an input of the relay: its elements go to another host. An import is an output of the relay: it sends the
elements of another host's export. The relay's thread only queues; each export has a thread that puts into the network.
"""

from __future__ import annotations

import socket
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from math import inf

from cfgplan_runtime.children import messages
from cfgplan_runtime.children.control import ControlConnection
from cfgplan_runtime.children.ports import Ports, UnitInput, UnitOutput
from cfgplan_runtime.streams import crossing
from cfgplan_runtime.streams.element import Element, Outgoing
from cfgplan_runtime.streams.ends import Waker
from cfgplan_runtime.streams.inlet import InputQueue
from cfgplan_runtime.streams.zenoh_link import Lane, PutThread, ZenohLink

LARGE_BYTES = 16_384
"""A crossing whose first element has more bytes uses the lane `large`, which all others overtake."""
_LOOK_S = 0.1
"""Seconds from one search for unused imports to the next."""


@dataclass(slots=True)
class _Export:
    sending: crossing.Sending
    host: str
    input: UnitInput
    was_fed: bool = False
    has_ended: bool = False
    thread: PutThread | None = None


@dataclass(slots=True)
class _Import:
    host: str
    put_credit: PutThread
    receiving: crossing.Receiving = field(default_factory=crossing.Receiving)
    skipped: int = 0
    has_ended: bool = False
    told_unused: int = 0
    marks: list[str] = field(default_factory=list)
    """The units of marks that have come before all earlier elements were delivered."""


class Relay:
    """The relay of one host: a thread that runs until `close`. `control` is its end of a connection with the agent.

    If the thread fails, it calls `failed` with the error.
    """

    def __init__(
        self, host: str, link: ZenohLink, control: socket.socket, failed: Callable[[BaseException], None]
    ) -> None:
        self._host = host
        self._link = link
        self._failed = failed
        self._ports = Ports(ControlConnection(control, messages.ToChild), self._obey)
        self._exports: dict[str, _Export] = {}
        self._imports: dict[str, _Import] = {}
        self._arrived: deque[tuple[str, bytes, bytes]] = deque()
        self._is_closing = self._has_rung = False
        self._waker = Waker()
        self._ports.ends.watch(self._waker.socket, self._waker.hear)
        for kind in ("data", "credit"):
            link.hear(crossing.crossing_key(None, kind, host, "*"), self._take)
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def counts(self) -> dict[str, messages.CrossingCounts]:
        """The counts of each export. Thread-safe."""
        return {
            name: messages.CrossingCounts(
                one.input.elements,
                one.sending.dropped,
                one.sending.depth,
                one.sending.crowded,
                one.sending.offered_bytes,
                one.sending.arrived_bytes,
            )
            for name, one in list(self._exports.items())
        }

    @property
    def lost(self) -> int:
        """The number of elements that would be lost if all exports were released now; for the agent's thread."""
        return sum(export.sending.lost for export in list(self._exports.values()))

    def close(self) -> None:
        """End the thread and those of all exports."""
        self._is_closing = True
        self._waker.wake()
        self._thread.join()

    def _run(self) -> None:
        try:
            self._relay()
        except Exception as error:
            self._failed(error)
        for name in {*self._exports, *self._imports}:
            self._release(name)

    def _relay(self) -> None:
        look_s = time.monotonic()
        while not self._is_closing:
            due_s = min(look_s if self._imports else inf, self._due_s())
            self._ports.ends.wait(None if due_s == inf else max(0.0, due_s - time.monotonic()))
            now_s = time.monotonic()
            self._take_arrivals(now_s)
            for name, export in self._exports.items():
                self._send(name, export, now_s)
            for name, one in self._imports.items():
                self._acknowledge(name, one, now_s)
            self._ports.resume()
            if now_s >= look_s:
                look_s = now_s + _LOOK_S
                self._tell_of_unused()

    def _take(self, key: str, head: bytes, payload: bytes) -> None:
        """Called by threads of the link."""
        self._arrived.append((key, head, payload))
        if not self._has_rung:
            self._has_rung = True
            self._waker.wake()

    def _due_s(self) -> float:
        sent = [one.sending.due_s for one in self._exports.values()]
        told = [one.receiving.due_s for one in self._imports.values()]
        return min((due_s for due_s in sent + told if due_s is not None), default=inf)

    def _obey(self, message: messages.ToChild, _: list[socket.socket]) -> None:
        match message:
            case messages.Export(name, host, queue, blocks):
                self._export(name, host, queue, blocks)
            case messages.Import(name, host):
                put = self._link.publisher(crossing.crossing_key(self._host, "credit", host, name), "orders")
                self._imports[name] = _Import(host, PutThread(put))
                self._ports.outputs[name] = UnitOutput()
            case messages.TellMark(name, unit) if name in self._exports:
                self._ports.take_in(name)
                self._exports[name].sending.offer(crossing.Segment(0, 0, unit.encode(), is_mark=True))
            case messages.Release(name):
                self._release(name)

    def _export(self, name: str, host: str, queue: int, blocks: bool) -> None:
        sending = crossing.Sending(blocks=blocks, most=queue) if blocks else crossing.Sending()
        inlet, known = InputQueue(queue), 0

        def take(element: Element) -> None:
            nonlocal known
            sending.dropped += inlet.dropped - known
            known = inlet.dropped
            payload = element.payload if isinstance(element.payload, bytes) else bytes(element.payload)
            sending.offer(crossing.Segment(element.time_ns, element.turn, payload))

        def pause() -> None:
            sending.offer(crossing.PAUSE_SEGMENT)

        port = self._ports.inputs[name] = UnitInput(name, inlet, take, lambda: not sending.is_full, pause=pause)
        self._exports[name] = _Export(sending, host, port)

    def _release(self, name: str) -> None:
        export, one = self._exports.pop(name, None), self._imports.pop(name, None)
        if export is not None:
            self._ports.close_input(name)
            if export.thread is not None:
                export.thread.close()
        if one is not None:
            self._ports.close_output(name)
            one.put_credit.close()

    def _take_arrivals(self, now_s: float) -> None:
        self._has_rung = False
        while self._arrived:
            key, head, payload = self._arrived.popleft()
            _, _, kind, _, name = key.split("/")
            if kind == "credit" and name in self._exports:
                credit = crossing.read_credit(payload)
                if credit is not None:
                    self._exports[name].sending.hear(credit, now_s)
            elif kind == "data" and name in self._imports:
                self._hand_on(name, self._imports[name], head, payload, now_s)

    def _hand_on(self, name: str, one: _Import, head: bytes, payload: bytes, now_s: float) -> None:
        frame = crossing.read_frame(head, payload)
        for segment in () if frame is None else one.receiving.take(frame, now_s):
            if one.receiving.dropped > one.skipped:
                self._ports.skip(name, one.receiving.dropped - one.skipped)
                one.skipped = one.receiving.dropped
            if segment.is_last:
                one.has_ended = True
            elif segment.is_pause:
                self._ports.pause(name)
            elif segment.is_mark:
                one.marks.append(bytes(segment.payload).decode())
            else:
                self._ports.emit(name, Outgoing(segment.time_ns, segment.turn, [segment.payload]))

    def _send(self, name: str, export: _Export, now_s: float) -> None:
        if export.input.receivers:
            export.was_fed = True
        elif export.was_fed and not export.has_ended:
            export.has_ended = True
            export.sending.offer(crossing.LAST_SEGMENT)
        for frame in export.sending.due(now_s):
            payload = b"" if frame.segment is None else frame.segment.payload
            assert isinstance(payload, bytes)
            if export.thread is None:
                lane: Lane = "large" if frame.has_more or len(payload) > LARGE_BYTES else "small"
                key = crossing.crossing_key(self._host, "data", export.host, name)
                export.thread = PutThread(self._link.publisher(key, lane))
            export.thread.give(frame.head(), payload)

    def _acknowledge(self, name: str, one: _Import, now_s: float) -> None:
        if one.marks and not any(sender.depth for sender in self._ports.outputs[name].senders):
            for unit in one.marks:
                self._ports.say(messages.Marked(name, unit))
            one.marks.clear()
        if not self._ports.outputs[name].served:
            return  # the sender waits for a first credit: what came before anybody takes it would be lost
        credit = one.receiving.credit(now_s, has_room=not self._ports.is_full(name))
        if credit is not None:
            one.put_credit.give(b"", credit.packed())
        if one.has_ended:
            self._ports.end_output(name)

    def _tell_of_unused(self) -> None:
        for name, one in self._imports.items():
            output = self._ports.outputs[name]
            if not output.senders and output.served != one.told_unused:
                one.told_unused = output.served
                self._ports.say(messages.ImportUnused(name, output.served))
