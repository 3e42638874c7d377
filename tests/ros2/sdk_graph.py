"""What the SDK tells of the graph. Under load it may miss some at one look, so all is waited for."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, TypeVar

from operated_world import eventually
from zenoh_ros2_sdk import get_topic_info

T = TypeVar("T")


def at_last(look: Callable[[], T], is_right: Callable[[T], object] = bool) -> T:
    """What is seen at the first look at which it is right."""
    seen: list[T] = []

    def looked() -> object:
        seen.append(look())
        return is_right(seen[-1])

    eventually(looked)
    return seen[-1]


def ends(topic: str, router_port: int) -> Any:
    """The topic's `publishers` and `subscribers` with type, hash and quality of service."""
    told = get_topic_info(topic, 0, router_port=router_port, verbose=True)
    return SimpleNamespace(publishers=[], subscribers=[]) if told is None else told
