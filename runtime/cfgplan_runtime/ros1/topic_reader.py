"""A node of ROS 1 that reads topics which nodes from outside of a run publish."""

from __future__ import annotations

import itertools
import selectors
import socket
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field

from cfgplan.ros.node_api import SilentError
from cfgplan.ros.topic_names import word
from cfgplan.ros.types import MessageType
from cfgplan_runtime.errors import EncodingError
from cfgplan_runtime.operating.outside_topics import TakeValue
from cfgplan_runtime.outside.once import Once
from cfgplan_runtime.ros1.master_calls import MasterCalls
from cfgplan_runtime.ros1.relay_api import RelayApi
from cfgplan_runtime.ros1.ros_master import master_address, own_host
from cfgplan_runtime.ros1.tapped_values import MessageDecoders, check_decoders
from cfgplan_runtime.ros1.tcpros import LENGTH_BYTES, Header, MessageReader, subscribed

_READ_AGAIN_S, _MOST_READ_AGAIN_S = 0.05, 2.0
"""Seconds until a publisher that has ended is tried again, doubled up to the second value."""
_LOOK_S = 0.5
"""Seconds after which a thread that waits for messages looks whether they are still wanted."""


@dataclass(slots=True, eq=False)
class _ReadTopic:
    """A topic that is read. `wanted` are the addresses of its publishers, each read by a thread."""

    topic: str
    kind: str
    take: TakeValue
    wanted: set[str] = field(default_factory=set)


class Ros1Reader:
    """A `TopicReader` of ROS 1, at the master of ROS_MASTER_URI.

    `purpose` is part of its node's name, and `mend` says what to do if a topic is of another type. Raises InputError;
    `tell` is called with later faults, each once.
    """

    def __init__(self, purpose: str, mend: str, run: str, tell: Callable[[str], None]) -> None:
        check_decoders()
        self._mend = mend
        self._node = f"/cfgplan_{purpose}_{word(run)}"
        self._once, self._decoders = Once(tell), MessageDecoders()
        self._topics: dict[int, _ReadTopic] = {}
        self._numbers = itertools.count()
        self._lock = threading.Lock()
        master = master_address()
        self._api = RelayApi(self, master, own_host(master), 0)
        self._to_master = MasterCalls(master, self._node)

    def read(self, topic: str, kind: str, qos: str, depth: int, take: TakeValue) -> int:  # noqa: ARG002
        """See `TopicReader.read`. ROS 1 has no quality of service."""
        one, number = _ReadTopic(topic, MessageType.read(kind).ros1, take), next(self._numbers)
        self._topics[number] = one
        self._to_master.ask(
            "registerSubscriber",
            topic,
            "*",
            self._api.address,
            is_wanted=lambda: number in self._topics,
            then=lambda publishers: self._want(one, publishers),
        )
        return number

    def end(self, number: int) -> None:
        """Stop reading a topic."""
        with self._lock:
            one = self._topics.pop(number)
            one.wanted.clear()
            is_read = any(other.topic == one.topic for other in self._topics.values())
        if not is_read:
            self._to_master.tell("unregisterSubscriber", one.topic, self._api.address)

    def close(self) -> None:
        """End the node."""
        for number in list(self._topics):
            self.end(number)

    # The node's interface calls these, in threads of its own.

    def published(self) -> Mapping[str, str]:
        return {}

    def subscribed(self) -> Mapping[str, str]:
        return {one.topic: one.kind for one in list(self._topics.values())}

    def note_publishers(self, topic: str, addresses: list[str]) -> None:
        for one in list(self._topics.values()):
            if one.topic == topic:
                self._want(one, addresses)

    def finish(self) -> None:
        self.close()

    def _want(self, one: _ReadTopic, addresses: list[str]) -> None:
        """Read a topic from these publishers, and from no others."""
        with self._lock:
            if one not in self._topics.values():
                return
            new = sorted(set(addresses) - one.wanted)
            one.wanted.intersection_update(addresses)
            one.wanted.update(new)
        for address in new:
            threading.Thread(target=self._follow, args=(one, address), daemon=True).start()

    def _follow(self, one: _ReadTopic, address: str) -> None:
        """Read a topic from a publisher, again and again while it is wanted."""
        again_s = _READ_AGAIN_S
        while address in one.wanted:
            with suppress(SilentError, OSError):
                end, header = subscribed(address, self._node, one.topic)
                again_s = _READ_AGAIN_S
                with end:
                    self._read(one, address, end, header)
            time.sleep(again_s)
            again_s = min(2 * again_s, _MOST_READ_AGAIN_S)

    def _read(self, one: _ReadTopic, address: str, end: socket.socket, header: Header) -> None:
        kind, reader = header["type"], MessageReader(end)
        if kind != one.kind:
            self._once.tell(one.topic, f"{one.topic} is of type {kind}, not {one.kind}: {self._mend}")
            return
        with selectors.DefaultSelector() as selector:
            selector.register(end, selectors.EVENT_READ)
            while address in one.wanted and not reader.has_ended:
                if selector.select(_LOOK_S):
                    for message in reader.read():
                        self._give(one, header.get("message_definition", ""), bytes(message[LENGTH_BYTES:]))

    def _give(self, one: _ReadTopic, definition: str, data: bytes) -> None:
        try:
            value = self._decoders.value(one.kind, definition, data)
        except EncodingError as error:
            self._once.tell(one.topic, f"messages of {one.topic} can't be read: {error}")
        else:
            one.take(value)
