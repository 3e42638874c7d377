"""A ROS 2 node of cfgplan's own that publishes and reads topics, by the helper in the user's ROS Python."""

from __future__ import annotations

import os
import re
import selectors
import socket
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import TypeAlias

import msgspec

from cfgplan.errors import InputError
from cfgplan.extras import needed
from cfgplan.ros.qos import ServiceQuality
from cfgplan_runtime.outside.once import Once
from cfgplan_runtime.ros2.host_link import HostLink, WithData
from cfgplan_runtime.ros2.host_messages import FromHost
from cfgplan_runtime.ros2.message_form import MessageForm
from cfgplan_runtime.ros2.ros_python import VARIABLE, RosPython, ros_python

LARGEST_DOMAIN = 232
"""DDS has no ports for domains beyond."""
_ANEW_S = 1.0
"""Seconds until a helper that has ended is restarted."""
_TURN_S = 1.0
_LAST_S = 1.0
"""Seconds in which waiting messages are published at the end."""
_ROS_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")

Take: TypeAlias = Callable[[bytes, int], None]
"""Called with a message in CDR and when it was published (nanoseconds since the epoch), in the topics' thread."""


class Publish(msgspec.Struct, tag=True):
    """Publish a topic of a type such as `std_msgs/msg/String`."""

    number: int
    topic: str
    message: str
    reliable: bool
    latched: bool
    depth: int


class Read(Publish, tag=True):
    """Read a topic, and tell of its publishers."""


class Put(WithData, tag=True, kw_only=True, omit_defaults=True):
    """Publish a message."""

    number: int


class Close(msgspec.Struct, tag=True):
    """Stop publishing or reading a topic."""

    number: int


class Message(WithData, tag=True, kw_only=True):
    """A message that was read. `dropped` messages before it were dropped, because they were not processed in time."""

    number: int
    sent_ns: int
    dropped: int


class Publishes(msgspec.Struct, tag=True):
    """A node publishes a topic that is read; `definition` is the hash of its type, if the middleware tells it."""

    number: int
    node: str
    message: str
    definition: str


class Unopened(msgspec.Struct, tag=True):
    """A topic can't be published or read."""

    number: int
    cause: str


_Told: TypeAlias = FromHost | Message | Publishes | Unopened


@dataclass
class _OwnTopic:
    order: Publish
    form: MessageForm
    take: Take | None = None
    waiting: deque[bytes | bytearray] = field(default_factory=deque)
    """Messages that were not handed to the helper yet."""


