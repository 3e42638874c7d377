"""The hand-over of a state from one unit to the next: no step is lost, and none is made twice.

The next unit keeps the elements that it receives, and says from which moment on it receives all. The old unit
continues. Once it has received the element of that moment, it tells its state between two steps, with the place of
that state in each input, and pauses. The next unit begins there. Only the supervisor ends a pause or a wait, or the
agent of a fleet whose manager is gone.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from itertools import chain

from cfgplan_runtime.children.control import LONGEST_MESSAGE
from cfgplan_runtime.children.messages import GivenInput, StateTold
from cfgplan_runtime.children.ports import Ports
from cfgplan_runtime.children.steps import StepQueue
from cfgplan_runtime.streams.channel import MOST_WAITING_BYTES
from cfgplan_runtime.streams.element import Element, Moment
from cfgplan_runtime.streams.inlet import port_of

_MOST_HELD = 4096
"""The most elements that an inlet keeps: four seconds at 1,000 Hz. Beyond the unit's `queue`, they also have at most
MOST_WAITING_BYTES.
"""
_MOST_GIVEN_BYTES = LONGEST_MESSAGE // 2
"""The most bytes of elements that the next unit is given."""
_LESS_ROOM = 0.1
"""For each kept element that goes to the steps, so many fewer may be kept: units that are at work for up to nine tenths
of the time drop none.
"""


class _WaitingElements:
    """The elements that an inlet keeps, the oldest first."""

    def __init__(self, elements: Iterable[Element] = ()) -> None:
        self.elements = deque(elements)
        self.bytes = sum(len(one.payload) for one in self.elements)

    def append(self, element: Element) -> None:
        self.elements.append(element)
        self.bytes += len(element.payload)

    def take(self) -> Element:
        """Remove and return the oldest element."""
        element = self.elements.popleft()
        self.bytes -= len(element.payload)
        return element


class Handover:
    """The part of a unit in hand-overs, first as the next unit and later as the one before."""

    def __init__(self, steps: StepQueue, ports: Ports, queue: int) -> None:
        self._steps = steps
        self._ports = ports
        self._limit = queue
        self._held: dict[str, _WaitingElements] | None = None
        """By inlet the elements that the steps have not got yet; None if they get each at once."""
        self._most: float = _MOST_HELD
        self.is_waiting = False
        """Whether the unit waits for its state; no step begins before it comes."""
        self._sought: Mapping[str, bool] | None = None
        """The inlets whose places are asked for; True: its first element is its place. None: not asked."""
        self._asked: Mapping[str, Moment] | None = None
        """The elements after which the state is told, by inlet; None: not asked."""
        self._is_paused = False
        """Whether the unit has told its state: the next unit makes the steps from there on."""

    def hold(self) -> None:
        """Keep the elements that come before the state."""
        self._held, self._most, self.is_waiting = {}, _MOST_HELD, True

    @property
    def is_keeping(self) -> bool:
        """Whether elements go through `keep`."""
        return self._held is not None

    @property
    def is_still(self) -> bool:
        """Whether no step may begin: the unit waits for a state, or has told its own."""
        return self.is_waiting or self._is_paused

    def keep(self, inlet: str, element: Element, *, may_drop: bool) -> None:
        """Keep an element for later steps. Without room the oldest of its inlet is dropped, if it `may_drop`."""
        assert self._held is not None
        kept = self._held.setdefault(inlet, _WaitingElements())
        kept.append(element)
        while may_drop and self._are_too_many(kept, len(kept.elements)):
            kept.take()
            self._steps.dropped[port_of(inlet)] += 1

    def _are_too_many(self, kept: _WaitingElements, number: int) -> bool:
        """Whether an inlet has no room for this number of elements."""
        return number > self._most or (number > self._limit and kept.bytes > MOST_WAITING_BYTES)

    def is_full(self, inlet: str) -> bool:
        """Whether an inlet keeps as many elements as may wait for its steps.

        A unit that may make no step has more room: its producers also feed the other unit of the hand-over, and must
        not wait. A unit that is asked for its state has room for the elements that the state needs, even if no step can
        use them yet.
        """
        if self._needs(inlet):
            return False
        kept = None if self._held is None else self._held.get(inlet)
        if self.is_still:
            return kept is not None and self._are_too_many(kept, len(kept.elements) + 1)
        return self._steps.is_full(inlet) or (kept is not None and len(kept.elements) >= self._limit)

    def waiting(self, port: str) -> int:
        """The number of elements that a port keeps."""
        return sum(len(kept.elements) for inlet, kept in (self._held or {}).items() if port_of(inlet) == port)

    def begin(self, inputs: Mapping[str, GivenInput]) -> None:
        """Begin a waiting unit's steps at the place of each inlet in `inputs`, else with the elements that came.

        Places that are asked for are told later, too, except those of first elements, which become steps.
        """
        self.is_waiting = False
        if self._sought is not None:
            self._sought = {name: False for name, is_first in self._sought.items() if not is_first} or None
        held = self._held or {}
        for inlet, given in inputs.items():
            if inlet in self._ports.inputs:
                before = [Element(one.time_ns, one.turn, 0, one.payload) for one in given.elements]
                received = self._ports.inputs[inlet].inlet
                received.last = max(received.last, given.done, *(one.moment for one in before))
                kept = held.get(inlet, _WaitingElements()).elements
                held[inlet] = _WaitingElements(self._steps.begin_at(inlet, given.done, chain(before, kept)))
        self._held = held

    def refill(self) -> None:
        """Give the steps the kept elements that they have room for.

        Each time, fewer elements may be kept: a unit that is slower than its sources would never catch up.
        """
        if self._held is None or self.is_still:
            return
        longest = max((len(kept.elements) for kept in self._held.values()), default=0)
        self._most = min(self._most, 2 * longest + self._limit)
        for inlet, kept in self._held.items():
            while kept.elements and not self._steps.is_full(inlet):
                self._steps.put(inlet, kept.take(), may_drop=False)
                self._most = max(self._limit, self._most - _LESS_ROOM)
        if not any(kept.elements for kept in self._held.values()):
            self._held = None

    def ask_places(self, inlets: Mapping[str, bool]) -> None:
        """Ask for `places`."""
        self._sought = inlets

    def places(self) -> dict[str, Moment] | None:
        """The asked places, once; None if there is no question, or one place is still unknown."""
        if self._sought is None:
            return None
        found = dict[str, Moment]()
        for name, is_first in self._sought.items():
            port = self._ports.inputs.get(name)
            for receiver in () if port is None else port.receivers.values():
                kept = (self._held or {}).get(name, _WaitingElements()).elements
                place = receiver.place if not is_first else kept[0].moment if kept else None
                if place is None:
                    return None
                found[name] = place
        self._sought = None
        return found

    def ask_state(self, until: Mapping[str, Moment]) -> None:
        """Ask for the state."""
        self._asked = until

    @property
    def is_state_due(self) -> bool:
        """Whether the state is asked for, and all elements that it needs have been received."""
        return self._asked is not None and not any(map(self._needs, self._asked))

    def _needs(self, inlet: str) -> bool:
        """Whether the state that is asked for needs elements of an inlet that have not been received.

        A source that pauses has sent all of them: the next source's first element comes after them.
        """
        port = self._ports.inputs.get(inlet)
        if self._asked is None or inlet not in self._asked or port is None:
            return False
        return port.inlet.last < self._asked[inlet] and not port.inlet.is_paused

    def stay(self) -> None:
        """Continue with the unit's own state: it is not replaced after all."""
        self._asked, self._is_paused = None, False

    def _limit_bytes(self, inputs: Mapping[str, GivenInput]) -> None:
        """Drop the oldest given elements that are too many for a message, of the inlet that has the most bytes."""
        sizes = {name: deque(len(one.payload) for one in given.elements) for name, given in inputs.items()}
        totals = {name: sum(each) for name, each in sizes.items()}
        while sum(totals.values()) > _MOST_GIVEN_BYTES:
            name = max(totals, key=totals.__getitem__)
            totals[name] -= sizes[name].popleft()
        for name, each in sizes.items():
            given = inputs[name]
            lost = given.elements[: len(given.elements) - len(each)]
            del given.elements[: len(lost)]
            self._steps.dropped[port_of(name)] += sum((one.time_ns, one.turn) > given.done for one in lost)

    def tell(self, state: bytes | None, outputs: Mapping[str, Moment]) -> None:
        """Tell the state that was asked for, and the moment of each output's last element. Then pause: the next unit
        makes the steps from here on, perhaps in another way.
        """
        assert self._asked is not None
        asked, self._asked = self._asked, None
        for inlet, kept in (self._held or {}).items():  # they are part of what is given, even if they have no room
            while kept.elements:
                self._steps.put(inlet, kept.take(), may_drop=False)
        inputs = {
            name: self._steps.given(name, port.inlet.last, asked.get(name)) for name, port in self._ports.inputs.items()
        }
        self._limit_bytes(inputs)
        self._ports.say(StateTold(state, inputs, dict(outputs)))
        if state is not None:
            self._is_paused = True
            self._held, self._most = self._held or {}, _MOST_HELD
            for name in self._ports.outputs:
                self._ports.pause(name)
