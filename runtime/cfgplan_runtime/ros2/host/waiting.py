"""The helper's one wait: for messages, replies, requests, events of endpoints, and timers."""

from __future__ import annotations

import heapq
import itertools
import time
from collections.abc import Callable
from typing import Any

from rclpy.impl.implementation_singleton import rclpy_implementation

KINDS = ("subscription", "guard_condition", "timer", "client", "service", "event")
"""The kinds of entities, in the order in which a wait set wants their numbers."""
_LONGEST_S = 3600.0


class Waiting:
    """One thread's wait for entities of a context: handles of rclpy's objects, and its event handlers."""

    def __init__(self, context: Any) -> None:
        self._context = context
        self._calls: dict[str, dict[Any, Callable[[], None]]] = {kind: {} for kind in KINDS}
        self._times: list[tuple[float, int, Callable[[], None]]] = []
        self._serial = itertools.count()
        self._set: Any = None

    def watch(self, kind: str, handle: Any, call: Callable[[], None]) -> None:
        """Call whenever an entity is ready."""
        self._calls[kind][handle] = call
        self._set = None

    def unwatch(self, kind: str, handle: Any) -> None:
        """Forget an entity, before it is destroyed."""
        if self._calls[kind].pop(handle, None) is not None:
            self._set = None

    def later(self, seconds: float, call: Callable[[], None]) -> None:
        """Call once, after so many seconds."""
        heapq.heappush(self._times, (time.monotonic() + seconds, next(self._serial), call))

    def wait(self) -> None:
        """Wait until something is ready or due, then call what belongs to it."""
        if self._set is None:
            numbers = [len(self._calls[kind]) for kind in KINDS]
            self._set = rclpy_implementation.WaitSet(*numbers, self._context.handle)
        self._set.clear_entities()
        for kind in KINDS[:-1]:
            add = getattr(self._set, f"add_{kind}")
            for handle in self._calls[kind]:
                add(handle)
        for event in self._calls["event"]:
            event.add_to_wait_set(self._set)
        due_s = self._times[0][0] - time.monotonic() if self._times else _LONGEST_S
        self._set.wait(max(0, int(due_s * 1e9)))
        for kind, handle, call in self._ready():
            if self._calls[kind].get(handle) is call:  # the call of another one may have ended it
                call()
        while self._times and self._times[0][0] <= time.monotonic():
            heapq.heappop(self._times)[2]()

    def _ready(self) -> list[tuple[str, Any, Callable[[], None]]]:
        found = []
        for event, call in self._calls["event"].items():
            if event.is_ready(self._set):
                event.take_data()
                found.append(("event", event, call))
        for kind in KINDS[:-1]:
            if self._calls[kind]:
                pointers = set(self._set.get_ready_entities(kind))
                found += [(kind, one, call) for one, call in self._calls[kind].items() if one.pointer in pointers]
        return found
