"""The manager's queue: what has come in, from any thread, in order."""

from __future__ import annotations

import threading
from collections import deque
from concurrent.futures import Future
from dataclasses import dataclass
from typing import TypeAlias

from cfgplan.errors import Fault
from cfgplan.facts import FactValue
from cfgplan_runtime.lifecycle.basis import Preview
from cfgplan_runtime.lifecycle.changes import Change
from cfgplan_runtime.lifecycle.reports import Review
from cfgplan_runtime.supervision.events import Event

Outcome: TypeAlias = "Future[Review | None]"


@dataclass(frozen=True, slots=True)
class Asked:
    """Somebody asks for a change, and is told when the review that took it in is over."""

    change: Change
    outcome: Outcome


@dataclass(frozen=True, slots=True)
class Unusable:
    """The world's file can't be used as it is now; without faults, it can again."""

    by: str
    faults: tuple[Fault, ...]


@dataclass(frozen=True, slots=True)
class FactSeen:
    """A stream says the value of a fact of the world."""

    name: str
    value: FactValue


@dataclass(frozen=True, slots=True)
class PreviewAsked:
    """Somebody asks what a review would do now."""

    outcome: Future[Preview]


@dataclass(frozen=True, slots=True)
class Leave:
    """The manager is to end, and to leave the units to the middleware."""


Item: TypeAlias = Event | Asked | FactSeen | PreviewAsked | Unusable | Leave


@dataclass(frozen=True, slots=True)
class Arrival:
    """An item, and when it came in."""

    at_s: float
    item: Item


class Inbox:
    """A queue with a bell that rings when something comes that can't wait."""

    def __init__(self) -> None:
        self.bell = threading.Event()
        self._lock = threading.Lock()
        self._arrivals: deque[Arrival] = deque()

    def put(self, item: Item, at_s: float, *, is_urgent: bool = True) -> None:
        with self._lock:
            self._arrivals.append(Arrival(at_s, item))
            if is_urgent:
                self.bell.set()

    def take(self) -> Arrival | None:
        """Remove and return the first arrival; silence the bell and return None if there is none."""
        with self._lock:
            if self._arrivals:
                return self._arrivals.popleft()
            self.bell.clear()
            return None

    @property
    def is_empty(self) -> bool:
        return not self._arrivals
