"""The seam between the engine and whatever sets semantic subscriptions up: the manager of Figure 1."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from typing import Any, Protocol

from cfgplan.domain import Target


class Sample(Protocol):
    """An element of a stream."""

    @property
    def value(self) -> Any: ...

    @property
    def time_ns(self) -> int:
        """When it was made, in nanoseconds since 1970."""


class Samples(Protocol):
    """A topic's elements, until the stream ends.

    Iterating raises TimeoutError where none has come for a while, and may go on after that.
    """

    def __iter__(self) -> Iterator[Sample]: ...


class Subscriptions(Protocol):
    """Sets targets up, keeps them up, and takes them down."""

    def add(self, targets: Sequence[Target]) -> None:
        """Have targets met from now on; returns when that was tried. Raises InputError for a tag that can't be used."""

    def unmet(self, labels: Sequence[str]) -> Mapping[str, str]:
        """The reason for each of these targets that is not met now."""

    def remove(self, labels: Sequence[str]) -> None:
        """Nobody wants these targets any more: units that only they needed are stopped."""

    def samples(self, topic: str, wait_s: float) -> AbstractContextManager[Samples]:
        """Subscribe to a topic, waiting for it to be there. Raises NoSuchTopicError."""

    def listen(self, tell: Callable[[str], None]) -> None:
        """Have `tell` called, from any thread, with what happens to the subscriptions, in words."""
