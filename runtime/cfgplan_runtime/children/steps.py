"""Grouping the elements that have come into steps: the inputs of one call of unit code."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from cfgplan_runtime.streams.element import Element, Moment


@dataclass(frozen=True, slots=True)
class Step:
    """The elements of one step by input port, and the newest moment among those that started it."""

    elements: Mapping[str, Element]
    moment: Moment


class StepQueue:
    """Elements that wait for their step.

    `start` is `all` (one fresh element of each port, oldest first), `any` (each element of any port, with
    the latest of the others), `aligned` (elements of one time, give or take `tolerance_ns`; what finds
    no partner is skipped), or a port's name (each element of that port, with the latest of the others).
    No step starts before every port has had an element, but `optional` ones and `services`: a step has the latest of
    these, if there is any. Services start none, and optional ports only with `any`, by name, or if there are no others.
    """

    def __init__(
        self,
        ports: Sequence[str],
        *,
        start: str,
        tolerance_ns: int,
        limit: int,
        optional: Sequence[str] = (),
        services: Sequence[str] = (),
    ) -> None:
        self._loose = {*optional, *services}
        if ports and self._loose.issuperset(ports) and start in ("all", "aligned"):
            start = "any"
        starting = {*optional} - {*services} if start == "any" else {start}
        self._waiting: dict[str, deque[Element]] = {
            port: deque() for port in ports if port not in self._loose or port in starting
        }
        self._latest: dict[str, Element] = {}
        self._start = start
        self._tolerance_ns = tolerance_ns
        self._limit = limit
        self.dropped = dict.fromkeys(ports, 0)
        """How many elements were dropped for want of room, by port."""
        self.skipped = dict.fromkeys(ports, 0)
        """How many elements found no partner of their time, by port."""

    def waiting(self, port: str) -> int:
        """The number of elements that wait at a port."""
        return len(self._waiting.get(port, ()))

    def is_full(self, port: str) -> bool:
        return self.waiting(port) >= self._limit

    def forget(self, port: str) -> None:
        """Forget the latest element of an optional port or a service that has lost its source."""
        if port in self._loose:
            self._latest.pop(port, None)

    def put(self, port: str, element: Element, *, may_drop: bool) -> None:
        """Add an element; the oldest of its port is dropped if there is no room and `may_drop`."""
        waiting = self._waiting.get(port)
        if waiting is None:
            self._latest[port] = element
            return
        waiting.append(element)
        if self._start not in ("all", "aligned", "any", port):
            self._latest[port] = waiting.pop()
        elif may_drop and len(waiting) > self._limit:
            waiting.popleft()
            self.dropped[port] += 1

    def next(self) -> Step | None:
        """Remove and return the next step; None if none can start."""
        if self._start == "all":
            return self._one_of_each() if all(self._waiting.values()) else None
        if self._start == "aligned":
            return self._aligned()
        if self._start == "any":
            ready = [(waiting[0].moment, port) for port, waiting in self._waiting.items() if waiting]
            return self._with_latest(min(ready)[1]) if ready else None
        return self._with_latest(self._start)

    def _one_of_each(self) -> Step:
        elements = {port: waiting.popleft() for port, waiting in self._waiting.items()}
        return Step(self._latest | elements, max(element.moment for element in elements.values()))

    def _aligned(self) -> Step | None:
        while all(self._waiting.values()):
            newest = max(waiting[0].time_ns for waiting in self._waiting.values())
            late = [port for port, w in self._waiting.items() if w[0].time_ns < newest - self._tolerance_ns]
            if not late:
                return self._one_of_each()
            for port in late:
                self._waiting[port].popleft()
                self.skipped[port] += 1
        return None

    def _with_latest(self, port: str) -> Step | None:
        if not self._waiting[port]:
            return None
        others = [name for name in self._waiting if name != port and name not in self._loose]
        if any(name not in self._latest for name in others):
            if self._start == "any":
                self._latest_of_first_elements(others)
            if any(name not in self._latest for name in others):
                return None
        element = self._waiting[port].popleft()
        self._latest[port] = element
        return Step(dict(self._latest), element.moment)

    def _latest_of_first_elements(self, ports: Sequence[str]) -> None:
        """Before the first step, count the first waiting element of each port as its latest."""
        for port in ports:
            if port not in self._latest and self._waiting[port]:
                self._latest[port] = self._waiting[port][0]
