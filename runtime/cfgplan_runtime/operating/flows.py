"""The traffic of topics: rates and ages as the outlets measure them, and the elements for a listener.

An update waits for a `Following` before it connects units to a topic, so that no first element is missed.
"""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable, Collection, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from os.path import lexists

import msgspec

from cfgplan_runtime.children.messages import CrossingCounts, Flow
from cfgplan_runtime.errors import EncodingError, NoSuchTopicError
from cfgplan_runtime.operating.protocol import Record
from cfgplan_runtime.runtime import Runtime
from cfgplan_runtime.streams.element import Element
from cfgplan_runtime.streams.meter import OVER_S
from cfgplan_runtime.streams.run_folder import address, base_folder
from cfgplan_runtime.streams.subscription import RunPlace, SubscriptionToTopic
from cfgplan_runtime.supervision.events import CrossingsStatus, Event, TopicsStatus

_FLOW_LOOK_S = 0.2
_DRAIN_LOOK_S = 0.01
_FLOW_CLOSE_S = 5.0

Listener = Callable[[str, Element], None]
"""Called with a topic and its element, in a thread of that topic: it may be slow."""


class Flows:
    """The outlets' last figures of each topic (rate, latency, counts), and the counts of streams between hosts.

    Pass `hear` to `Runtime.listen`. Thread-safe.
    """

    def __init__(self) -> None:
        self._told: tuple[float, dict[str, Flow]] = (time.monotonic(), {})
        self.crossings: Mapping[tuple[str, str, str], CrossingCounts] = {}
        """Counts by stream, source and target host; the stream "" sums all streams that have ended."""

    def hear(self, event: Event) -> None:
        """Add an event's figures of streams."""
        match event:
            case TopicsStatus(flows):
                self._told = time.monotonic(), flows
            case CrossingsStatus(crossings):
                self.crossings = crossings

    def now(self) -> dict[str, Flow]:
        """The flow of each topic now. While the outlets report nothing, every topic counts as silent."""
        at_s, flows = self._told
        since_s = time.monotonic() - at_s
        return {topic: _later(flow, since_s) for topic, flow in flows.items()}

    def crossing_records(self) -> list[Record]:
        """The counts of streams between hosts as dictionaries, by stream and hosts."""
        return [
            {"stream": stream or None, "from": source, "to": target, **msgspec.structs.asdict(counts)}
            for (stream, source, target), counts in sorted(self.crossings.items())
        ]

    def records(self) -> dict[str, Record]:
        """The flows as dictionaries."""
        return {topic: msgspec.structs.asdict(flow) for topic, flow in self.now().items()}


def _later(flow: Flow, since_s: float) -> Flow:
    silent_s = None if flow.silent_s is None else round(flow.silent_s + since_s, 3)
    if since_s > OVER_S:
        return msgspec.structs.replace(flow, rate_hz=0.0, latency_ms=None, silent_s=silent_s)
    return msgspec.structs.replace(flow, silent_s=silent_s)


class Following:
    """Fetches every element of the `wanted` topics of a run and gives it to a listener. Each topic has a thread.

    Updates wait until it is connected to a topic before they connect units to it. If an update has waited in vain,
    `tell` gets a sentence with the number of missed elements, which are not `done` (such as "recorded"). A topic need
    not exist yet.
    """

    def __init__(
        self,
        runtime: Runtime,
        wanted: Callable[[], Iterable[str]],
        listener: Listener,
        tell: Callable[[str], object],
        done: str,
    ) -> None:
        self._runtime = runtime
        self._wanted = wanted
        self._listener = listener
        self._tell = tell
        self._done = done
        self._watches: dict[str, _Watch] = {}
        self._left: list[_Watch] = []
        """Watches that were told to end and have not ended yet."""
        self._dropped = 0
        self._is_closed = False
        self._lock = threading.Lock()
        self.look()
        runtime.await_follower(self._is_connected)

    def look(self) -> None:
        """Fetch from the topics that are wanted now, and from no others."""
        with self._lock:
            wanted = set[str]() if self._is_closed else set(self._wanted())
            for topic in self._watches.keys() - wanted:
                self._leave(topic)
            for topic in sorted(wanted - self._watches.keys()):
                self._watches[topic] = _Watch(topic, self._runtime, self._listener, self._tell_missed)

    def _is_connected(self, topics: Collection[str]) -> bool:
        """Return whether it gets every element of these topics, except those that are not wanted or that only ROS has.

        The threads of the others look for their topics at once, and wake the runtime. Elements that come before they
        have connected count as missed.
        """
        self.look()
        with self._lock:
            found = [self._watches[topic] for topic in topics if topic in self._watches]
        waiting = [watch for watch in found if not watch.is_ready()]  # each is asked
        return not waiting

    @property
    def dropped(self) -> int:
        """How many elements were not fetched in time, also of topics that are no longer followed."""
        with self._lock:
            return self._dropped + sum(watch.dropped for watch in (*self._watches.values(), *self._left))

    def drain(self, timeout_s: float) -> None:
        """Wait until all topics have ended and were fetched to their end, at most `timeout_s` seconds."""
        deadline = time.monotonic() + timeout_s
        with self._lock:
            watches = list(self._watches.values())
        while any(watch.is_connected for watch in watches) and time.monotonic() < deadline:
            time.sleep(_DRAIN_LOOK_S)

    def close(self) -> None:
        """Stop fetching. Waits until the listeners have returned, except for one that hangs."""
        with self._lock:
            self._is_closed = True
            for topic in list(self._watches):
                self._leave(topic)
            watches = list(self._left)
        deadline = time.monotonic() + _FLOW_CLOSE_S
        for watch in watches:
            watch.thread.join(max(0.0, deadline - time.monotonic()))

    def _tell_missed(self, topic: str, number: int) -> None:
        one, many = f"the first element on {topic} is", f"the first {number} elements on {topic} are"
        told = one if number == 1 else many
        self._tell(f"{told} not {self._done}: the update did not wait longer for the connection to the topic")

    def _leave(self, topic: str) -> None:
        watch = self._watches.pop(topic)
        watch.close()
        for gone in [watch for watch in self._left if not watch.thread.is_alive()]:
            self._dropped += gone.dropped
            self._left.remove(gone)
        self._left.append(watch)


