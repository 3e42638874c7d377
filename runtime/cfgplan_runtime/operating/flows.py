"""What comes on the targets' topics: its rate and latency, and whoever wants the elements themselves."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import asdict, dataclass

from cfgplan_runtime.errors import EncodingError, NoSuchTopicError
from cfgplan_runtime.operating.protocol import Record
from cfgplan_runtime.streams.element import Element
from cfgplan_runtime.streams.subscription import SubscriptionToTopic, subscribe

OVER_S = 3.0
"""Rate and latency are over so many seconds."""
_LOOK_S = 0.2
_DRAIN_LOOK_S = 0.01
_CLOSE_S = 5.0
_MOST_STAMPS = 4096

Listener = Callable[[str, Element], None]
"""Gets a topic and an element that came there; from the topic's own thread, so it may take its time."""


@dataclass(frozen=True, slots=True)
class Flow:
    """What comes on a topic: elements per second, the median age at arrival in milliseconds, and counts.

    Age is the time since the source element was made that it comes from. `rate_hz` is 0 and `latency_ms` None
    if nothing came in the last seconds; `silent_s` is the time since the last element, None if none ever came.
    """

    rate_hz: float = 0.0
    latency_ms: float | None = None
    elements: int = 0
    dropped: int = 0
    silent_s: float | None = None


class Flows:
    """Watches the topics of one run, each in a thread of its own; elements are not decoded."""

    def __init__(self, run: str, listener: Listener | None = None) -> None:
        self._run = run
        self._listener = listener
        self._watches: dict[str, _Watch] = {}
        self._left: list[_Watch] = []
        """Those that are about to end."""
        self._dropped = 0
        self._lock = threading.Lock()

    def follow(self, topics: Iterable[str]) -> None:
        """Watch these topics from now on, and no others; a topic may come to be later."""
        wanted = set(topics)
        with self._lock:
            for topic in self._watches.keys() - wanted:
                self._leave(topic)
            for topic in sorted(wanted - self._watches.keys()):
                self._watches[topic] = _Watch(topic, self._run, self._listener)

    def now(self) -> dict[str, Flow]:
        """What comes on each topic."""
        with self._lock:
            return {topic: watch.flow() for topic, watch in self._watches.items()}

    def records(self) -> dict[str, Record]:
        """The same as plain records."""
        return {topic: asdict(flow) for topic, flow in self.now().items()}

    @property
    def dropped(self) -> int:
        """How many elements of all topics, also of those that are no longer followed, were not fetched in time."""
        with self._lock:
            return self._dropped + sum(watch.flow().dropped for watch in (*self._watches.values(), *self._left))

    def drain(self, timeout_s: float) -> None:
        """Wait until everything has come from topics that are gone; at most so long."""
        deadline = time.monotonic() + timeout_s
        with self._lock:
            watches = list(self._watches.values())
        while any(watch.is_connected for watch in watches) and time.monotonic() < deadline:
            time.sleep(_DRAIN_LOOK_S)

    def close(self) -> None:
        """Watch no more; waits until the last listener has returned, but not for one that hangs."""
        with self._lock:
            for topic in list(self._watches):
                self._leave(topic)
            watches = list(self._left)
        deadline = time.monotonic() + _CLOSE_S
        for watch in watches:
            watch.join(max(0.0, deadline - time.monotonic()))

    def _leave(self, topic: str) -> None:
        watch = self._watches.pop(topic)
        watch.close()
        for gone in [watch for watch in self._left if watch.has_ended]:
            self._dropped += gone.flow().dropped
            self._left.remove(gone)
        self._left.append(watch)


class _Watch:
    """One topic."""

    def __init__(self, topic: str, run: str, listener: Listener | None) -> None:
        self._topic = topic
        self._run = run
        self._listener = listener
        self._is_closed = threading.Event()
        self.is_connected = False
        self._since = time.monotonic()
        self._elements = 0
        self._dropped = 0
        self._stamps: deque[tuple[float, float]] = deque(maxlen=_MOST_STAMPS)
        self._thread = threading.Thread(target=self._watch, name=f"cfgplan-flow {topic}", daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._is_closed.set()

    @property
    def has_ended(self) -> bool:
        return not self._thread.is_alive()

    def join(self, timeout_s: float) -> None:
        self._thread.join(timeout_s)

    def flow(self) -> Flow:
        now = time.monotonic()
        stamps = list(self._stamps)
        begin = max(now - OVER_S, self._since, stamps[0][0] if len(stamps) == _MOST_STAMPS else 0.0)
        ages = sorted(age for at, age in stamps if at >= begin)
        return Flow(
            rate_hz=round(len(ages) / (now - begin), 2) if now > begin else 0.0,
            latency_ms=round(ages[len(ages) // 2] * 1e3, 3) if ages else None,
            elements=self._elements,
            dropped=self._dropped,
            silent_s=round(now - stamps[-1][0], 3) if stamps else None,
        )

    def _watch(self) -> None:
        while not self._is_closed.is_set():
            with suppress(NoSuchTopicError), subscribe(self._topic, run=self._run, timeout_s=_LOOK_S) as subscription:
                self.is_connected = True
                self._follow(subscription)
            self.is_connected = False
            self._is_closed.wait(_LOOK_S)

    def _follow(self, subscription: SubscriptionToTopic) -> None:
        """Until the topic is gone, or nobody wants to know any more."""
        before = self._dropped
        while not self._is_closed.is_set() and subscription.is_connected:
            with suppress(TimeoutError):
                for element in subscription.elements():
                    self._dropped = before + subscription.dropped
                    self._note(element)
                    if self._is_closed.is_set():
                        return

    def _note(self, element: Element) -> None:
        self._stamps.append((time.monotonic(), time.time() - element.time_ns / 1e9))
        self._elements += 1
        if self._listener is not None:
            with suppress(EncodingError):
                self._listener(self._topic, element)
