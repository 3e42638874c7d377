"""The wiring of inlets: the existing wires, and the wires that an environment needs."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from cfgplan.domain import ComputationUnit, Environment, Stream, Subscription, Transformation
from cfgplan_runtime.streams.inlet import slot
from cfgplan_runtime.supervision.backend import Backend, FoundWire, Inlet

OUTLET_QUEUE = 1024
"""The most elements that may wait on their way to a topic's outlet."""


@dataclass(slots=True, eq=False)
class Wire:
    """A connection from a stream to an inlet. `replaces` is the stream that fed the inlet before, while an update is
    under way.
    """

    id: int
    stream: Stream
    inlet: Inlet
    replaces: Wire | None = None
    has_switched: bool = False


class Wiring:
    """The wires of running units. `feeds` has, by inlet, the wire of the source that it has or is about to have."""

    def __init__(self, backend: Backend) -> None:
        self._backend = backend
        self._last_id = 0
        self._wires: dict[int, Wire] = {}
        self.feeds: dict[Inlet, Wire] = {}

    def adopt(self, wires: Iterable[FoundWire], stopping: Collection[str], last_wire: int) -> None:
        """Take over existing wires; new ones get numbers above theirs and `last_wire`. Wires of stopping units are not
        reported.
        """
        self._last_id = last_wire
        for found in wires:
            self._last_id = max(self._last_id, found.id)
            if found.stream.unit not in stopping and found.inlet.unit not in stopping:
                wire = Wire(found.id, found.stream, found.inlet, has_switched=found.has_switched)
                self._wires[wire.id] = self.feeds[wire.inlet] = wire

    def connect(self, stream: Stream, inlet: Inlet, receiver: Transformation | None) -> None:
        """Let a stream feed an inlet as the successor of its present source, if any. `receiver` is None for a topic."""
        wire = Wire(self.fresh_id(), stream, inlet, self.feeds.get(inlet))
        self._wires[wire.id] = self.feeds[inlet] = wire
        # Nobody outside may make a unit wait.
        queue, blocks = (OUTLET_QUEUE, False) if receiver is None else (receiver.run.queue, receiver.run.blocks)
        self._backend.connect(wire.id, stream, inlet, queue=queue, blocks=blocks)

    def fresh_id(self) -> int:
        """Return an id that no wire has."""
        self._last_id += 1
        return self._last_id

    def disconnect(self, inlet: Inlet) -> None:
        """Leave an inlet without a source."""
        wire = self.feeds.pop(inlet)
        self._wires.pop(wire.id, None)
        self._backend.disconnect(wire.id, wire.inlet)

    def note_switch(self, wire_id: int) -> None:
        """Note that an inlet has switched to a wire."""
        wire = self._wires.get(wire_id)
        if wire is not None:
            wire.has_switched = True
            if wire.replaces is not None:
                self._wires.pop(wire.replaces.id, None)

    def note_loss(self, wire_id: int) -> Wire | None:
        """The wire with which an inlet has lost its source; None if the wire was given up before."""
        wire = self._wires.pop(wire_id, None)
        if wire is None or self.feeds.get(wire.inlet) is not wire:
            return None
        del self.feeds[wire.inlet]
        return wire

    def forget_unit(self, unit: str) -> None:
        """Give up all wires from and to a unit that is gone, including those that are being replaced."""
        self._forget([wire for wire in self._wires.values() if unit in (wire.inlet.unit, wire.stream.unit)])

    def forget_inlet(self, inlet: Inlet) -> None:
        """Give up all wires to an inlet that is gone."""
        self._forget([wire for wire in self._wires.values() if wire.inlet == inlet])

    def forget_inputs(self, unit: str) -> None:
        """Give up the wires to a unit that is being stopped, so that their end is not reported as a loss."""
        for inlet in [inlet for inlet in self.feeds if inlet.unit == unit]:
            del self.feeds[inlet]

    def _forget(self, wires: list[Wire]) -> None:
        for wire in wires:
            del self._wires[wire.id]
            if self.feeds.get(wire.inlet) is wire:
                del self.feeds[wire.inlet]
            self._backend.end_wire(wire.id, wire.stream, wire.inlet)

    def settle(self) -> None:
        """Forget the wires that the last update has replaced."""
        for wire in self.feeds.values():
            wire.replaces = None
        self._wires = {wire.id: wire for wire in self.feeds.values()}


