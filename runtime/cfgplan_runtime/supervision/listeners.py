"""Listeners of events. If a listener raises, this is reported once, and it is still called."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable
from typing import Generic, TypeVar

LOG = logging.getLogger("cfgplan")

News = TypeVar("News")


class Listeners(Generic[News]):
    """Functions that are called with each event, in order. If one raises, the others are still called."""

    def __init__(self, listeners: Iterable[Callable[[News], None]] = ()) -> None:
        self._listeners = tuple(listeners)
        self._failed: set[Callable[[News], None]] = set()

    def add(self, listener: Callable[[News], None]) -> None:
        """Call this function too, from the next news on."""
        self._listeners = (*self._listeners, listener)

    def tell(self, news: News) -> None:
        """Call all functions."""
        for listener in self._listeners:
            try:
                listener(news)
            except Exception:
                if listener not in self._failed:
                    self._failed.add(listener)
                    LOG.exception(
                        "%r has failed at %r; its next failures are not logged", listener, type(news).__name__
                    )
