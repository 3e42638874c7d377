"""Subscriptions to topics: connect once, and keep receiving from every unit that feeds the topic in turn."""

from __future__ import annotations

import selectors
import socket
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from cfgplan_runtime.errors import NoSuchTopicError
from cfgplan_runtime.streams.channel import Receiver
from cfgplan_runtime.streams.closable import Closable
from cfgplan_runtime.streams.element import Element, Moment
from cfgplan_runtime.streams.payload import decode
from cfgplan_runtime.streams.run_folder import (
    address,
    base_folder,
    clock_offset_ns,
    id_and_name,
    is_alive,
    is_called,
    live_runs,
    no_such_run,
    topics_of,
)
from cfgplan_runtime.streams.topic_names import not_published

_RETRY_S = 0.02


@dataclass(frozen=True, slots=True)
class Received:
    """A `value` of a `topic`. `time_ns` is the time when it was made, in nanoseconds since 1970, on the run's clock."""

    value: Any
    time_ns: int
    topic: str


class TopicPlace(Protocol):
    """Connects to topics of a run, wherever they are. A topic may move to another host between two connections."""

    @property
    def name(self) -> str: ...

    def connect(self, topic: str) -> socket.socket | None:
        """A socket that gives the topic's elements from now on; None if the topic does not exist."""

    def is_alive(self) -> bool:
        """Whether a missing topic may come back."""

    def now_ns(self) -> int:
        """The present time on the run's clock, on which elements have their times, while connected."""


@dataclass(frozen=True, slots=True)
class RunPlace:
    """The folder of a run on this computer."""

    run: Path

    @property
    def name(self) -> str:
        return self.run.name

    def connect(self, topic: str) -> socket.socket | None:
        end = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            end.connect(str(address(self.run, topic)))
        except OSError:
            end.close()
            return None
        return end

    def is_alive(self) -> bool:
        return is_alive(self.run)

    def now_ns(self) -> int:
        return time.monotonic_ns() + clock_offset_ns(self.run)


class SubscriptionToTopic(Closable):
    """A connection to a topic. Iterate over it for the values, until the run ends."""

    def __init__(self, topic: str, place: TopicPlace, *, timeout_s: float | None) -> None:
        self.topic = topic
        self.dropped = 0
        """The number of elements dropped because this consumer was slow."""
        self._place = place
        self._timeout_s = timeout_s
        self.on_begin: Callable[[int], object] = lambda _: None
        """Called with the number of the topic's elements before the connection, once every later one comes; again after
        each later connection.
        """
        self._has_begun = False
        self._receiver: Receiver | None = None
        self._next_number = 0
        self._last: Moment | None = None
        if not self._connect():
            raise NoSuchTopicError(f"topic {topic!r} of run {place.name} can't be connected to")

    def __iter__(self) -> Iterator[Received]:
        """Yield values as they come. Ends with the run; raises TimeoutError if none comes for `timeout_s` seconds."""
        for element in self.elements():
            yield Received(decode(element.payload), element.time_ns, self.topic)

    def elements(self) -> Iterator[Element]:
        """Elements as they come, not decoded; ends and raises as iteration does."""
        while self._receiver is not None:
            self._wait(self._receiver)
            for element in self._receiver.read():
                if not self._has_begun:
                    self._note_place(self._receiver)
                if self._is_new(element):
                    yield element
                if self._receiver is None:
                    return
            self._note_place(self._receiver)
            if self._receiver.has_ended:
                self._receiver.close()
                self._reconnect()

    def now_ns(self) -> int:
        """The present time on the run's clock. A value's age is this minus its `time_ns`."""
        return self._place.now_ns()

    @property
    def is_connected(self) -> bool:
        """Whether the topic is connected."""
        return self._receiver is not None

    def close(self) -> None:
        """Disconnect."""
        if self._receiver is not None:
            self._receiver.close()
            self._receiver = None

    def _wait(self, receiver: Receiver) -> None:
        with selectors.DefaultSelector() as selector:
            selector.register(receiver.socket, selectors.EVENT_READ)
            if not selector.select(self._timeout_s):
                raise TimeoutError(f"nothing came on {self.topic} for {self._timeout_s} s")

    def _note_place(self, receiver: Receiver) -> None:
        if not self._has_begun and receiver.place is not None:
            self._has_begun = True
            self.on_begin(receiver.before)

    def _is_new(self, element: Element) -> bool:
        self.dropped += element.number - self._next_number
        self._next_number = element.number + 1
        if self._last is not None and element.moment <= self._last:
            return False
        self._last = element.moment
        return True

    def _reconnect(self) -> None:
        self._receiver = None
        since = time.monotonic()
        while self._place.is_alive() and not self._connect():
            if self._timeout_s is not None and time.monotonic() - since > self._timeout_s:
                raise TimeoutError(f"{self.topic} was gone for {self._timeout_s} s")
            time.sleep(_RETRY_S)

    def _connect(self) -> bool:
        end = self._place.connect(self.topic)
        if end is None:
            return False
        self._receiver = Receiver(end)
        self._next_number, self._has_begun = 0, False
        return True


def subscribe(
    topic: str, *, run: str | None = None, timeout_s: float | None = None, wait_s: float = 0.0
) -> SubscriptionToTopic:
    """Subscribe to `topic` of a run of this user on this computer.

    `run` is the run's id or name, needed only if several runs have the topic. Waits up to `wait_s` seconds for the
    topic, and up to `timeout_s` seconds for each value. Raises NoSuchTopicError.
    """
    deadline = time.monotonic() + wait_s
    while True:
        found = _runs_with(topic, run)
        if len(found) == 1:
            try:
                return SubscriptionToTopic(topic, RunPlace(found[0]), timeout_s=timeout_s)
            except NoSuchTopicError:
                if time.monotonic() >= deadline:
                    raise
        elif time.monotonic() >= deadline:
            raise NoSuchTopicError(_why_not(topic, run, found))
        time.sleep(_RETRY_S)


def _runs_with(topic: str, run: str | None) -> list[Path]:
    """The runs with a topic, each address once, as a run may show a topic of another one."""
    runs = [path for path in _live(run) if address(path, topic).exists()]
    return list({address(path, topic).resolve(): path for path in runs}.values())


def _live(run: str | None) -> list[Path]:
    """The live runs, or that of this id or name."""
    return [path for path in live_runs(base_folder()) if run is None or is_called(path, run)]


def _why_not(topic: str, run: str | None, found: list[Path]) -> str:
    if found:
        return f"several runs have topic {topic!r}: name one of {', '.join(map(id_and_name, found))} (--run)"
    live = list(live_runs(base_folder()))
    if not live:
        return f"nothing publishes topic {topic!r}: no run is live; start one with `cfgplan run ENV`"
    meant = _live(run)
    if not meant:
        return no_such_run(run, live, ", ".join(map(id_and_name, live)))
    return not_published(topic, (name for path in meant for name in topics_of(path)))
