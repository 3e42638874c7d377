"""Names and filters of MQTT's topics, and last wills."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from cfgplan.errors import InputError


def topic_filter(topic: str) -> str:
    """A topic filter. Raises InputError."""
    levels = topic.split("/")
    is_right = bool(topic) and "\0" not in topic and all("+" not in level or level == "+" for level in levels)
    if not is_right or any("#" in level and (level != "#" or at < len(levels) - 1) for at, level in enumerate(levels)):
        mend = "`+` stands for one level, `#` for all levels that follow, each between slashes"
        raise InputError.of(f"`{topic}` is not a topic filter", mend=mend)
    return topic


def plain_topic(topic: str) -> str:
    """A topic that messages can be published on. Raises InputError."""
    if not _is_plain(topic):
        mend = "it is not empty, and has no wildcards (`+`, `#`)"
        raise InputError.of(f"`{topic}` is not a topic to publish on", mend=mend)
    return topic


def _is_plain(topic: object) -> bool:
    return isinstance(topic, str) and topic != "" and not any(mark in topic for mark in "+#\0")


def check_will(will: Mapping[str, Any]) -> None:
    """Raise InputError for a last will that no broker takes."""
    if not isinstance(will, Mapping) or set(will) - {"topic", "payload", "qos", "retain"}:
        raise InputError.of("`will` is a mapping with a topic", mend="it has topic, payload, qos and retain")
    if not _is_plain(will.get("topic")) or will.get("qos", 1) not in (0, 1, 2):
        mend = "write a topic without wildcards, and a qos of 0, 1 or 2"
        raise InputError.of("`will` has no topic to publish on, or no qos of MQTT", mend=mend)
    if not isinstance(will.get("payload", ""), str):
        raise InputError.of("the payload of `will` is a text", mend="write it in quotes")
