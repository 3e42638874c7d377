"""The wiring of a counted solution, given the number of running units of each group and their hosts."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from ortools.graph.python.max_flow import SimpleMaxFlow

from cfgplan.domain import ComputationUnit, Publication, Stream, Subscription
from cfgplan.planners.exact.candidates import Candidates, HostName
from cfgplan.planners.exact.model import Model
from cfgplan.planners.solving.clock import ContradictionError


class _Consumer(NamedTuple):
    """An input of a unit, or a target, with the streams that it may take and those that it has.

    It is known by the unit's id and the input's name, or by "" and the target's label.
    """

    who: tuple[str, str]
    number: int
    streams: Sequence[Stream]
    old: Sequence[Stream] = ()


class CountedWiring:
    """The wiring of counted units: `values` are those of a model of groups, `hosts_of` the hosts of each group's units.

    `candidates` are the units of all groups.
    """

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
        """Return the units, wired; units that stay are unchanged."""
        demands = list(self._demands())
        limited = [demand for demand in demands if any(map(self._serves, demand.streams))]
        taken = {demand.who: _first(demand) for demand in demands if demand not in limited}
        taken |= self._shared_out(limited)
        topics: dict[str, list[Publication]] = defaultdict(list)
        for target in self._candidates.environment.stream_targets:
            for stream in taken.get(("", target.label), ()):
                topics[stream.unit].append(Publication(stream.port, target.topic))
        units = dict(self._stays)
        for i in self._host_of.keys() - units.keys():
            id_, kind = self._all[i].id, self._all[i].transformation
            wires = [Subscription(p.name, stream) for p in kind.inputs for stream in taken[id_, p.name]]
            units[i] = ComputationUnit(id_, kind.label, tuple(wires), tuple(topics[id_]), self._host_of[i])
        return [units[i] for i in sorted(units)]

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
                yield _Consumer((self._all[i].id, port.name), number, streams, old.get(port.name, ()))
        for target in self._candidates.environment.stream_targets:
            publishes = self._model.publishes[target.label]
            sources = {(group_of[s.unit], s.port) for s, taken in publishes.items() if self._values[taken.index]}
            there = [s for s in self._running(target.tag) if index_of[s.unit] not in self._stays]
            streams = [stream for stream in there if (group_of[stream.unit], stream.port) in sources]
            if streams:
                yield _Consumer(("", target.label), 1, streams)

    def _shared_out(self, demands: Sequence[_Consumer]) -> dict[tuple[str, str], list[Stream]]:
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

        ways: dict[tuple[int, int], tuple[tuple[str, str], Stream]] = {}
        for demand in demands:
            arc(demand.who, "sink", demand.number)
            for stream in demand.streams:
                serves = self._serves(stream)
                arc("source", stream, serves - kept[stream] if serves else len(demands))
                arc((demand.who, stream.unit), demand.who, 1)
                ways[arc(stream, (demand.who, stream.unit), 1)] = demand.who, stream
        flow = SimpleMaxFlow()
        tails, heads = zip(*arcs, strict=True)
        numbers = flow.add_arcs_with_capacity(np.array(tails), np.array(heads), np.array(list(arcs.values())))
        flow.solve(nodes["source"], nodes["sink"])
        if flow.optimal_flow() < sum(demand.number for demand in demands):
            raise ContradictionError("the streams that are counted can't be shared out")
        taken: dict[tuple[str, str], list[Stream]] = {demand.who: [] for demand in demands}
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
