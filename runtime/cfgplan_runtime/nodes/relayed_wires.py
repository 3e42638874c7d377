"""The wires of a run that go through a relay, and the relay's restarts."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Iterator, Mapping
from math import inf
from typing import Protocol

import msgspec

from cfgplan.transformations import Transformation
from cfgplan_runtime.children import messages
from cfgplan_runtime.children.exit_status import clause_of, end_of_process
from cfgplan_runtime.nodes.relay_messages import CloseInlets, Lead, Observe, Passed, Refused, Unsaid, Untap
from cfgplan_runtime.nodes.shown_taps import ShownTaps
from cfgplan_runtime.streams.ends import Ends
from cfgplan_runtime.streams.run_folder import RunFolder
from cfgplan_runtime.streams.topic_names import is_tap
from cfgplan_runtime.supervision import events
from cfgplan_runtime.supervision.backend import Inlet
from cfgplan_runtime.supervision.delays import doubling_s

ENVIRONMENT_FILE = "the environment file"
"""What messages call the environment file of a run whose file has no name."""
_HELPER = "relay of topics"
_RELAY_S, _START_S = 10.0, 60.0
"""Seconds that the relay may be silent, and that its start may take."""
_AGAIN_S, _MOST_AGAIN_S = 0.05, 5.0
"""Seconds before a relay that was lost twice in a row is restarted, doubled for each further loss."""


class Relay(Protocol):
    """A relay's process, and the connection to it."""

    socket: socket.socket
    has_ended: bool
    last_words: str
    """The last line that it has printed, if known; set by `close`."""

    @property
    def is_waiting(self) -> bool:
        """Whether messages wait until the socket can take them."""

    def send(self, message: msgspec.Struct) -> None: ...
    def hear(self) -> Iterator[object]:
        """Send waiting messages, then yield the messages that have come."""

    def close(self) -> int:
        """End it. Returns its exit status."""


class NodeUnit(Protocol):
    """A unit's node, by its full name; a foreign one is not the run's."""

    @property
    def name(self) -> str: ...
    @property
    def transformation(self) -> Transformation: ...
    @property
    def is_foreign(self) -> bool: ...
    def publishes_at(self, port: str) -> str:
        """Return the topic that an output publishes on."""


