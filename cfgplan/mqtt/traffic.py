"""The traffic heard from a broker: its topics, and the form of each topic's messages."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

from cfgplan.mqtt.discovery import DISCOVERY, Discovered, discovered

TopicForm = Literal["number", "json", "text", "bytes"]
"""The form of the values in a topic's messages."""
_CONFIG = "/config"
_SPARKPLUG = "spBv1.0/"
_MOST_FIELDS = 100


@dataclass(frozen=True, slots=True, order=True)
class HeardTopic:
    """A topic: the form of its messages, whether the broker keeps the last one, and how they came.

    `period_s` is the mean time from message to message; None with fewer than two that came live. `size` is a message's
    mean number of bytes, `fields` are the keys of messages that are mappings.
    """

    name: str
    form: TopicForm
    is_retained: bool
    period_s: float | None = None
    size: int = 0
    fields: tuple[str, ...] = ()


@dataclass(frozen=True)
class Traffic:
    """The topics of a broker by name, the content of its discovery messages, and its number of Sparkplug topics.

    `span_s` is for how long the broker was listened to; `notes` name messages that were missed.
    """

    broker: str
    span_s: float
    topics: tuple[HeardTopic, ...]
    discovered: Discovered
    sparkplug: int = 0
    notes: tuple[str, ...] = ()

    @property
    def is_empty(self) -> bool:
        """Return whether nothing came."""
        told = self.discovered
        return not (self.topics or told.entities or told.commands or told.unread or self.sparkplug)


class TrafficCollector:
    """Collects messages one by one for a `Traffic`."""

    def __init__(self) -> None:
        self._topics: dict[str, _Topic] = {}
        self._discovery: dict[str, bytes] = {}
        self._sparkplug: set[str] = set()

    def take(self, topic: str, payload: bytes, *, is_retained: bool, time_s: float) -> None:
        """Take a message. An empty payload means that a retained message was deleted."""
        if topic.startswith(_SPARKPLUG):
            self._sparkplug.add(topic)
        elif topic.startswith(DISCOVERY) and topic.endswith(_CONFIG):
            self._discovery[topic] = payload
        elif payload:
            self._topics.setdefault(topic, _Topic()).take(payload, is_retained=is_retained, time_s=time_s)

    def traffic(
        self, broker: str, span_s: float, is_asked: Callable[[str], bool] = lambda _: True, notes: tuple[str, ...] = ()
    ) -> Traffic:
        """Return the traffic of all messages taken, with the described topics that `is_asked` accepts."""
        topics = tuple(each.heard(name) for name, each in sorted(self._topics.items()))
        told = discovered({topic: payload for topic, payload in self._discovery.items() if payload})
        told = replace(told, entities=tuple(entity for entity in told.entities if is_asked(entity.topic)))
        return Traffic(broker, span_s, topics, told, len(self._sparkplug), notes)


class _Topic:
    """Counts and forms of one topic's messages so far."""

    def __init__(self) -> None:
        self._forms: set[TopicForm] = set()
        self._fields: dict[str, None] = {}
        self._number = self._live = self._bytes = 0
        self._is_retained = False
        self._first_s = self._last_s = 0.0

    def take(self, payload: bytes, *, is_retained: bool, time_s: float) -> None:
        if not is_retained or self._number:  # the first retained message may be an old one
            self._first_s, self._last_s = (self._first_s if self._live else time_s), time_s
            self._live += 1
        self._number += 1
        self._bytes += len(payload)
        self._is_retained |= is_retained
        form, fields = _looks(payload)
        self._forms.add(form)
        if len(self._fields) < _MOST_FIELDS:
            self._fields.update(dict.fromkeys(fields))

    def heard(self, name: str) -> HeardTopic:
        apart_s = self._last_s - self._first_s
        period_s = apart_s / (self._live - 1) if self._live > 1 and apart_s > 0 else None
        return HeardTopic(name, self._form, self._is_retained, period_s, self._bytes // self._number, (*self._fields,))

    @property
    def _form(self) -> TopicForm:
        """The form of all messages, or the form that covers all of theirs."""
        if len(self._forms) == 1:
            return next(iter(self._forms))
        if "bytes" in self._forms:
            return "bytes"
        return "text" if "text" in self._forms else "json"


def _looks(payload: bytes) -> tuple[TopicForm, tuple[str, ...]]:
    """The form of a message, and the keys of one that is a mapping."""
    try:
        text = payload.decode()
    except UnicodeDecodeError:
        return "bytes", ()
    if "\0" in text:
        return "bytes", ()
    try:
        if math.isfinite(float(payload)):
            return "number", ()
    except ValueError:
        pass
    try:
        value = json.loads(text)
    except (ValueError, RecursionError):
        return "text", ()
    return "json", tuple(map(str, value)) if isinstance(value, dict) else ()
