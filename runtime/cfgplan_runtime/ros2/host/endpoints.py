"""The helper's ends of topics: subscriptions to the outputs of nodes, and publishers for their inputs."""

from __future__ import annotations

import struct
from collections.abc import Callable
from importlib import import_module
from typing import Any, NamedTuple

from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks

from cfgplan_runtime.nodes.message_layout import Layout, kind_of
from cfgplan_runtime.ros2.host.host import Host
from cfgplan_runtime.ros2.host.qos import Quality, asked_of, offered_to
from cfgplan_runtime.streams.element import Moment

_LITTLE, _BIG = struct.Struct("<iI"), struct.Struct(">iI")
"""The stamp of a message that begins with a header, behind four bytes that tell the order of bytes."""
_STAMP_AT = 4
_DEPTH = 256
"""So many messages may wait to be taken from a topic."""
_MOST_AT_ONCE = 10
"""So many messages of a topic are taken before others have their turn."""
_BACK_NS = 1_000_000_000
"""A stamp that is so much earlier than the last one begins a new time."""


class UnknownTypeError(Exception):
    """This Python can't import a message type."""


class Sample(NamedTuple):
    """A message as it came. `stamped` is its moment by its own stamp, `timed` by when it was sent."""

    raw: bytes
    source: Source
    stamped: Moment
    timed: Moment
    has_stamp: bool
    begins_anew: bool
    """Whether its stamp is much earlier than the one before."""


def message_class(kind: str) -> Any:
    """The class of a type such as `std_msgs/msg/String`. Raises UnknownTypeError."""
    module, _, name = kind.replace("/", ".").rpartition(".")
    try:
        return getattr(import_module(module), name)
    except (ImportError, AttributeError):
        package = kind.partition("/")[0]
        text = f"{kind} can't be imported by the Python of ROS: source the workspace that has {package}, or install it"
        raise UnknownTypeError(text) from None


def layout_of(cls: Any) -> Layout:
    """The layout of a message class. Raises UnknownTypeError for a type in it that can't be imported."""
    fields = cls.get_fields_and_field_types()
    inner = lambda name: layout_of(message_class(name.replace("/", "/msg/")))  # noqa: E731
    package = cls.__module__.partition(".")[0]
    return Layout(f"{package}/{cls.__name__}", {field: kind_of(text, inner) for field, text in fields.items()})


def begins_with_header(cls: Any) -> bool:
    """Whether the first field of a message is a header."""
    return next(iter(cls.get_fields_and_field_types().values()), "") == "std_msgs/Header"


def stamp_ns(raw: bytes) -> int:
    """The stamp of a message that begins with a header, in nanoseconds."""
    if len(raw) < _STAMP_AT + _LITTLE.size:
        return 0
    seconds, nanoseconds = (_LITTLE if raw[1] & 1 else _BIG).unpack_from(raw, _STAMP_AT)
    return int(seconds) * 1_000_000_000 + int(nanoseconds)


def risen(last: Moment, time_ns: int) -> Moment:
    """The moment of a time, after the last moment: moments rise along a stream."""
    return (time_ns, 0) if time_ns > last[0] else (last[0], last[1] + 1)


