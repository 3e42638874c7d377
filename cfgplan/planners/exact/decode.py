"""Decode a solution into wired units: one of named units, or one of numbers of units in groups."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

from cfgplan.domain import ComputationUnit, InputPort, Stream, Target
from cfgplan.planners.exact.candidates import Candidates, HostName
from cfgplan.planners.exact.company import have_company
from cfgplan.planners.exact.rules import MAY_RUN_FOR_NOBODY
from cfgplan.planners.exact.wiring import wired
from cfgplan.planners.solving.arrays import np
from cfgplan.planners.solving.clock import ContradictionError
from cfgplan.planning import Feature

if TYPE_CHECKING:
    from cfgplan.planners.exact.model import Model  # the solver takes long to import


def decode(model: Model, true: Collection[int]) -> list[ComputationUnit] | None:
    """The units of a solution that something may need, wired; None if one that is needed is not grounded.

    `true` holds the indices of the true booleans. Units keep the streams they have wherever these are still there.
    """
    return _Decoding(model, true).units()


def decode_numbers(
    candidates: Candidates, model: Model, values: Sequence[int], hosts_of: Mapping[int, Sequence[HostName]]
) -> list[ComputationUnit]:
    """The units of a solution of a model of groups, wired; units that stay are unchanged.

    `values` are those of the model's variables, `hosts_of` the hosts of each group's units, and `candidates` the units
    of all groups. Raises ContradictionError if streams with a limited number of consumers can't be divided among them.
    """
    return _Numbers(candidates, model, values, hosts_of).units()


class _Decoding:
    """A solution of named units: each is wired as soon as something needs it."""

    def __init__(self, model: Model, true: Collection[int]) -> None:
        self.model, self.true = model, true
        self.candidates = model.candidates
        self.rank = model.support.grounded(true)
        self.host_of: dict[int, HostName] = {
            i: host for i, places in model.runs_on.items() for host, on in places.items() if on.index in self.rank
        }

    def units(self) -> list[ComputationUnit] | None:
        model, all_of = self.model, self.candidates.all
        published: dict[str, Stream] = {}
        for target in model.environment.stream_targets:
            stream = self._published(target)
            if stream is None:
                return None
            published[target.topic] = stream
        wanted = [model.to_run(label) for label in model.environment.wanted_to_run.values()]
        running = [[i for i in units if i in self.host_of] for units in wanted]
        if not all(running):
            return None
        first = {*map(model.unit_of, published.values()), *(units[0] for units in running)}
        ahead = sorted(first.union(filter(self.candidates.is_pinned, model.runs)))
        if MAY_RUN_FOR_NOBODY & model.problem.features:
            ahead += sorted(self.host_of.keys() - set(ahead))
        found: dict[int, HostName] = {}
        feeds: dict[tuple[int, str], tuple[Stream, ...]] = {}
        for i in ahead:
            if i in found:
                continue
            kind = all_of[i].transformation
            feeds |= {(i, port.name): self._fed(i, port) for port in kind.inputs}
            if i not in self.host_of or not all(feeds[i, port.name] for port in kind.needed_inputs):
                return None
            found[i] = self.host_of[i]
            ahead += [model.unit_of(stream) for port in kind.inputs for stream in feeds[i, port.name]]
        units = wired(self.candidates, found, feeds, published)
        if not self._are_enough(found) or not have_company(model.environment, units):
            return None
        return [*units, *self._spares()]

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


class _Consumer(NamedTuple):
    """An input of a unit, or a target, with the streams that it may take and those that it has.

    It is known by the unit's index and the input's name, or by None and the target's topic.
    """

    who: tuple[int | None, str]
    number: int
    streams: Sequence[Stream]
    old: Sequence[Stream] = ()


class _Numbers:
    """A solution of numbers of units: all are wired, so that limited streams can be shared out at once."""

    def __init__(
        self,
        candidates: Candidates,
        model: Model,
        values: Sequence[int],
        hosts_of: Mapping[int, Sequence[HostName]],
    ) -> None:
        assert model.candidates.groups is not None
        self._model, self._values, self._candidates = model, values, candidates
        self._all, groups = candidates.all, model.candidates.groups
        self._host_of: dict[int, HostName] = {}
        for n, hosts in hosts_of.items():
            self._host_of |= dict(zip(groups[n], hosts, strict=False))
        staying = (groups[n][0] for n, stays in model.stays.items() if values[stays.index])
        self._stays = {i: unit for i in staying if (unit := self._all[i].running) is not None}

    def units(self) -> list[ComputationUnit]:
        demands = list(self._demands())
        limited = [demand for demand in demands if any(map(self._serves, demand.streams))]
        taken = {demand.who: _first(demand) for demand in demands if demand not in limited}
        taken |= self._shared_out(limited)
        topics = [target.topic for target in self._candidates.environment.stream_targets]
        published = {topic: streams[0] for topic in topics for streams in [taken.get((None, topic), ())] if streams}
        feeds = {(unit, name): streams for (unit, name), streams in taken.items() if unit is not None}
        hosts = {i: self._host_of[i] for i in sorted(self._host_of.keys() - self._stays.keys())}
        new = dict(zip(hosts, wired(self._candidates, hosts, feeds, published), strict=True))
        return [unit for _, unit in sorted((self._stays | new).items())]

    def _serves(self, stream: Stream) -> int:
        """Return how many consumers may take a stream; 0: any number."""
        return self._all[self._candidates.index_of[stream.unit]].transformation.output[stream.port].serves or 0

    def _running(self, tag: str) -> list[Stream]:
        return [s for s in self._candidates.streams(tag) if self._candidates.index_of[s.unit] in self._host_of]

    def _demands(self) -> Iterator[_Consumer]:
        """The inputs of units that do not stay as they are, and the targets that such units meet."""
        index_of, group_of = self._candidates.index_of, self._model.candidates.index_of
        for i in sorted(self._host_of.keys() - self._stays.keys()):
            old = {} if (running := self._all[i].running) is None else running.feeds
            for port in self._all[i].transformation.inputs:
                streams, number = self._running(port.tag), port.count
                connects = self._model.connects.get((group_of[self._all[i].id], port.name))
                if connects is not None:
                    taken = {(group_of[s.unit], s.port) for s, one in connects.items() if self._values[one.index]}
                    streams, number = [s for s in streams if (group_of[s.unit], s.port) in taken], len(taken)
                yield _Consumer((i, port.name), number, streams, old.get(port.name, ()))
        for target in self._candidates.environment.stream_targets:
            publishes = self._model.publishes[target.label]
            sources = {(group_of[s.unit], s.port) for s, taken in publishes.items() if self._values[taken.index]}
            there = [s for s in self._running(target.tag) if index_of[s.unit] not in self._stays]
            streams = [stream for stream in there if (group_of[stream.unit], stream.port) in sources]
            if streams:
                yield _Consumer((None, target.topic), 1, streams)

    def _shared_out(self, demands: Sequence[_Consumer]) -> dict[tuple[int | None, str], list[Stream]]:
        """The streams that each demand takes where some serve only so many: a flow from streams to demands."""
        if not demands:
            return {}
        kept = Counter(s.stream for unit in self._stays.values() for s in unit.subscriptions)
        kept.update(Stream(unit.id, p.port) for unit in self._stays.values() for p in unit.publications)
        nodes: dict[object, int] = {}
        arcs: dict[tuple[int, int], int] = {}

        def arc(tail: object, head: object, most: int) -> tuple[int, int]:
            found = nodes.setdefault(tail, len(nodes)), nodes.setdefault(head, len(nodes))
            arcs[found] = most
            return found

        ways: dict[tuple[int, int], tuple[tuple[int | None, str], Stream]] = {}
        for demand in demands:
            arc(demand.who, "sink", demand.number)
            for stream in demand.streams:
                serves = self._serves(stream)
                arc("source", stream, serves - kept[stream] if serves else len(demands))
                arc((demand.who, stream.unit), demand.who, 1)
                ways[arc(stream, (demand.who, stream.unit), 1)] = demand.who, stream
        from ortools.graph.python.max_flow import SimpleMaxFlow

        flow = SimpleMaxFlow()
        tails, heads = zip(*arcs, strict=True)
        numbers = flow.add_arcs_with_capacity(np.array(tails), np.array(heads), np.array(list(arcs.values())))
        flow.solve(nodes["source"], nodes["sink"])
        if flow.optimal_flow() < sum(demand.number for demand in demands):
            raise ContradictionError("the streams that are counted can't be shared out")
        taken: dict[tuple[int | None, str], list[Stream]] = {demand.who: [] for demand in demands}
        for way, used in zip(arcs, flow.flows(numbers).tolist(), strict=True):
            if used and way in ways:
                who, stream = ways[way]
                taken[who].append(stream)
        return taken


def _first(demand: _Consumer) -> list[Stream]:
    """The streams of as many different units as are demanded, those that it has first."""
    of_units: dict[str, Stream] = {}
    for stream in (*(stream for stream in demand.old if stream in demand.streams), *demand.streams):
        of_units.setdefault(stream.unit, stream)
    return list(of_units.values())[: demand.number]