class RosTopics:
    """A node, and its topics. Each fault is reported once by `tell`, in a thread of its own.

    `domain` None means that of ROS_DOMAIN_ID. If the helper ends, it is restarted with the same topics. Raises
    InputError if no Python with rclpy is found.
    """

    def __init__(self, node: str, tell: Callable[[str], None], *, domain: int | None = None) -> None:
        check_installed()
        self._name = checked_name(node, "node")
        self._python = _python_in(checked_domain(domain))
        self._once = Once(tell)
        self._topics: dict[int, _OwnTopic] = {}
        self._numbers = iter(range(1 << 31))
        self._orders: deque[msgspec.Struct] = deque()
        self._lock = threading.Lock()
        self._is_over = False
        self._waker, self._heard_bell = socket.socketpair()
        for end in (self._waker, self._heard_bell):
            end.setblocking(False)
        self._thread = threading.Thread(target=self._work, name="cfgplan-ros2", daemon=True)
        self._thread.start()

    def publisher(self, topic: str, form: MessageForm, quality: ServiceQuality, depth: int) -> RosPublisher:
        """Begin to publish a topic. Raises InputError."""
        return RosPublisher(self, self._begin(Publish, topic, form, quality, depth, None))

    def read(self, topic: str, form: MessageForm, quality: ServiceQuality, depth: int, take: Take) -> int:
        """Call `take` with each message of a topic; if `quality` is transient local, first with those kept by
        publishers.

        Returns the number by which `end` ends it. Raises InputError.
        """
        return self._begin(Read, topic, form, quality, depth, take)

    def put(self, number: int, message: bytes | bytearray) -> None:
        """Publish a message. Never blocks: if ROS does not take them in time, the oldest are dropped."""
        with self._lock:
            topic = self._topics.get(number)
            if topic is None:
                return
            is_full = len(topic.waiting) >= topic.order.depth
            if is_full:
                topic.waiting.popleft()
            topic.waiting.append(message)
        if is_full:
            self._once.tell(
                f"full {number}", f"{topic.order.topic}: messages come faster than ROS takes them; some are lost"
            )
        self._ring()

    def end(self, number: int) -> None:
        """Stop publishing or reading a topic."""
        with self._lock:
            self._topics.pop(number, None)
            self._orders.append(Close(number))
        self._ring()

    def close(self) -> None:
        """End the node."""
        self._is_over = True
        self._ring()
        self._thread.join()
        self._waker.close()
        self._heard_bell.close()

    def _begin(
        self,
        kind: type[Publish],
        topic: str,
        form: MessageForm,
        quality: ServiceQuality,
        depth: int,
        take: Take | None,
    ) -> int:
        number = next(self._numbers)
        name = checked_name(topic, "topic")
        order = kind(number, name, form.type.ros2, quality.reliable, quality.transient_local, depth)
        with self._lock:
            self._topics[number] = _OwnTopic(order, form, take)
            self._orders.append(order)
        self._ring()
        return number

    def _ring(self) -> None:
        with suppress(OSError):  # it is set already, or closed
            self._waker.send(b"\0")

    def _work(self) -> None:
        while not self._is_over:
            try:
                link: HostLink[_Told] = HostLink(self._python, self._name, _Told)
            except OSError as error:
                self._once.tell("start", f"the Python of ROS can't be started: {error}")
            else:
                with self._lock:
                    self._orders = deque(topic.order for topic in self._topics.values())
                self._serve(link)
                status = link.close()
                if self._is_over:
                    return
                words = f": {link.last_words}" if link.last_words else ""
                self._once.tell("end", f"the ROS 2 helper has ended ({status}) and is started again{words}")
            until = time.monotonic() + _ANEW_S
            while not self._is_over and time.monotonic() < until:
                time.sleep(_ANEW_S / 20)

    def _serve(self, link: HostLink[_Told]) -> None:
        """Carry messages in both directions until the helper ends, or the node is closed."""
        with selectors.DefaultSelector() as selector:
            selector.register(self._heard_bell, selectors.EVENT_READ)
            selector.register(link.socket, selectors.EVENT_READ)
            while not (self._is_over or link.has_ended):
                wanted = selectors.EVENT_READ | (selectors.EVENT_WRITE if link.is_waiting else 0)
                selector.modify(link.socket, wanted)
                selector.select(_TURN_S)
                with suppress(BlockingIOError):
                    while self._heard_bell.recv(4096):
                        pass
                for message in link.hear():
                    self._understand(message)
                self._send(link)
            until = time.monotonic() + _LAST_S
            while not link.has_ended and (link.is_waiting or self._has_more()) and time.monotonic() < until:
                selector.modify(link.socket, selectors.EVENT_READ | selectors.EVENT_WRITE)
                selector.select(_LAST_S)
                for _ in link.hear():
                    pass
                self._send(link)

    def _has_more(self) -> bool:
        return bool(self._orders) or any(topic.waiting for topic in self._topics.values())

    def _send(self, link: HostLink[_Told]) -> None:
        """Send waiting messages to the helper, as far as it takes them."""
        while not link.is_waiting:
            with self._lock:
                if self._orders:
                    order: msgspec.Struct = self._orders.popleft()
                    data: bytes | bytearray = b""
                else:
                    topic = next((one for one in self._topics.values() if one.waiting), None)
                    if topic is None:
                        return
                    data = topic.waiting.popleft()
                    order = Put(number=topic.order.number, size=len(data))
            link.send(order, data)

    def _understand(self, message: _Told) -> None:
        if not isinstance(message, Message | Publishes | Unopened):
            return
        topic = self._topics.get(message.number)
        if topic is None:
            return
        name = topic.order.topic
        match message:
            case Message(data=data, sent_ns=sent_ns, dropped=dropped):
                if dropped:
                    self._once.tell(
                        f"dropped {name}", f"{name}: messages come faster than they are taken; some are lost"
                    )
                assert topic.take is not None
                topic.take(data, sent_ns)
            case Publishes():
                self._once.tell(*_unlike(message, topic))
            case Unopened(cause=cause):
                self._once.tell(f"type {cause}", f"{name}: {cause}")


class RosPublisher:
    """A topic that a node publishes, until it is closed or its node is."""

    def __init__(self, topics: RosTopics, number: int) -> None:
        self._topics, self._number = topics, number

    def put(self, message: bytes | bytearray) -> None:
        """Publish a message in CDR."""
        self._topics.put(self._number, message)

    def close(self) -> None:
        """Stop publishing the topic."""
        self._topics.end(self._number)


def check_installed() -> None:
    """Raise InputError, which names the extra, if what ROS 2 topics need is not installed."""
    needed("ROS 2 topics", "rosbags")


def checked_name(name: str, what: str) -> str:
    """Return a name with its namespace, from the root. Raises InputError if ROS 2 does not allow it."""
    parts = name.removeprefix("/").split("/")
    if not all(map(_ROS_NAME.fullmatch, parts)):
        mend = "it is made of letters, digits and underscores, each part after a `/`, none with a digit first"
        raise InputError.of(f"`{name}` can't be the name of a ROS 2 {what}", mend=mend)
    return "/" + "/".join(parts)


def checked_domain(domain: int | None = None) -> int:
    """Return a domain; for None, that of ROS_DOMAIN_ID. Raises InputError for a number that is no domain."""
    said = str(domain) if domain is not None else os.environ.get("ROS_DOMAIN_ID") or "0"
    if not said.isdecimal() or int(said) > LARGEST_DOMAIN:
        raise InputError.of(f"`{said}` is not a domain of ROS 2", mend=f"write a number from 0 to {LARGEST_DOMAIN}")
    return int(said)


def _python_in(domain: int) -> RosPython:
    python = ros_python(is_known=VARIABLE in os.environ)
    return replace(python, environment={**python.environment, "ROS_DOMAIN_ID": str(domain)})


def _unlike(told: Publishes, topic: _OwnTopic) -> tuple[str, str]:
    """The type or hash of a publisher that differs from that of the topic, and a sentence about it; both empty without
    a difference.
    """
    name, form = topic.order.topic, topic.form
    who = f"{name}: {told.node} publishes {told.message}"
    if told.message != form.type.ros2:
        return f"{name} {told.message}", f"{who}, which does not come as {form.type}"
    if told.definition.startswith("RIHS") and told.definition != form.type_hash:
        mend = "name its ROS by `distribution`, or the definition that it has by `definitions`"
        return f"{name} {told.definition}", f"{who} of another definition ({told.definition}): {mend}"
    return "", ""
