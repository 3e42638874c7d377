"""Unit code for ROS 2 topics: a source that subscribes to a topic, and a sink that publishes the elements
of its input.
"""

from __future__ import annotations

import re
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Literal

import msgspec

from cfgplan.domain import Transformation
from cfgplan.errors import Fault, InputError
from cfgplan.ros.qos import ServiceQuality
from cfgplan.ros.types import MessageType
from cfgplan_runtime.children.unit_code import At
from cfgplan_runtime.errors import EncodingError
from cfgplan_runtime.outside.mailbox import Mailbox
from cfgplan_runtime.outside.once import Once
from cfgplan_runtime.outside.units import ORDERS_LOOK_S, only_value, say
from cfgplan_runtime.ros2.definitions import Definitions
from cfgplan_runtime.ros2.message_form import MessageForm, MisfitError
from cfgplan_runtime.ros2.topics import RosTopics, check_installed, checked_domain, checked_name

SUBSCRIBER, PUBLISHER = "cfgplan_runtime.ros2:Subscriber", "cfgplan_runtime.ros2:Publisher"
_MOST_DEPTH = 100_000


class PublisherParams(msgspec.Struct, forbid_unknown_fields=True):
    """The params of a `Publisher`, and those that a `Subscriber` has too."""

    topic: str
    type: str
    reliability: Literal["reliable", "best_effort"] = "reliable"
    durability: Literal["volatile", "transient_local"] = "volatile"
    depth: int = 10
    """The number of messages that a subscriber keeps until they are processed; with transient local, the number that
    late subscribers get.
    """
    node: str | None = None
    """The name of the node; by the topic's if None."""
    domain: int | None = None
    """ROS_DOMAIN_ID if None."""
    definitions: str | list[str] = []
    distribution: str | None = None
    """ROS_DISTRO if None; see `Definitions`."""

    @property
    def quality(self) -> ServiceQuality:
        return ServiceQuality(self.reliability == "reliable", self.durability == "transient_local")

    def check(self) -> None:
        """Raise InputError for names and numbers that ROS 2 does not allow."""
        checked_name(self.topic, "topic")
        if self.node is not None:
            checked_name(self.node, "node")
        checked_domain(self.domain)
        if not 1 <= self.depth <= _MOST_DEPTH:
            raise InputError.of(f"`{self.depth}` can't be the depth of a topic", mend=f"it is from 1 to {_MOST_DEPTH}")

    def form(self, folder: Path | None = None) -> MessageForm:
        """The form of the topic's messages; `folder` is what `definitions` is relative to. Raises InputError."""
        files = [self.definitions] if isinstance(self.definitions, str) else self.definitions
        return Definitions(self.distribution, files, folder).form(MessageType.read(self.type))

    def open(self) -> RosTopics:
        """Start a node that prints its faults. Raises InputError."""
        return RosTopics(self.node or f"cfgplan_{re.sub('/+', '_', self.topic.strip('/'))}", say, domain=self.domain)


class SubscriberParams(PublisherParams):
    """The params of a `Subscriber`."""

    stamp: Literal["received", "source", "header"] = "received"
    """The time of an element: its arrival, its publication, or the stamp of its header."""


class Subscriber:
    """A source: gives the messages of a ROS 2 topic as mappings from field to value. Raises InputError."""

    def __init__(self, **params: object) -> None:
        self._params = _read(params, SubscriberParams)
        self._form = self._params.form()

    def __iter__(self) -> Iterator[Any]:
        mailbox: Mailbox[tuple[bytes, int]] = Mailbox(self._params.depth)
        topics = self._params.open()
        try:
            quality, depth = self._params.quality, self._params.depth
            topics.read(self._params.topic, self._form, quality, depth, lambda *letter: mailbox.put(letter))
            yield from self._values(mailbox)
        finally:
            topics.close()

    def _values(self, mailbox: Mailbox[tuple[bytes, int]]) -> Iterator[Any]:
        topic, once = self._params.topic, Once(say)
        while True:
            letter = mailbox.take(ORDERS_LOOK_S)
            if mailbox.dropped:
                once.tell("dropped", f"{topic}: messages come faster than they are taken, and the oldest are dropped")
            if letter is None:
                yield None
                continue
            data, time_ns = letter
            try:
                value = self._form.decode(data)
            except EncodingError as error:
                once.tell("unread", f"{topic}: {error}")
                continue
            yield self._timed(value, time_ns)

    def _timed(self, value: dict[str, Any], time_ns: int) -> object:
        if self._params.stamp == "header" and "stamp" in (header := value.get("header", {})):
            return At(header["stamp"]["sec"] * 10**9 + header["stamp"]["nanosec"], value)
        return value if self._params.stamp == "received" else At(time_ns, value)


class Publisher:
    """A sink: publishes each value that comes at its one input as a message. Raises InputError."""

    def __init__(self, **params: object) -> None:
        self._params = _read(params, PublisherParams)
        self._form = self._params.form()
        self._once = Once(say)
        self._topics = self._params.open()
        self._topic = self._topics.publisher(self._params.topic, self._form, self._params.quality, self._params.depth)

    def __call__(self, **inputs: object) -> None:
        value = only_value(inputs)
        try:
            self._topic.put(self._form.encode(value, time.time_ns()))
        except MisfitError as error:
            self._once.tell(error.path, f"{self._params.topic}: {error}")

    def close(self) -> None:
        """Publish waiting messages, and end the node."""
        self._topics.close()


def check_unit(transformation: Transformation, folder: Path) -> None:
    """Raise InputError if a transformation with a source of this module can't be started with its parameters."""
    params_of = {SUBSCRIBER: SubscriberParams, PUBLISHER: PublisherParams}.get(transformation.source or "")
    if params_of is None:
        return
    check_installed()
    given, taken = len(transformation.outputs), len(transformation.inputs)
    is_source = params_of is SubscriberParams
    try:
        if (taken, given) != ((0, 1) if is_source else (1, 0)):
            ports = "no input and one output" if is_source else "one input and no output"
            raise InputError.of(f"a {(transformation.source or '').rpartition(':')[2]} has {ports}")
        _read(dict(transformation.params), params_of).form(folder)
    except InputError as error:
        raise InputError(
            Fault(f"{transformation.label}: {fault.message}", fault.file, mend=fault.mend) for fault in error.faults
        ) from None


def _read(params: Mapping[str, object], kind: type[Any]) -> Any:
    try:
        read = msgspec.convert(params, kind)
    except msgspec.ValidationError as error:
        there = ", ".join(kind.__struct_fields__)
        raise InputError.of(f"params of a ROS 2 topic: {error}", mend=f"they are {there}") from None
    read.check()
    return read