class RelayedWires:
    """Connects wires through a relay, and appends events about them to `happened`.

    `start` makes a relay; it raises OSError if it can't. `begin` is called with each new relay before the wires are
    sent to it, and `hear` with each message that only this kind of relay sends. Taps are topics in `run_folder`. `file`
    is the environment file, as messages name it.
    """

    def __init__(
        self,
        ends: Ends,
        happened: list[events.Event],
        start: Callable[[], Relay],
        begin: Callable[[], None],
        hear: Callable[[object], None],
        run_folder: RunFolder,
        file: str,
    ) -> None:
        self._ends, self._happened, self._start_process, self._begin = ends, happened, start, begin
        self._hear_other, self._file = hear, file
        self.taps = ShownTaps(ends, run_folder)
        self._observed: dict[str, list[Observe]] = {}
        """The observed outputs by unit."""
        self._said: dict[str, messages.Qualities] = {}
        """What the outputs of units have said since the last call of `said_by`."""
        self._leads: dict[int, tuple[Inlet, Lead]] = {}
        """The wires that go through the relay, or will once it has started."""
        self._topics: list[str] = []
        self._passed = Passed({}, {}, {})
        self._relay: Relay | None = None
        self._losses = 0
        self._due_s: float | None = None
        """When the relay will be restarted, on the monotonic clock; None while it runs."""

    def start(self) -> None:
        """Start a relay, and send it all wires and topics."""
        self._due_s = None
        try:
            relay = self._relay = self._start_process()
        except OSError as error:
            self._happened.append(events.OutOfDescriptors(f"the relay of topics can't be started: {error.strerror}"))
            self._plan()
            return
        self._ends.watch(relay.socket, lambda: self._hear(relay))
        self._happened.append(events.HelperAlive(_HELPER, _START_S))
        self._begin()
        for topic in self._topics:
            self.tell(messages.OpenOutlet(topic))
        for order in (order for orders in self._observed.values() for order in orders):
            self.tell(order)
        if self._losses:
            self._leads = {wire: one for wire, one in self._leads.items() if not one[0].is_outlet}
            for _, lead in self._leads.values():
                self.tell(lead)
            self._happened.append(events.OutletsOpened())

    def left_s(self, timeout_s: float | None) -> float | None:
        """The seconds to wait: `timeout_s`, but no longer than until the relay's restart. None waits for ever."""
        if self._due_s is None:
            return timeout_s
        left_s = max(0.0, self._due_s - time.monotonic())
        return left_s if timeout_s is None else min(timeout_s, left_s)

    def start_if_due(self) -> None:
        if self._due_s is not None and self._due_s <= time.monotonic():
            self.start()

    def tell(self, message: msgspec.Struct) -> None:
        """Send a message to the relay, if it runs."""
        if self._relay is not None:
            self._relay.send(message)
            self._wait_to_tell(self._relay)

    def lead(self, inlet: Inlet, lead: Lead) -> None:
        """Connect a wire."""
        self._leads[lead.wire] = inlet, lead
        self.tell(lead)

    def disconnect(self, wire: int, inlet: Inlet) -> None:
        self._leads.pop(wire, None)
        self.tell(messages.Cut(str(inlet), wire))

    def end_wire(self, wire: int, inlet: Inlet) -> None:
        if inlet.is_tap:
            self.tell(Untap(inlet.port))
            return
        self._leads.pop(wire, None)
        self.tell(messages.End(str(inlet), wire))

    def switch_now(self, inlet: Inlet) -> None:
        self.tell(messages.SwitchNow(str(inlet)))

    def observe(self, unit: str, node: NodeUnit) -> None:
        """Read how good a unit's outputs are, where the file names fields that say it, until its inlets are closed."""
        publisher = node.name if node.is_foreign else None
        for port in node.transformation.outputs:
            fields = {stated.attribute: field for stated in port.quality if (field := stated.of_stream) is not None}
            if fields:
                order = Observe(unit, port.name, node.publishes_at(port.name), fields, publisher)
                self._observed.setdefault(unit, []).append(order)
                self.tell(order)

    def close_inlets(self, unit: str) -> None:
        """Close all inlets of a unit that has ended, and observe its outputs no more."""
        self._observed.pop(unit, None)
        self._said.pop(unit, None)
        self.tell(CloseInlets(unit))

    def open_outlet(self, topic: str) -> None:
        if is_tap(topic):
            try:
                self.taps.open(topic)
            except OSError as error:
                self._happened.append(events.OutOfDescriptors(f"{topic} can't be opened: {error.strerror}"))
            return
        self._topics.append(topic)
        self.tell(messages.OpenOutlet(topic))

    def close_outlet(self, topic: str) -> None:
        if is_tap(topic):
            self.taps.close(topic)
            return
        self._topics.remove(topic)
        self.tell(messages.CloseOutlet(topic))

    def passed_from(self, source: str) -> int:
        """The number of messages that the relay has received on a topic."""
        return self._passed.sources.get(source, 0)

    def taken_by(self, unit: str) -> dict[str, messages.PortCounts]:
        """The counts of a unit's inlets, by port."""
        return {
            inlet.port: self._passed.inlets[lead.inlet]
            for inlet, lead in self._leads.values()
            if inlet.unit == unit and lead.inlet in self._passed.inlets
        }

    def said_by(self, unit: str) -> messages.Qualities:
        """Return what a unit's outputs have said of their quality since the last call."""
        return self._said.pop(unit, {})

    def unit_at(self, target: str) -> str:
        """The unit that a topic feeds; "" if it feeds none."""
        return next((inlet.unit for inlet, lead in self._leads.values() if lead.target == target), "")

    def lose(self) -> None:
        """End the relay and report its loss. The first restart is immediate; after losses in a row it waits longer."""
        if self._relay is None:
            return
        self._ends.unwatch(self._relay.socket)
        end = end_of_process(self._relay.close())
        said = f": {self._relay.last_words}" if self._relay.last_words else ""
        self._relay = None
        self._plan()
        self._happened += [
            events.HelperAlive(_HELPER, inf),
            events.OutletsLost(f"the relay {clause_of(end)}{said}"),
        ]

    def close(self) -> None:
        """End the relay for good."""
        self.taps.close_all()
        if self._relay is not None:
            self._ends.unwatch(self._relay.socket)
            self._relay.close()
            self._relay = None

    def _hear(self, relay: Relay) -> None:
        for message in relay.hear():
            match message:
                case messages.Switched(_, wire):
                    self._note_switch(wire)
                case messages.Lost(_, wire) if wire in self._leads:
                    inlet, _ = self._leads.pop(wire)
                    self._happened.append(events.InputLost(inlet.unit or None, inlet.port, wire))
                case Passed(_, _, flows, qualities):
                    self._passed = message
                    self._note_qualities(qualities)
                    self._happened += [events.HelperAlive(_HELPER, _RELAY_S), events.TopicsStatus(flows)]
                    self._losses = 0
                case Refused(topic, cause):
                    unit = self.unit_at(topic)
                    if unit:
                        self._happened.append(events.UnitPrinted(unit, f"cfgplan: {topic}: {cause}"))
                case Unsaid(unit, text) if unit in self._observed:
                    mend = f"correct `observe` of that output in {self._file}"
                    self._happened.append(events.UnitFailed(unit, "no quality", 0, f"{text}: {mend}"))
                case _:
                    self._hear_other(message)
        if relay.has_ended:
            self.lose()
        else:
            self._wait_to_tell(relay)

    def _wait_to_tell(self, relay: Relay) -> None:
        self._ends.write(relay.socket, is_waiting=relay.is_waiting)

    def _note_switch(self, wire: int) -> None:
        if wire in self._leads:
            inlet, _ = self._leads[wire]
            self._leads = {
                other: one for other, one in self._leads.items() if other >= wire or one[0] != inlet
            }  # those that it has replaced are gone
        self._happened.append(events.WireSwitched(wire))

    def _note_qualities(self, qualities: Mapping[str, messages.Qualities]) -> None:
        for unit in qualities.keys() & self._observed.keys():
            known = self._said.setdefault(unit, {})
            for port, said in qualities[unit].items():
                sums = known.setdefault(port, {})
                for attribute, quality in said.items():
                    sums[attribute] = sums[attribute].with_more(quality) if attribute in sums else quality

    def _plan(self) -> None:
        self._losses += 1
        self._due_s = time.monotonic() + doubling_s(self._losses, _AGAIN_S, _MOST_AGAIN_S)
