"""Grouping the elements that have come into steps: the inputs of one call of unit code."""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter

from cfgplan.rows import ALL
from cfgplan_runtime.children.messages import GivenElement, GivenInput
from cfgplan_runtime.streams.element import Element, Moment
from cfgplan_runtime.streams.inlet import port_of, slot


@dataclass(frozen=True, slots=True)
class Step:
    """The elements of one step by input port, and the newest moment among those that started it.

    A port that takes several streams has a list, in order of time.
    """

    elements: Mapping[str, Element | list[Element]]
    moment: Moment


class StepQueue:
    """Elements that wait for their step.

    `start` is `all` (a new element of each port, oldest first), `any` (each element of any port, with the latest of the
    others), `aligned` (elements of equal time, give or take `tolerance_ns`; elements without partners are skipped), or
    a port's name (each element of that port, with the latest of the others). The first step starts once every port has
    had an element, except `optional` ones and `services`: a step has their latest element, if they had one. Services
    start no step, and optional ports only with `any`, by name, or if all ports are optional.

    `counts` has the ports that take several streams, each with an inlet for every stream. A port that takes k streams
    acts as k ports. A port that takes ALL acts as a port for each of its streams that has an element; `all` waits for
    only one of these.
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
        counts: Mapping[str, int] | None = None,
    ) -> None:
        loose = {*optional, *services}
        if ports and loose.issuperset(ports) and start in ("all", "aligned"):
            start = "any"
        if start in ("all", "aligned"):
            starting = {*ports} - loose
        else:
            starting = {*ports}.difference(services) if start == "any" else {start}
        counts = counts or {}
        self._slots = {port: [slot(port, 1 + n) for n in range(count)] for port, count in counts.items()}
        """The inlets of each port that takes several streams; a port that takes all gets them as streams come."""
        self._waiting: dict[str, deque[Element]] = {}
        self._latest: dict[str, Element] = {}
        self._open = {port for port, count in counts.items() if count == ALL}
        self._needed: list[str] = []
        self.inlets: list[str] = []
        """The inlets that exist from the beginning."""
        for port in ports:
            for inlet in self._slots.get(port, (port,)):
                self.inlets.append(inlet)
                if port in starting:
                    self._waiting[inlet] = deque()
                if port not in loose | self._open:
                    self._needed.append(inlet)
        self._needed_open = [self._slots[port] for port in self._open - loose]
        self._starting_open = self._open & starting
        self._loose = loose
        self._ended: set[str] = set()
        """Inlets without a source, to be forgotten once no element waits there."""
        self._start = start
        self._tolerance_ns = tolerance_ns
        self._limit = limit
        self.dropped = dict.fromkeys(ports, 0)
        """The number of elements dropped for lack of room, by port."""
        self.skipped = dict.fromkeys(ports, 0)
        """The number of elements without a partner of their time, by port."""

    def waiting(self, port: str) -> int:
        """The number of elements that wait at a port."""
        found = 0
        for inlet in self._slots.get(port, (port,)):
            found += len(self._waiting.get(inlet, ()))
        return found

    def is_full(self, inlet: str) -> bool:
        return len(self._waiting.get(inlet, ())) >= self._limit

    def forget(self, inlet: str) -> None:
        """Forget the latest element of an inlet that has lost its source, if steps go on without it."""
        port = port_of(inlet)
        if port in self._loose or port in self._open:
            self._latest.pop(inlet, None)
            if self._waiting.get(inlet):
                self._ended.add(inlet)
            elif port in self._open:
                self._waiting.pop(inlet, None)

    def put(self, inlet: str, element: Element, *, may_drop: bool) -> None:
        """Add an element. Without room the oldest of its inlet is dropped, if it `may_drop`."""
        waiting = self._waiting.get(inlet)
        if waiting is None:
            port = port_of(inlet)
            if port in self._open and inlet not in self._slots[port]:
                self._slots[port].append(inlet)
            if port not in self._starting_open:
                self._latest[inlet] = element
                return
            waiting = self._waiting[inlet] = deque()
        self._ended.discard(inlet)
        waiting.append(element)
        if may_drop and len(waiting) > self._limit:
            waiting.popleft()
            self.dropped[port_of(inlet)] += 1

    def given(self, inlet: str, last: Moment, until: Moment | None) -> GivenInput:
        """Return the place of an inlet, whose last element is `last`, with its elements up to `until`; None: all."""
        waiting = self._waiting.get(inlet, ())
        done = (waiting[0].time_ns, waiting[0].turn - 1) if waiting else last
        latest = self._latest.get(inlet)
        kept = [*([] if latest is None else [latest]), *waiting]
        if until is not None:
            kept = [one for one in kept if one.moment <= until]
        return GivenInput(done, [GivenElement(one.time_ns, one.turn, bytes(one.payload)) for one in kept])

    def clear(self) -> None:
        """Forget the elements that wait."""
        for waiting in self._waiting.values():
            waiting.clear()

    def rests_on(self, still: Collection[str]) -> bool:
        """Whether no step can begin before one of the inlets in `still` gets an element."""
        empty = {inlet for inlet in still if not self._waiting.get(inlet)}
        if self._start in ("all", "aligned"):
            return not empty.isdisjoint(self._needed) or any(
                inlets and empty.issuperset(inlets) for inlets in self._needed_open
            )
        return bool(empty) and empty.issuperset(self._waiting)

    def begin_at(self, inlet: str, done: Moment, elements: Iterable[Element]) -> list[Element]:
        """Go on from an inlet's place. Returns the elements after it, each once.

        The last one before it becomes the inlet's latest, if steps need that.
        """
        after = list[Element]()
        for element in elements:
            if element.moment > (after[-1].moment if after else done):
                after.append(element)
            elif element.moment <= done and (inlet not in self._waiting or self._start not in ("all", "aligned")):
                self._latest[inlet] = element
        return after

    def next(self) -> Step | None:
        """Remove and return the next step; None if none can start."""
        if self._start == "all":
            return self._one_of_each() if self._has_needed(self._waiting) else None
        if self._start == "aligned":
            return self._aligned()
        ready = [(waiting[0].moment, inlet) for inlet, waiting in self._waiting.items() if waiting]
        return self._with_latest(min(ready)[1]) if ready else None

    def _has_needed(self, found: Mapping[str, object]) -> bool:
        """Whether each inlet that a step needs has an element."""
        return all(map(found.get, self._needed)) and (
            not self._needed_open or all(any(map(found.get, inlets)) for inlets in self._needed_open)
        )

    def _one_of_each(self) -> Step:
        elements = {inlet: self._take(inlet) for inlet, waiting in list(self._waiting.items()) if waiting}
        moment = max(element.moment for element in elements.values())
        return Step(self._by_port(self._latest | elements), moment)

    def _aligned(self) -> Step | None:
        while all(self._waiting.values()) and self._has_needed(self._waiting):
            newest = max(waiting[0].time_ns for waiting in self._waiting.values())
            late = [inlet for inlet, w in self._waiting.items() if w[0].time_ns < newest - self._tolerance_ns]
            if not late:
                return self._one_of_each()
            for inlet in late:
                self._take(inlet)
                self.skipped[port_of(inlet)] += 1
        return None

    def _with_latest(self, inlet: str) -> Step | None:
        if not self._has_needed(self._latest):
            # Before the first step, the first element that waits at an inlet counts as its latest.
            first = {one: waiting[0] for one, waiting in self._waiting.items() if waiting}
            if not self._has_needed(first | self._latest):
                return None
            self._latest = first | self._latest
        element = self._latest[inlet] = self._waiting[inlet][0]
        step = Step(self._by_port(dict(self._latest)), element.moment)
        self._take(inlet)
        return step

    def _take(self, inlet: str) -> Element:
        """Remove the first element that waits at an inlet; the inlet goes with the last one if its source has."""
        waiting = self._waiting[inlet]
        element = waiting.popleft()
        if not waiting and inlet in self._ended:
            self._ended.discard(inlet)
            self.forget(inlet)
        return element

    def _by_port(self, elements: dict[str, Element]) -> Mapping[str, Element | list[Element]]:
        """The elements of inlets by port."""
        if not self._slots:
            return elements
        found: dict[str, Element | list[Element]] = {
            inlet: element for inlet, element in elements.items() if port_of(inlet) not in self._slots
        }
        for port, inlets in self._slots.items():
            found[port] = sorted([elements[inlet] for inlet in inlets if inlet in elements], key=attrgetter("moment"))
        return found
