"""Watching a runtime from outside."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

from cfgplan_runtime import Received, Runtime, subscribe
from cfgplan_runtime.supervision.events import Event
from world import PATIENCE_S

StartRuntime = Callable[..., Runtime]
"""Starts a runtime of a library."""


class Listener:
    """Collects what comes on a topic, in a thread."""

    def __init__(self, topic: str) -> None:
        self.received: list[Received] = []
        self.subscription = subscribe(topic, wait_s=PATIENCE_S)
        self._thread = threading.Thread(target=self._collect, daemon=True)
        self._thread.start()

    @property
    def values(self) -> list[Any]:
        return [received.value for received in self.received]

    def join(self) -> None:
        """Wait for the end of the run."""
        self._thread.join(PATIENCE_S)
        assert not self._thread.is_alive()

    def _collect(self) -> None:
        self.received.extend(self.subscription)


def seen(runtime: Runtime, kind: type[Event]) -> list[Any]:
    """The events of a kind that a runtime has reported so far; they stay to be seen."""
    return [event for event in list(runtime.events.queue) if isinstance(event, kind)]
