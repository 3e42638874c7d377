"""The manager's queue of items from any thread, in order of arrival."""

from __future__ import annotations

import threading
from collections import deque
from concurrent.futures import Future
from dataclasses import dataclass
from typing import TypeAlias

from cfgplan.domain import Statement
from cfgplan.errors import Fault
from cfgplan.facts import FactValue
from cfgplan_runtime.lifecycle.basis import Preview
from cfgplan_runtime.lifecycle.changes import Change
from cfgplan_runtime.lifecycle.reports import Review
from cfgplan_runtime.supervision.events import Event

Outcome: TypeAlias = "Future[Review | None]"


@dataclass(frozen=True, slots=True)
class Asked:
    """A request for a change; its future is done when the review of the change is over."""

    change: Change
    outcome: Outcome


@dataclass(frozen=True, slots=True)
class Unusable:
    """The world's file has errors; without faults, it is valid again."""

    by: str
    faults: tuple[Fault, ...]


@dataclass(frozen=True, slots=True)
class OldCode:
    """The units, perhaps none, that run with other code than `file` has now."""

    file: str
    units: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class FactSeen:
    """A stream carries the value of a fact, whose key is `name`."""

    name: str
    value: FactValue


@dataclass(frozen=True, slots=True)
class QualityTold:
    """A topic tells the quality of an output, in units of the attribute."""

    statement: Statement
    value: float


@dataclass(frozen=True, slots=True)
class PreviewAsked:
    """A request for a preview of a review."""

    outcome: Future[Preview]


@dataclass(frozen=True, slots=True)
class Leave:
    """The manager has to end, and to leave the units to the middleware."""


Item: TypeAlias = Event | Asked | FactSeen | QualityTold | PreviewAsked | Unusable | OldCode | Leave


@dataclass(frozen=True, slots=True)
class Arrival:
    """An item, and when it came in."""

    at_s: float
    item: Item


class Inbox:
    """A queue whose `waker` is set when an urgent item comes."""

    def __init__(self) -> None:
        self.waker = threading.Event()
        self._lock = threading.Lock()
        self._arrivals: deque[Arrival] = deque()

    def put(self, item: Item, at_s: float, *, is_urgent: bool = True) -> None:
        with self._lock:
            self._arrivals.append(Arrival(at_s, item))
            if is_urgent:
                self.waker.set()

    def take(self) -> Arrival | None:
        """Remove and return the first arrival; if there is none, clear `waker` and return None."""
        with self._lock:
            if self._arrivals:
                return self._arrivals.popleft()
            self.waker.clear()
            return None

    @property
    def is_empty(self) -> bool:
        return not self._arrivals
