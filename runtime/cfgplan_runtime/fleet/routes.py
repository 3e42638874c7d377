"""The routes of a fleet's wires, and crossings: a stream goes once to each other host, however many inputs it feeds."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import msgspec

from cfgplan.domain import Stream
from cfgplan_runtime.children.messages import CrossingCounts, Export, Import, Release, TellMark
from cfgplan_runtime.fleet.orders import ConnectOrder, CutOrder, EndWireOrder, Order, StopOrder
from cfgplan_runtime.processes.process_backend import RELAY
from cfgplan_runtime.supervision.backend import Inlet

OrderTo = tuple[str, Order]
"""An order and the host that it is for."""


@dataclass(slots=True, eq=False)
class Crossing:
    """A stream to another host. It is released once all wires that were `connected` to it are gone."""

    name: str
    wire: int
    """The wire from the unit to its host's relay."""
    stream: Stream
    source: str
    target: str
    blocks: bool
    connected: int = 0

    @property
    def released(self) -> list[OrderTo]:
        """The orders that end it."""
        return [(host, Release(self.name)) for host in (self.source, self.target)]


@dataclass(frozen=True, slots=True)
class Route:
    """The route of a wire: within one host, or over a crossing."""

    wire: int
    stream: Stream
    inlet: Inlet
    source: str
    target: str
    crossing: Crossing | None

    @property
    def local_stream(self) -> Stream:
        """The stream that feeds the inlet on its host."""
        return self.stream if self.crossing is None else Stream(RELAY, self.crossing.name)

    @property
    def ended(self) -> OrderTo:
        """The order that ends it at its inlet."""
        return self.target, EndWireOrder(self.wire, self.local_stream, self.inlet)


class Counts:
    """The counts of all crossings of a run, released ones too."""

    def __init__(self) -> None:
        self._last: dict[str, tuple[tuple[str, str, str], CrossingCounts]] = {}
        """For each crossing its stream, source and target, and its last counts."""
        self._released: dict[tuple[str, str], CrossingCounts] = {}

    def after(self, told: Mapping[str, CrossingCounts], routes: Routes) -> dict[tuple[str, str, str], CrossingCounts]:
        """Add new counts. Returns all by stream, source and target; released crossings are summed as stream ""."""
        for name, counts in told.items():
            one = routes.crossing(name)
            if one is not None:
                self._last[name] = (str(one.stream), one.source, one.target), counts
            elif name in self._last:
                self._last[name] = self._last[name][0], counts
        for name in [name for name in self._last if routes.crossing(name) is None and name not in told]:
            (_, source, target), counts = self._last.pop(name)
            ended = msgspec.structs.replace(counts, waiting=0)
            self._released[source, target] = self._released.get((source, target), CrossingCounts()) + ended
        found = {("", *hosts): counts for hosts, counts in self._released.items()}
        for name, ((stream, *hosts), counts) in self._last.items():
            labels = (stream if routes.crossing(name) else "", hosts[0], hosts[1])
            found[labels] = found.get(labels, CrossingCounts()) + counts
        return found


