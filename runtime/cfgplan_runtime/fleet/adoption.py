"""Adoption: the units, wires and states on the hosts that a new manager keeps, and the orders that end the others."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

from cfgplan.domain import ComputationUnit, Host, Publication, Subscription, Transformation
from cfgplan_runtime.children.messages import Release
from cfgplan_runtime.children.unit_order import digest_of, unit_order
from cfgplan_runtime.fleet.agent import source_file
from cfgplan_runtime.fleet.orders import (
    CloseTopicOrder,
    CutOrder,
    DiscardOrder,
    GiveStateOrder,
    Held,
    HeldState,
    HeldUnit,
    KillOrder,
)
from cfgplan_runtime.fleet.routes import Crossing, OrderTo, Route, Routes
from cfgplan_runtime.processes.process_backend import RELAY
from cfgplan_runtime.streams.topic_names import is_tap
from cfgplan_runtime.supervision import events
from cfgplan_runtime.supervision.backend import Found, FoundWire, StoppingUnit


@dataclass(frozen=True, slots=True)
class Adoption:
    """The units and wires that a manager keeps.

    `units` (including stopping ones) and `spares` map ids to hosts; `topics` has for each topic the host that was asked
    for and the host where it is. `ended` has the ids of the units that this manager is the first to end,
    except those that end by a hand-over of their state.
    """

    found: Found | None
    units: Mapping[str, str]
    spares: Mapping[str, str]
    topics: Mapping[str, tuple[str | None, str]]
    routes: Routes
    ended: Sequence[str]
    orders: Sequence[OrderTo]
    """Orders that end all units, wires and topics that are not kept."""


def adopt(
    run: str,
    held: Mapping[str, Held],
    library: Mapping[str, Transformation],
    states: Mapping[str, Mapping[str, HeldState]] = MappingProxyType({}),
) -> Adoption:
    """Keep the units that `library` would start in the same way, and the wires between them. The others are told to
    stop. An unfinished hand-over of a state is finished if the new unit has the state, and undone otherwise.

    `held` has the units and wires of each host, and `states` its last states. Hosts that were cut off from each other
    may have units, spares or topics of the same name: those of the latest manager are kept. The names of later
    crossings begin with `run`.
    """
    held = dict(sorted(held.items(), key=lambda item: (-item[1].term, item[0])))
    stopping = _stopping(held)
    undone, replaced = _handovers(held)
    kept, ended_units = _kept(
        {host: one.units for host, one in held.items()}, library, {**stopping, **replaced}, undone
    )
    ended_units += [(host, unit) for unit, host in replaced.items()]
    told = _told(held, [one for one in ended_units if one not in undone], {**kept, **stopping})
    killed = [(host, unit) for host, unit in ended_units if told.get(unit) != host]
    awaited = [unit for unit, host in stopping.items() if not _is_told(held[host].units[unit])]
    stopping |= told
    units = {**kept, **stopping}
    spares, ended_spares = _kept({host: one.spares for host, one in held.items()}, library, {})
    ended_spares += [(spares.pop(unit), unit) for unit in sorted(spares.keys() & units.keys())]
    topics, closed = _topics(held)
    crossings, released = _crossings(held)
    routes, has_switched, cut = _routes(held, units, {topic: host for topic, (_, host) in topics.items()}, crossings)
    fed = [crossing for crossing in crossings.values() if units.get(crossing.stream.unit) == crossing.source]
    made = Routes(run, routes, crossings.values(), fed)
    latest = _latest(states)
    found = _found(held, kept, stopping, spares, topics, routes, has_switched, library, latest)
    return Adoption(
        found if units or spares or topics or found.states else None,
        units,
        spares,
        topics,
        made,
        sorted({unit for host, unit in ended_units if unit not in replaced and (host, unit) not in undone}),
        [
            *((host, KillOrder(unit, dump=False)) for host, unit in killed),
            *_states_given(held, kept, latest),
            *(order for unit in (*awaited, *told) for order in made.stop(unit, stopping[unit])),
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
        if known.stop is not None and known.labor_us is not None
    }


def failures_kept(host: str, held: Held, folder: Path) -> list[events.FailuresKept]:
    """Return the failures on a host whose code has not changed since. Their transformations may be started differently
    now: see `FailuresKept.is_of`.
    """
    return [
        events.FailuresKept(label, host, one.number, one.at(held.now_s).left_s, one.cause, one.digest)
        for label, one in sorted(held.failures.items())
        if one.code == code_digest(one.source, folder)
    ]


def code_digest(source: str | None, folder: Path) -> str | None:
    """The digest of the file of a source, which is relative to a folder; None without such a file."""
    file = source_file(source or "", folder)
    return None if file is None else digest_of(file)


def _handovers(held: Mapping[str, Held]) -> tuple[set[tuple[str, str]], dict[str, str]]:
    """The unfinished hand-overs of states: (host, id) of each new unit that still waits for the state of a running
    unit, and by id the host of each unit whose state a new, connected unit already has.
    """
    by_name = defaultdict[str, dict[tuple[str, str], HeldUnit]](dict)
    for host, one in held.items():
        for unit, known in one.units.items():
            if known.order.state_name is not None and known.stop is None:
                by_name[known.order.state_name][host, unit] = known
    undone, replaced = set[tuple[str, str]](), dict[str, str]()
    for units in by_name.values():
        waiting = {place for place, known in units.items() if known.handover == "waits"}
        new = {
            unit
            for (host, unit), known in units.items()
            if known.handover == "has it" and _is_connected(held, host, unit)
        }
        if len(waiting) < len(units):
            undone |= waiting
        if not waiting:
            for (host, unit), known in units.items():
                if known.handover == "is asked" and known.successor in new:
                    replaced[unit] = host
    return undone, replaced


def _states_given(held: Mapping[str, Held], kept: Mapping[str, str], states: Mapping[str, bytes]) -> Iterator[OrderTo]:
    """Yield orders that let kept units continue: those that wait for the state of a unit that is gone, and those
    that were asked for their state and stay.
    """
    for unit, host in kept.items():
        known = held[host].units[unit]
        if known.handover == "waits":
            yield host, GiveStateOrder(unit, states.get(known.order.state_name or ""), {}, {})
        elif known.handover == "is asked":
            yield host, GiveStateOrder(unit, None, {}, {})


def _is_connected(held: Mapping[str, Held], host: str, unit: str) -> bool:
    here = held[host]
    return any(unit in (wire.inlet.unit, wire.stream.unit) for wire in here.wires) or any(
        export.stream is not None and export.stream.unit == unit for export in here.exports.values()
    )


def _is_told(unit: HeldUnit) -> bool:
    return unit.stop is not None and unit.stop.is_told


def _told(held: Mapping[str, Held], ended: Sequence[tuple[str, str]], taken: Collection[str]) -> dict[str, str]:
    """The hosts of the ended units that can still process their input: they are ready, and no other unit has their id,
    neither a `taken` one nor one that comes earlier.
    """
    told = dict[str, str]()
    for host, unit in ended:
        known = held[host].units[unit]
        if unit not in told.keys() | taken and known.labor_us is not None:
            told[unit] = host
    return told


def _latest(states: Mapping[str, Mapping[str, HeldState]]) -> dict[str, bytes]:
    """The latest state of each name."""
    known = sorted((one.at_ns, host, name, one.state) for host, here in states.items() for name, one in here.items())
    return {name: state for *_, name, state in known}


def _kept(
    held: Mapping[str, Mapping[str, HeldUnit]],
    library: Mapping[str, Transformation],
    stopping: Mapping[str, str],
    undone: Collection[tuple[str, str]] = (),
) -> tuple[dict[str, str], list[tuple[str, str]]]:
    """The hosts of kept units by id, and (host, id) of the units to end. A unit is kept if `library` would start it in
    the same way now, it was not told to stop, and its start is not `undone`.

    If several units have one id, the first is kept, unless one of them is `stopping`.
    """
    kept, ended = dict[str, str](), list[tuple[str, str]]()
    for host, units in held.items():
        for unit, known in units.items():
            transformation = library.get(known.label)
            is_as_wanted = transformation is not None and unit_order(unit, transformation, None) == known.order
            is_free = unit not in kept.keys() | stopping.keys() and (host, unit) not in undone
            if is_as_wanted and known.stop is None and is_free:
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
    states: Mapping[str, bytes],
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
        {unit: _stopping_unit(held[host].units[unit], host, held[host].now_s) for unit, host in stopping.items()},
        states,
        {unit: held[host].now_s - running[unit].since_s for unit, host in units.items()},
        max((one.last_wire for one in held.values()), default=0),
        {unit for unit, one in running.items() if not one.is_active},
    )


def _stopping_unit(known: HeldUnit, host: str, now_s: float) -> StoppingUnit:
    order, stop = known.order, known.stop
    stop_s = None if order.stop_us is None else order.stop_us / 1e6
    return StoppingUnit(known.label, host, 0.0 if stop is None else now_s - stop.at_s, stop_s, order.state_name)


def _as_wired(unit: str, label: str, host: str, routes: Sequence[Route]) -> ComputationUnit:
    """A unit with the subscriptions and publications of its wires."""
    feeds = tuple(Subscription(one.inlet.input, one.stream) for one in routes if one.inlet.unit == unit)
    published = tuple(
        Publication(one.stream.port, one.inlet.port)
        for one in routes
        if one.inlet.is_outlet and one.stream.unit == unit
    )
    return ComputationUnit(unit, label, feeds, published, host)
