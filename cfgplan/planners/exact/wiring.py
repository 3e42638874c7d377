"""Units made of the streams that were chosen for them: wired, named, and with their inputs in canonical order."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

from cfgplan.domain import ComputationUnit, Environment, Publication, Stream, Subscription
from cfgplan.onward import grouped
from cfgplan.planners.exact.candidates import Candidates, HostName
from cfgplan.planning import fresh_units


def wired(
    candidates: Candidates,
    host_of: Mapping[int, HostName],
    feeds: Mapping[tuple[int, str], Iterable[Stream]],
    published: Mapping[str, Stream],
) -> list[ComputationUnit]:
    """The units of some candidates on their hosts, in this order.

    `feeds` has the streams of each input, by candidate and port, and `published` the stream of each topic.
    """
    topics = grouped((stream.unit, Publication(stream.port, topic)) for topic, stream in published.items())
    units = []
    for i, host in host_of.items():
        id_, kind = candidates.all[i].id, candidates.all[i].transformation
        subscriptions = tuple(Subscription(p.name, stream) for p in kind.inputs for stream in feeds[i, p.name])
        units.append(ComputationUnit(id_, kind.label, subscriptions, tuple(topics[id_]), host))
    return units


def named(candidates: Candidates, units: list[ComputationUnit]) -> list[ComputationUnit]:
    """Give new units the first free ids, in canonical order."""
    numbered = sorted((candidates.index_of[unit.id], unit) for unit in units)
    new = grouped((unit.transformation, unit) for i, unit in numbered if candidates.all[i].running is None)
    ids = fresh_units(candidates.environment, {label: len(these) for label, these in sorted(new.items())})
    name = {u.id: new_id for label, these in new.items() for u, new_id in zip(these, ids[label], strict=True)}

    def renamed(stream: Stream) -> Stream:
        return Stream(name.get(stream.unit, stream.unit), stream.port)

    return [
        replace(
            unit,
            id=name.get(unit.id, unit.id),
            subscriptions=tuple(Subscription(s.port, renamed(s.stream)) for s in unit.subscriptions),
        )
        for unit in units
    ]


def in_order(environment: Environment, unit: ComputationUnit) -> ComputationUnit:
    """The unit with interchangeable inputs in a canonical order: streams that feed it now keep their inputs."""
    ports = environment.transformation[unit.transformation].inputs
    distinct = [p for p in ports if p.distinct is not None and p.count == 1 and p.name in unit.feeds]
    if not distinct:
        return unit
    now = environment.unit[unit.id].feeds if unit.id in environment.unit else {}
    aggregated = grouped((replace(port, name=""), port.name) for port in distinct)
    feeds = dict(unit.feeds)
    for names in aggregated.values():
        taken = {feeds[name] for name in names}
        kept = {now[name]: name for name in names if now.get(name) in taken}
        others = [name for name in names if name not in kept.values()]
        feeds |= dict(zip([*kept.values(), *others], [*kept, *sorted(taken - kept.keys())], strict=True))
    return replace(unit, subscriptions=tuple(Subscription(name, s) for name, streams in feeds.items() for s in streams))