@dataclass(slots=True)
class _Address:
    """A topic's address in the folder of its run. `connected` is the socket to which it was connected last."""

    place: RunPlace
    topic: str
    connected: tuple[int, int] | None = None

    @property
    def name(self) -> str:
        return self.place.name

    def connect(self, topic: str) -> socket.socket | None:
        self.connected = self.identity
        end = self.place.connect(topic)
        if end is not None and self.connected != self.identity:  # it has just been opened again
            end.close()
            return None
        return end

    def is_alive(self) -> bool:
        return self.place.is_alive()

    def now_ns(self) -> int:
        return self.place.now_ns()

    @property
    def exists(self) -> bool:
        """Whether the run shows the topic, perhaps at an address that does not exist yet."""
        return lexists(address(self.place.run, self.topic))

    @property
    def identity(self) -> tuple[int, int] | None:
        """The socket that has the address now: a topic that was closed and opened again has another one."""
        with suppress(OSError):
            found = address(self.place.run, self.topic).stat()
            return found.st_ino, found.st_ctime_ns
        return None


class _Watch:
    """One topic."""

    def __init__(self, topic: str, runtime: Runtime, listener: Listener, missed: Callable[[str, int], object]) -> None:
        self._topic = topic
        self._runtime = runtime
        self._listener = listener
        self._missed = missed
        self._address = _Address(RunPlace(base_folder() / runtime.id), topic)
        self._connected: tuple[int, int] | None = None
        """The socket from which every element comes now."""
        self._was_begun = False
        """Whether every element has ever come."""
        self._is_awaited = False
        """Whether an update waits, or has waited, for the first connection: every element before it is missed."""
        self._is_closed = False
        self._again = threading.Event()
        """Set when the thread need not wait until it looks for the topic again."""
        self.is_connected = False
        self._dropped_before = self.dropped = 0
        """Elements not fetched: before the present connection, and in all."""
        self.thread = threading.Thread(target=self._watch, name=f"cfgplan-flow {topic}", daemon=True)
        self.thread.start()

    def is_ready(self) -> bool:
        """Return whether every element comes, or the run does not show the topic. If neither holds, let the thread look
        for the topic at once.
        """
        if not self._address.exists:
            return True
        if self._connected is not None and self._connected == self._address.identity:
            return True
        if not self._is_awaited:
            self._is_awaited = True
            self._again.set()
        return False

    def close(self) -> None:
        """Let the thread end soon."""
        self._is_closed = True
        self._again.set()

    def _watch(self) -> None:
        while not self._is_closed:
            self._again.clear()
            with (
                suppress(NoSuchTopicError),
                SubscriptionToTopic(self._topic, self._address, timeout_s=_FLOW_LOOK_S) as subscription,
            ):
                subscription.on_begin = self._begin
                self.is_connected = True
                self._follow(subscription)
            self.is_connected, self._connected = False, None
            if not self._is_closed:
                self._again.wait(_FLOW_LOOK_S)

    def _begin(self, before: int) -> None:
        if self._is_awaited and before and not self._was_begun:
            self._dropped_before += before
            self.dropped += before
            self._missed(self._topic, before)
        self._is_awaited, self._was_begun = False, True
        self._connected = self._address.connected
        self._runtime.supervisor.backend.wake()

    def _follow(self, subscription: SubscriptionToTopic) -> None:
        """Fetch until the topic has ended or this watch is closed."""
        self._dropped_before = self.dropped
        while not self._is_closed and subscription.is_connected:
            with suppress(TimeoutError):
                for element in subscription.elements():
                    self.dropped = self._dropped_before + subscription.dropped
                    with suppress(EncodingError):
                        self._listener(self._topic, element)
                    if self._is_closed:
                        return
