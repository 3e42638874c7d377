"""The traffic of topics: rates and ages as the outlets measure them, and the elements for a listener."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress

import msgspec

from cfgplan_runtime.children.messages import CrossingCounts, Flow
from cfgplan_runtime.errors import EncodingError, NoSuchTopicError
from cfgplan_runtime.operating.protocol import Record
from cfgplan_runtime.streams.element import Element
from cfgplan_runtime.streams.meter import OVER_S
from cfgplan_runtime.streams.subscription import SubscriptionToTopic, subscribe
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
    """Fetches every element of some topics of a run and gives it to a listener. Each topic has a thread."""

    def __init__(self, run: str, listener: Listener) -> None:
        self._run = run
        self._listener = listener
        self._watches: dict[str, _Watch] = {}
        self._left: list[_Watch] = []
        """Watches that were told to end and have not ended yet."""
        self._dropped = 0
        self._lock = threading.Lock()

    def follow(self, topics: Iterable[str]) -> None:
        """Fetch from these topics and no others from now on. A topic need not exist yet."""
        wanted = set(topics)
        with self._lock:
            for topic in self._watches.keys() - wanted:
                self._leave(topic)
            for topic in sorted(wanted - self._watches.keys()):
                self._watches[topic] = _Watch(topic, self._run, self._listener)

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
            for topic in list(self._watches):
                self._leave(topic)
            watches = list(self._left)
        deadline = time.monotonic() + _FLOW_CLOSE_S
        for watch in watches:
            watch.thread.join(max(0.0, deadline - time.monotonic()))

    def _leave(self, topic: str) -> None:
        watch = self._watches.pop(topic)
        watch.is_closed.set()
        for gone in [watch for watch in self._left if not watch.thread.is_alive()]:
            self._dropped += gone.dropped
            self._left.remove(gone)
        self._left.append(watch)


class _Watch:
    """One topic."""

    def __init__(self, topic: str, run: str, listener: Listener) -> None:
        self._topic = topic
        self._run = run
        self._listener = listener
        self.is_closed = threading.Event()
        """When this is set, the thread ends soon."""
        self.is_connected = False
        self.dropped = 0
        self.thread = threading.Thread(target=self._watch, name=f"cfgplan-flow {topic}", daemon=True)
        self.thread.start()

    def _watch(self) -> None:
        while not self.is_closed.is_set():
            with (
                suppress(NoSuchTopicError),
                subscribe(self._topic, run=self._run, timeout_s=_FLOW_LOOK_S) as subscription,
            ):
                self.is_connected = True
                self._follow(subscription)
            self.is_connected = False
            self.is_closed.wait(_FLOW_LOOK_S)

    def _follow(self, subscription: SubscriptionToTopic) -> None:
        """Fetch until the topic has ended or this watch is closed."""
        before = self.dropped
        while not self.is_closed.is_set() and subscription.is_connected:
            with suppress(TimeoutError):
                for element in subscription.elements():
                    self.dropped = before + subscription.dropped
                    with suppress(EncodingError):
                        self._listener(self._topic, element)
                    if self.is_closed.is_set():
                        return
