"""Decode a solution into units: wired, named, and without units that nothing needs."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Collection, Iterable
from dataclasses import replace
from typing import TYPE_CHECKING

from cfgplan.domain import ComputationUnit, Environment, InputPort, Publication, Stream, Subscription, Target
from cfgplan.onward import grouped
from cfgplan.planners.exact.candidates import Candidates, HostName
from cfgplan.planners.exact.company import have_company
from cfgplan.planners.exact.rules import MAY_RUN_FOR_NOBODY
from cfgplan.planning import Feature, fresh_units

if TYPE_CHECKING:
    from cfgplan.planners.exact.model import Model  # the solver takes long to import


def decode(model: Model, true: Collection[int]) -> list[ComputationUnit] | None:
    """The units of a solution that something may need, wired; None if one that is needed is not grounded.

    `true` holds the indices of the true booleans. Units keep the streams they have wherever these are still there.
    """
    return _Decoding(model, true).units()


class _Decoding:
    def __init__(self, model: Model, true: Collection[int]) -> None:
        self.model, self.true = model, true
        self.candidates = model.candidates
        self.rank = model.support.grounded(true)
        self.host_of: dict[int, HostName] = {
            i: host for i, places in model.runs_on.items() for host, on in places.items() if on.index in self.rank
        }

    def units(self) -> list[ComputationUnit] | None:
        model, all_of = self.model, self.candidates.all
        topics: dict[int, list[Publication]] = defaultdict(list)
        for target in model.environment.stream_targets:
            stream = self._published(target)
            if stream is None:
                return None
            topics[model.unit_of(stream)].append(Publication(stream.port, target.topic))
        wanted = [model.to_run(label) for label in model.environment.wanted_to_run.values()]
        running = [[i for i in units if i in self.host_of] for units in wanted]
        if not all(running):
            return None
        first = {units[0] for units in running}
        ahead = sorted(first | {*topics, *filter(self.candidates.is_pinned, model.runs)})
        if MAY_RUN_FOR_NOBODY & model.problem.features:
            ahead += sorted(self.host_of.keys() - set(ahead))
        found: dict[int, ComputationUnit] = {}
        for i in ahead:
            if i in found:
                continue
            streams = {port.name: self._fed(i, port) for port in all_of[i].transformation.inputs}
            if i not in self.host_of or not all(streams[p.name] for p in all_of[i].transformation.needed_inputs):
                return None
            subscriptions = tuple(Subscription(name, stream) for name, taken in streams.items() for stream in taken)
            label = all_of[i].transformation.label
            found[i] = ComputationUnit(all_of[i].id, label, subscriptions, tuple(topics[i]), self.host_of[i])
            ahead += [model.unit_of(s.stream) for s in subscriptions]
        if not self._are_enough(found) or not have_company(model.environment, found.values()):
            return None
        return [*found.values(), *self._spares()]

    def _spares(self) -> list[ComputationUnit]:
        return [
            self.candidates.all[i].spare_on(host)
            for i, places in self.model.waits_on.items()
            for host, waits in places.items()
            if waits.index in self.true
        ]

    def _are_enough(self, units: Collection[int]) -> bool:
        """Whether as many units are grounded of each transformation as it asks for."""
        if Feature.INSTANCES not in self.model.problem.features:
            return True
        running = Counter(self.candidates.all[i].transformation.label for i in units)
        return all(running[t.label] >= t.min_instances for t in self.model.environment.library)

    def _published(self, target: Target) -> Stream | None:
        model = self.model
        choices = model.publishes[target.label]
        taken = next((stream for stream, publishes in choices.items() if publishes.index in self.true), None)
        if taken is None:
            there = [
                s for s in model.choices(target.tag) if s not in choices and self._place(s, target.host) is not None
            ]
            taken = min(there, key=model.unit_of, default=None)
        elif model.unit_of(taken) not in self.host_of:
            return None
        if taken is None or model.tells_ports:
            return taken
        running = self.candidates.all[model.unit_of(taken)].running
        old = [Stream(running.id, p.port) for p in running.publications if p.topic == target.topic] if running else []
        return self._port_of(taken, target.tag, old)

    def _fed(self, unit: int, port: InputPort) -> tuple[Stream, ...]:
        """Return the streams that feed an input: its present ones if the solution has them."""
        model, host = self.model, self.host_of.get(unit)
        running = self.candidates.all[unit].running
        old = () if running is None else running.feeds.get(port.name, ())
        if (unit, port.name) in model.connects:
            connects = model.connects[unit, port.name]
            taken = [stream for stream, connected in connects.items() if connected.index in self.true]
            return tuple(taken if model.tells_ports else [self._port_of(stream, port.tag, old) for stream in taken])
        if unit in model.stays and model.stays[unit].index in self.true and old:
            return old if all(self._place(stream, host) is not None for stream in old) else ()
        if not port.feedback and (key := model.hub_key(port.tag, host)) in model.meets:
            there = [stream for stream, taken in model.meets[key].items() if taken.index in self.rank]
        else:
            limit = len(self.rank) if port.feedback else self._wired_at(unit)
            streams = model.choices(port.tag)
            there = [s for s in streams if (place := self._place(s, host)) is not None and place < limit]
        if model.tells_ports:
            return tuple([s for s in there if s in old][:1] or there[:1])
        same = [s for s in old if self.candidates.gives(s, port.tag) and any(s.unit == one.unit for one in there)]
        return tuple(same[:1] or [self._port_of(stream, port.tag, ()) for stream in there[:1]])

    def _port_of(self, stream: Stream, tag: str, old: Iterable[Stream]) -> Stream:
        """The stream that one without a port stands for: an `old` one of its unit if that matches the tag."""
        return self.candidates.stream_of(self.model.unit_of(stream), tag, old)

    def _wired_at(self, unit: int) -> int:
        """The position of a unit in the order of derivation: its feeders come before it."""
        return max((self.rank.get(wired.index, 0) for wired in self.model.wired_on(unit).values()), default=0)

    def _place(self, stream: Stream, host: HostName) -> int | None:
        """The position of a stream on a host in the order of derivation."""
        ways = [self.rank[way.index] for way in self.model.known_ways(stream, host) if way.index in self.rank]
        return min(ways, default=None)


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
    now = environment.unit[unit.id].feeds if unit.id in environment.unit else {}
    ports = environment.transformation[unit.transformation].inputs
    distinct = [p for p in ports if p.distinct is not None and p.count == 1 and p.name in unit.feeds]
    alike = grouped((replace(port, name=""), port.name) for port in distinct)
    if not alike:
        return unit
    feeds = dict(unit.feeds)
    for names in alike.values():
        taken = {feeds[name] for name in names}
        kept = {now[name]: name for name in names if now.get(name) in taken}
        others = [name for name in names if name not in kept.values()]
        feeds |= dict(zip([*kept.values(), *others], [*kept, *sorted(taken - kept.keys())], strict=True))
    return replace(unit, subscriptions=tuple(Subscription(name, s) for name, streams in feeds.items() for s in streams))