def wanted_feeds(environment: Environment, present: Mapping[Inlet, Stream] | None = None) -> Mapping[Inlet, Stream]:
    """Return the stream that should feed each inlet, including the topics' outlets.

    If an input takes several streams, streams that feed it in `present` keep their inlets. A new one takes the inlet of
    one that ends, as its successor, or else a free one.
    """
    several: dict[tuple[str, str], dict[str, Stream]] = {}
    for inlet, stream in (present or {}).items():
        if not inlet.is_outlet and inlet.port != inlet.input:
            several.setdefault((inlet.unit, inlet.input), {})[inlet.port] = stream
    feeds: dict[Inlet, Stream] = {}
    for unit in environment.units:
        for port, streams in unit.feeds.items():
            if count_of(environment, unit, port) == 1:
                feeds[Inlet(unit.id, port)] = streams[0]
            else:
                led = _led(port, streams, several.get((unit.id, port), {}))
                feeds |= {Inlet(unit.id, name): stream for name, stream in led.items()}
        for publication in unit.publications:
            feeds[Inlet("", publication.topic)] = Stream(unit.id, publication.port)
    return feeds


def count_of(environment: Environment, unit: ComputationUnit, port: str) -> int:
    """The number of streams that an input of a unit takes."""
    transformation = environment.transformation.get(unit.transformation)
    known = None if transformation is None else transformation.input.get(port)
    return 1 if known is None else known.count


def _led(port: str, streams: Sequence[Stream], present: Mapping[str, Stream]) -> dict[str, Stream]:
    """The streams of one input by inlet."""
    led = {name: stream for name, stream in present.items() if stream in streams}
    left = sorted(present.keys() - led.keys())
    free = (name for n in itertools.count(1) if (name := slot(port, n)) not in present)
    known = set(led.values())
    new = [stream for stream in streams if stream not in known]
    return {**led, **dict(zip(itertools.chain(left, free), new, strict=False))}


def wanted_topics(environment: Environment) -> Mapping[str, str | None]:
    """The topics that need an address: those of targets, on their hosts, and any other that a unit publishes on."""
    published = {publication.topic: None for unit in environment.units for publication in unit.publications}
    return {**published, **{target.topic: target.host for target in environment.stream_targets}}


def wanted_to_run(environment: Environment) -> set[str]:
    """The units that a target wants to run, whether or not they are connected."""
    wanted = set(environment.wanted_to_run.values())
    return {unit.id for unit in environment.units if unit.transformation in wanted}


def starved_units(environment: Environment) -> set[str]:
    """The units that can't step any more, since a source upstream is missing."""
    starved: set[str] = set()
    grows = True
    while grows:
        more = {
            unit.id for unit in environment.units if unit.id not in starved and _starves(unit, environment, starved)
        }
        starved |= more
        grows = bool(more)
    return starved


def _starves(unit: ComputationUnit, environment: Environment, starved: set[str]) -> bool:
    transformation = environment.transformation.get(unit.transformation)
    if transformation is None or not transformation.inputs:
        return False
    fed = Counter(s.port for s in unit.subscriptions if s.stream.unit not in starved)
    starting = {transformation.run.start}.intersection(transformation.input)
    if starting:
        return fed.keys().isdisjoint(starting)
    needed = [port for port in transformation.needed_inputs if not port.service]
    return not fed if transformation.run.start == "any" else not all(port.takes(fed[port.name]) for port in needed)


def without_feed(environment: Environment, inlet: Inlet, stream: Stream | None = None) -> Environment:
    """Return the environment without the subscription of `stream` at an inlet, or without a topic's publication."""
    left = tuple(_with_gap(unit, inlet, stream) for unit in environment.units)
    return replace(environment, units=left)


def _with_gap(unit: ComputationUnit, inlet: Inlet, stream: Stream | None) -> ComputationUnit:
    subscriptions: tuple[Subscription, ...] = unit.subscriptions
    publications = unit.publications
    if inlet.is_outlet:
        publications = tuple(p for p in publications if p.topic != inlet.port)
    elif unit.id == inlet.unit:
        subscriptions = tuple(s for s in subscriptions if s.port != inlet.input or s.stream != stream)
    return replace(unit, subscriptions=subscriptions, publications=publications)