class Source:
    """A topic that the helper listens to; `offered` counts the messages that each wire got, and the lost ones.

    It is open once its type is known. `remembered` has the qualities of known ports by `key`: so the first message of a
    transformation's next node already arrives.
    """

    def __init__(self, host: Host, topic: str, remembered: dict[str, Quality], heard: Callable[[Sample], None]) -> None:
        self.topic, self._host, self._remembered, self._heard = topic, host, remembered, heard
        self.key, self.kind = topic, ""
        self.holders: set[str] = set()
        """Units that are attended and may publish here."""
        self.offered: dict[int, int] = {}
        self.quality = Quality()
        self.messages = 0
        self.latched: Sample | None = None
        """The last message of a latched topic, which inlets that come later get too."""
        self.ends: list[Any] = []
        """All publishers but this process's own, by the last look."""
        self._subscription: Any = None
        self._cls: Any = None
        self._made_kind = ""
        self._has_header = False
        self._layout: Layout | None = None
        self._stamped: Moment = (0, 0)
        self._timed: Moment = (0, 0)
        self._number: int | None = None
        self._is_one = False
        """Whether there is a single publisher: only then do numbers of messages tell of losses."""

    @property
    def is_open(self) -> bool:
        return self._subscription is not None

    @property
    def layout(self) -> Layout:
        """The layout of the messages of an open source. Raises UnknownTypeError for a type that can't be imported."""
        if self._layout is None:
            self._layout = layout_of(self._cls)
        return self._layout

    def look(self) -> None:
        """Listen such that all publishers are heard. Raises UnknownTypeError."""
        found = self._host.node.get_publishers_info_by_topic(self.topic)
        publishers = self.ends = [one for one in found if not self._host.is_own(one)]
        self._is_one = len(publishers) == 1
        if publishers:
            self.kind = publishers[0].topic_type
            self._remembered[self.key] = asked_of([one for one in publishers if one.topic_type == self.kind])
        quality = self._remembered.get(self.key, Quality())
        if self.kind and (self._subscription is None or quality != self.quality or self._made_kind != self.kind):
            self.quality = quality
            self._open()

    def take(self) -> None:
        """Take the messages that have come, and hand them on."""
        for _ in range(_MOST_AT_ONCE):
            taken = None if self._subscription is None else self._subscription.handle.take_message(self._cls, True)
            if taken is None:
                return
            raw, info = taken
            self.messages += 1
            self._count(info.get("publication_sequence_number"))
            sample = self._sample(raw, info["source_timestamp"])
            if self.quality.is_latched:
                self.latched = sample
            self._heard(sample)

    def close(self) -> None:
        if self._subscription is not None:
            self._host.waiting.unwatch("subscription", self._subscription.handle)
            for event in self._subscription.event_handlers:
                self._host.waiting.unwatch("event", event)
            self._host.node.destroy_subscription(self._subscription)
            self._subscription = None

    def _open(self) -> None:
        self._cls = message_class(self.kind)
        self._made_kind = self.kind
        self._has_header, self._layout = begins_with_header(self._cls), None
        self.close()
        self._number = None
        self._subscription = self._host.node.create_subscription(
            self._cls,
            self.topic,
            lambda _: None,
            self.quality.profile(_DEPTH),
            raw=True,
            event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False, **self._host.matched()),
        )
        self._host.waiting.watch("subscription", self._subscription.handle, self.take)
        for event in self._subscription.event_handlers:
            self._host.waiting.watch("event", event, self._host.note_match)

    def _count(self, number: int | None) -> None:
        """Count the messages that were lost since the last one, where the middleware numbers them."""
        lost = 0
        if number is not None and self._number is not None and self._is_one and number > self._number:
            lost = number - self._number - 1
        self._number = number
        self.offered = {wire: count + lost for wire, count in self.offered.items()}

    def _sample(self, raw: bytes, sent_ns: int) -> Sample:
        stamp = stamp_ns(raw) if self._has_header else 0
        begins_anew = 0 < stamp < self._stamped[0] - _BACK_NS
        self._stamped = (stamp, 0) if begins_anew else risen(self._stamped, stamp)
        self._timed = risen(self._timed, sent_ns)
        return Sample(raw, self, self._stamped, self._timed, stamp > 0, begins_anew)


class Publication:
    """A topic that only the helper publishes, for a unit's input or for the subscribers of a target's topic.

    `holders` are the inlets and attended units that need it. If the node requests another quality, a unit's own
    publication is replaced; replacing others would cost some subscribers messages.
    """

    def __init__(self, host: Host, topic: str, remembered: dict[str, Quality], *, is_own: bool) -> None:
        self.topic, self._host, self._remembered, self._is_own = topic, host, remembered, is_own
        self.key, self.kind = topic, ""
        self.depth = 1
        self.holders: set[str] = set()
        self.is_latched = False
        """Whether its source is latched."""
        self.ends: list[Any] = []
        """All subscriptions but this process's own, by the last look."""
        self._latched: bytes | None = None
        self._quality = Quality()
        self._publisher: Any = None
        self._made_kind = ""

    @property
    def is_open(self) -> bool:
        return self._publisher is not None

    def matches(self) -> int:
        """How many subscriptions the publisher is connected to."""
        return 0 if self._publisher is None else int(self._publisher.get_subscription_count())

    def look(self, *, turns: bool = False) -> None:
        """Publish such that all subscriptions hear it. Raises UnknownTypeError.

        With `turns` its source is another one, which may be of another type or latched.
        """
        found = self._host.node.get_subscriptions_info_by_topic(self.topic)
        subscriptions = self.ends = [one for one in found if not self._host.is_own(one)]
        if subscriptions:
            self._remembered[self.key] = offered_to(subscriptions, is_latched=False)
        wished = self._remembered.get(self.key, Quality())
        quality = wished._replace(is_latched=wished.is_latched or self.is_latched)
        if not self.kind or (self._publisher is not None and (quality, self.kind) == (self._quality, self._made_kind)):
            return
        if self._publisher is None or turns or self._is_own or not self.matches():
            self._open(quality)

    def publish(self, raw: bytes) -> None:
        if self._publisher is not None:
            self._publisher.publish(raw)
        if self.is_latched:
            self._latched = raw

    def close(self) -> None:
        if self._publisher is not None:
            for event in self._publisher.event_handlers:
                self._host.waiting.unwatch("event", event)
            self._host.node.destroy_publisher(self._publisher)
            self._publisher = None

    def _open(self, quality: Quality) -> None:
        cls = message_class(self.kind)
        self.close()
        if self._made_kind != self.kind:
            self._latched = None
        self._quality, self._made_kind = quality, self.kind
        self._publisher = self._host.node.create_publisher(
            cls,
            self.topic,
            quality.profile(1 if self.is_latched else self.depth),
            event_callbacks=PublisherEventCallbacks(use_default_callbacks=False, **self._host.matched()),
        )
        for event in self._publisher.event_handlers:
            self._host.waiting.watch("event", event, self._host.note_match)
        if self.is_latched and self._latched is not None:
            self._publisher.publish(self._latched)
