"""Topics that a process of cfgplan's reads and publishes itself: messages pass the socket as they are on the wire."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any, Protocol

from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks

from cfgplan_runtime.ros2.host.endpoints import UnknownTypeError, message_class
from cfgplan_runtime.ros2.host.host import NAMELESS, Host
from cfgplan_runtime.ros2.host.qos import Quality

_PUBLISHERS_S = 1.0
"""Seconds between two looks for publishers of topics that are read."""
_MOST_TAKEN = 10


class _PassedTopic(Protocol):
    def close(self) -> None: ...


class Topics:
    """The topics of this node by number, as the orders `Publish`, `Read` and `Close` name them."""

    def __init__(self, host: Host) -> None:
        self._host = host
        self._topics: dict[int, _PassedTopic] = {}
        host.handlers |= {
            "Publish": lambda order: self._open(_Published, **order),
            "Read": lambda order: self._open(_Read, **order),
            "Put": self._put,
            "Sent": self._sent,
            "Close": self._close,
        }
        self._look()

    def _open(self, kind: Callable[..., _PassedTopic], number: int, **order: Any) -> None:
        try:
            self._topics[number] = kind(self._host, number, **order)
        except UnknownTypeError as error:
            self._host.say("Unopened", number=number, cause=str(error))

    def _put(self, order: dict[str, Any]) -> None:
        topic = self._topics.get(order["number"])
        if isinstance(topic, _Published):
            topic.publisher.publish(order["data"])

    def _sent(self, order: dict[str, Any]) -> None:
        topic = self._topics.get(order["number"])
        if isinstance(topic, _Read):
            topic.say_next()

    def _close(self, order: dict[str, Any]) -> None:
        topic = self._topics.pop(order["number"], None)
        if topic is not None:
            topic.close()

    def _look(self) -> None:
        for topic in self._topics.values():
            if isinstance(topic, _Read):
                topic.look()
        self._host.waiting.later(_PUBLISHERS_S, self._look)


class _Published:
    """A topic that is published. Raises UnknownTypeError."""

    def __init__(
        self, host: Host, number: int, topic: str, message: str, *, reliable: bool, latched: bool, depth: int
    ) -> None:
        del number
        self._host = host
        self.publisher: Any = host.node.create_publisher(
            message_class(message),
            topic,
            Quality(reliable, latched).profile(depth),
            event_callbacks=PublisherEventCallbacks(use_default_callbacks=False),
        )

    def close(self) -> None:
        self._host.node.destroy_publisher(self.publisher)


class _Read:
    """A topic that is read. While the socket is full, the last `depth` messages wait. Raises UnknownTypeError."""

    def __init__(
        self, host: Host, number: int, topic: str, message: str, *, reliable: bool, latched: bool, depth: int
    ) -> None:
        self._host, self._number, self._topic = host, number, topic
        self._cls = message_class(message)
        self._waiting: deque[tuple[bytes, int]] = deque(maxlen=depth)
        self._is_sending = False
        self._dropped = 0
        self._seen: set[tuple[str, str, str]] = set()
        self._nameless: set[tuple[int, ...]] = set()
        """Publishers whose nodes had no name at the first look."""
        self._subscription: Any = host.node.create_subscription(
            self._cls,
            topic,
            lambda _: None,
            Quality(reliable, latched).profile(depth),
            raw=True,
            event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
        )
        host.waiting.watch("subscription", self._subscription.handle, self._take)
        self.look()

    def close(self) -> None:
        self._host.waiting.unwatch("subscription", self._subscription.handle)
        self._host.node.destroy_subscription(self._subscription)

    def look(self) -> None:
        """Tell of each publisher once. An endpoint may be found before its node's name is; the next look has it."""
        for one in self._host.node.get_publishers_info_by_topic(self._topic):
            endpoint = tuple(one.endpoint_gid)
            if one.node_name == NAMELESS and endpoint not in self._nameless:
                self._nameless.add(endpoint)
                continue
            name = f"{one.node_namespace.rstrip('/')}/{one.node_name}"
            told = name, one.topic_type, str(getattr(one, "topic_type_hash", "") or "")
            if told not in self._seen:
                self._seen.add(told)
                self._host.say("Publishes", number=self._number, node=told[0], message=told[1], definition=told[2])

    def say_next(self) -> None:
        """Send the message that waits longest, once the one before has passed the socket."""
        self._is_sending = bool(self._waiting)
        if self._is_sending:
            raw, sent_ns = self._waiting.popleft()
            dropped, self._dropped = self._dropped, 0
            self._host.say("Message", raw, number=self._number, sent_ns=sent_ns, dropped=dropped)

    def _take(self) -> None:
        for _ in range(_MOST_TAKEN):
            taken = self._subscription.handle.take_message(self._cls, True)
            if taken is None:
                break
            raw, info = taken
            self._dropped += len(self._waiting) == self._waiting.maxlen
            self._waiting.append((raw, info["source_timestamp"]))
        if not self._is_sending:
            self.say_next()