class Routes:
    """All routes of a run. Methods return the orders to give, in this order.

    The names of new crossings begin with `run`. Only those of the present `crossings` that are in `fed` may feed more
    inputs.
    """

    def __init__(
        self,
        run: str,
        routes: Iterable[Route] = (),
        crossings: Iterable[Crossing] = (),
        fed: Iterable[Crossing] = (),
    ) -> None:
        self._run = run
        self._routes = {route.wire: route for route in routes}
        self._crossings = {crossing.name: crossing for crossing in crossings}
        self._shared = {(one.stream, one.target, one.blocks): one for one in fed}
        """The crossings that may feed more inputs, by stream, target, and whether they block."""
        self._last = max((-crossing.wire for crossing in self._crossings.values()), default=0)

    def connect(
        self, wire: int, stream: Stream, inlet: Inlet, source: str, target: str, *, queue: int, blocks: bool
    ) -> list[OrderTo]:
        """Connect a stream of a unit on `source` to an inlet on `target`."""
        crossing, orders = None, list[OrderTo]()
        if source != target:
            crossing, orders = self._cross(stream, source, target, queue=queue, blocks=blocks)
            crossing.connected += 1
        route = self._routes[wire] = Route(wire, stream, inlet, source, target, crossing)
        return [*orders, (target, ConnectOrder(wire, route.local_stream, inlet, queue, blocks))]

    def crossing(self, name: str) -> Crossing | None:
        """The crossing of this name; None if it was released."""
        return self._crossings.get(name)

    def disconnect(self, wire: int, inlet: Inlet, target: str | None) -> list[OrderTo]:
        """Remove a wire from its inlet."""
        self._routes.pop(wire, None)
        return [] if target is None else [(target, CutOrder(wire, inlet))]

    def end(self, wire: int, *, has_both_ends: bool) -> list[OrderTo]:
        """End a wire. `has_both_ends` is true if its source's host and its consumer exist."""
        route = self._routes.pop(wire, None)
        if route is None:
            return []
        crossing = route.crossing
        if crossing is None or not has_both_ends:
            return [route.ended]
        # Elements of the source are under way: the end has to come behind them.
        return [(route.source, EndWireOrder(crossing.wire, route.stream, Inlet(RELAY, crossing.name)))]

    def stop(self, unit: str, host: str) -> list[OrderTo]:
        """Stop a unit once it has received all elements that its sources on other hosts have sent so far."""
        feeding = {route.crossing for route in self._routes.values() if route.inlet.unit == unit and route.crossing}
        crossings = sorted((one for one in feeding if one.name in self._crossings), key=lambda one: one.name)
        marks = [(one.source, TellMark(one.name, unit)) for one in crossings]
        return [(host, StopOrder(unit, tuple(one.name for one in crossings))), *marks]

    def source_of(self, wire: int) -> str | None:
        """The host of a wire's source; None for an unknown wire."""
        return self._routes[wire].source if wire in self._routes else None

    def forget(self, wire: int) -> None:
        """Forget a wire that is gone."""
        self._routes.pop(wire, None)

    def note_switch(self, wire: int) -> None:
        """Note that an inlet has switched to this wire, and forget the inlet's earlier ones, which are gone."""
        if wire in self._routes:
            inlet = self._routes[wire].inlet
            self._routes = {n: one for n, one in self._routes.items() if one.inlet != inlet or n >= wire}

    def forget_unit(self, unit: str) -> None:
        """Forget a unit that is gone: the crossings of its streams feed no more inputs."""
        self._shared = {key: one for key, one in self._shared.items() if key[0].unit != unit}

    def forget_host(self, host: str) -> list[OrderTo]:
        """Forget a host that is gone: release the crossings to it and from it."""
        gone = [one for one in self._crossings.values() if host in (one.source, one.target)]
        return [order for one in gone for order in self._release(one)]

    def note_unused(self, name: str, served: int) -> list[OrderTo]:
        """Release a crossing if the `served` inputs that no longer use it are all that it fed."""
        known = self._crossings.get(name)
        return self._release(known) if known is not None and known.connected == served else []

    def _cross(
        self, stream: Stream, source: str, target: str, *, queue: int, blocks: bool
    ) -> tuple[Crossing, list[OrderTo]]:
        """The crossing of a stream to a host, and the orders that make it if it is new."""
        key = (stream, target, blocks)
        if key in self._shared:
            return self._shared[key], []
        self._last += 1
        name, wire = f"{self._run}-{self._last}", -self._last
        crossing = self._shared[key] = self._crossings[name] = Crossing(name, wire, stream, source, target, blocks)
        to_relay = ConnectOrder(wire, stream, Inlet(RELAY, name), queue, blocks)
        given = Import(name, source), Export(name, target, queue, blocks), to_relay
        return crossing, [(target, given[0]), (source, given[1]), (source, given[2])]

    def _release(self, crossing: Crossing) -> list[OrderTo]:
        del self._crossings[crossing.name]
        self._shared = {key: one for key, one in self._shared.items() if one is not crossing}
        return crossing.released
