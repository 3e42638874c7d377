"""Adoption: the units and wires on the hosts that a new manager keeps, and the orders that end the others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from cfgplan.domain import ComputationUnit, Host, Publication, Subscription, Transformation
from cfgplan_runtime.children.messages import Release
from cfgplan_runtime.children.unit_order import unit_order
from cfgplan_runtime.fleet.orders import CloseTopicOrder, CutOrder, DiscardOrder, Held, HeldUnit, KillOrder
from cfgplan_runtime.fleet.routes import Crossing, OrderTo, Route, Routes
from cfgplan_runtime.processes.process_backend import RELAY
from cfgplan_runtime.supervision.backend import Found, FoundWire, is_tap


@dataclass(frozen=True, slots=True)
class Adoption:
    """The units and wires that a manager keeps.

    `units` (including stopping ones) and `spares` map ids to hosts; `topics` has for each topic the host that was asked
    for and the host where it is.
    """

    found: Found | None
    units: Mapping[str, str]
    spares: Mapping[str, str]
    topics: Mapping[str, tuple[str | None, str]]
    routes: Routes
    orders: Sequence[OrderTo]
    """Orders that end all units, wires and topics that are not kept."""


def adopt(run: str, held: Mapping[str, Held], library: Mapping[str, Transformation]) -> Adoption:
    """Keep the units that `library` would start in the same way, and the wires between them.

    `held` has the state of each host. Hosts that were cut off from each other may have units, spares or topics of the
    same name: those of the latest manager are kept. The names of later crossings begin with `run`.
    """
    held = dict(sorted(held.items(), key=lambda item: (-item[1].term, item[0])))
    stopping = _stopping(held)
    kept, ended_units = _kept({host: one.units for host, one in held.items()}, library, stopping)
    units = {**kept, **stopping}
    spares, ended_spares = _kept({host: one.spares for host, one in held.items()}, library, {})
    ended_spares += [(spares.pop(unit), unit) for unit in sorted(spares.keys() & units.keys())]
    topics, closed = _topics(held)
    crossings, released = _crossings(held)
    routes, has_switched, cut = _routes(held, units, {topic: host for topic, (_, host) in topics.items()}, crossings)
    fed = [crossing for crossing in crossings.values() if units.get(crossing.stream.unit) == crossing.source]
    return Adoption(
        _found(held, kept, stopping, spares, topics, routes, has_switched, library)
        if units or spares or topics
        else None,
        units,
        spares,
        topics,
        Routes(run, routes, crossings.values(), fed),
        [
            *((host, KillOrder(unit, dump=False)) for host, unit in ended_units),
            *((host, DiscardOrder(spare)) for host, spare in ended_spares),
            *released,
            *cut,
            *closed,
        ],
    )


def _stopping(held: Mapping[str, Held]) -> dict[str, str]:
    """The host of each unit that was told to stop and still processes its input; a unit that is not ready has no input.

    If several units have one id, the first counts.
    """
    return {
        unit: host
        for host, one in reversed(list(held.items()))
        for unit, known in one.units.items()
        if known.is_stopping and known.labor_us is not None
    }


def _kept(
    held: Mapping[str, Mapping[str, HeldUnit]], library: Mapping[str, Transformation], stopping: Mapping[str, str]
) -> tuple[dict[str, str], list[tuple[str, str]]]:
    """The hosts of kept units by id, and (host, id) of the units to end. A unit is kept if `library` would start it in
    the same way now, and it was not told to stop.

    If several units have one id, the first is kept, unless one of them is `stopping`.
    """
    kept, ended = dict[str, str](), list[tuple[str, str]]()
    for host, units in held.items():
        for unit, known in units.items():
            transformation = library.get(known.label)
            is_as_wanted = transformation is not None and unit_order(unit, transformation, None) == known.order
            if is_as_wanted and not known.is_stopping and unit not in kept.keys() | stopping.keys():
                kept[unit] = host
            elif stopping.get(unit) != host:
                ended.append((host, unit))
    return kept, ended


def _topics(held: Mapping[str, Held]) -> tuple[dict[str, tuple[str | None, str]], list[OrderTo]]:
    """For each topic the host that was asked for and the first host that has it; and orders that close it on other
    hosts, and taps on all.
    """
    topics, orders = dict[str, tuple[str | None, str]](), list[OrderTo]()
    for host, one in held.items():
        for topic, asked in one.topics.items():
            if topic in topics or is_tap(topic):
                orders.append((host, CloseTopicOrder(topic)))
            else:
                topics[topic] = asked, host
    return topics, orders


def _crossings(held: Mapping[str, Held]) -> tuple[dict[str, Crossing], list[OrderTo]]:
    """The crossings with both ends held, and orders that release all others."""
    crossings, orders = dict[str, Crossing](), list[OrderTo]()
    for source, one in held.items():
        for name, export in one.exports.items():
            target = export.order.host
            if export.stream is None or target not in held or name not in held[target].imports:
                orders.append((source, Release(name)))
            else:
                connected = held[target].imports[name].connected
                blocks = export.order.blocks
                crossings[name] = Crossing(name, export.wire, export.stream, source, target, blocks, connected)
    return crossings, orders


def _routes(
    held: Mapping[str, Held], units: Mapping[str, str], topics: Mapping[str, str], crossings: Mapping[str, Crossing]
) -> tuple[list[Route], set[int], list[OrderTo]]:
    """The routes between kept units, those of their wires that have switched, and orders that cut all others."""
    routes, has_switched, orders = list[Route](), set[int](), list[OrderTo]()
    for target, one in held.items():
        for known in one.wires:
            crossing = crossings.get(known.stream.port) if known.stream.unit == RELAY else None
            stream = known.stream if crossing is None else crossing.stream
            source = target if crossing is None else crossing.source
            inlet_host = topics.get(known.inlet.port) if known.inlet.is_outlet else units.get(known.inlet.unit)
            if units.get(stream.unit) != source or inlet_host != target:
                orders.append((target, CutOrder(known.wire, known.inlet)))
                continue
            routes.append(Route(known.wire, stream, known.inlet, source, target, crossing))
            if known.has_switched:
                has_switched.add(known.wire)
    return routes, has_switched, orders


def _found(
    held: Mapping[str, Held],
    units: Mapping[str, str],
    stopping: Mapping[str, str],
    spares: Mapping[str, str],
    topics: Mapping[str, tuple[str | None, str]],
    routes: Sequence[Route],
    has_switched: set[int],
    library: Mapping[str, Transformation],
) -> Found:
    running = {unit: held[host].units[unit] for unit, host in units.items()}
    prepared = {spare: held[host].spares[spare] for spare, host in spares.items()}
    known = {**prepared, **running}
    cold = [ComputationUnit(spare, prepared[spare].label, host=host, standby=True) for spare, host in spares.items()]
    between = [one for one in routes if one.stream.unit in units]
    hot = [_as_wired(unit, running[unit].label, host, between) for unit, host in units.items()]
    return Found(
        tuple(sorted([*hot, *cold], key=lambda unit: unit.id)),
        tuple(library[label] for label in sorted({one.label for one in known.values()})),
        tuple(Host(host) for host in sorted({*units.values(), *spares.values()})),
        {unit: one.labor_us for unit, one in known.items() if one.labor_us is not None},
        tuple(FoundWire(one.wire, one.stream, one.inlet, one.wire in has_switched) for one in routes),
        {topic: asked for topic, (asked, _) in topics.items()},
        stopping,
    )


def _as_wired(unit: str, label: str, host: str, routes: Sequence[Route]) -> ComputationUnit:
    """A unit with the subscriptions and publications of its wires."""
    feeds = tuple(Subscription(one.inlet.input, one.stream) for one in routes if one.inlet.unit == unit)
    published = tuple(
        Publication(one.stream.port, one.inlet.port)
        for one in routes
        if one.inlet.is_outlet and one.stream.unit == unit
    )
    return ComputationUnit(unit, label, feeds, published, host)
