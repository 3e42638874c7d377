"""Names of topics: those of taps, and the message for a topic that is not published."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from cfgplan.errors import did_you_mean
from cfgplan.summary import some

TAPS: Final = "/cfgplan/taps/"
"""The prefix of the topics of taps; the tapped stream follows."""


def is_tap(topic: str) -> bool:
    """Whether a topic is that of a tap."""
    return topic.startswith(TAPS)


def not_published(topic: str, published: Iterable[str]) -> str:
    """Return the message for a topic that is not published. It lists the published topics, except those of taps."""
    there = sorted({name for name in published if not is_tap(name)})
    known = f"there is {some(there) if there else 'no topic at all'}"
    return f"nothing publishes topic {topic!r}; {did_you_mean(topic, there, known)}"
