"""Groups of interchangeable units and kinds of interchangeable hosts, which a model counts instead of naming them."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain

from networkx import DiGraph, is_directed_acyclic_graph

from cfgplan.domain import ALL, InputPort
from cfgplan.onward import grouped
from cfgplan.planners.exact.candidates import Candidate, Candidates, HostName
from cfgplan.planning import Feature

COUNTABLE = frozenset(
    {
        Feature.HOSTS,
        Feature.CONFLICTS,
        Feature.BESIDE,
        Feature.INSTANCES,
        Feature.COUNTS,
        Feature.LIMITS,
        Feature.RUNS,
        Feature.ORDER,
    }
)
"""The features that the counting model handles."""


@dataclass(frozen=True)
class Group:
    """Candidates that may take each other's place: the new units of a transformation, or one that runs."""

    units: tuple[int, ...]
    first: Candidate

    @property
    def label(self) -> str:
        return self.first.transformation.label


@dataclass(frozen=True)
class HostKind:
    """Interchangeable hosts, or the only place (None) without hosts."""

    names: tuple[HostName, ...]
    rooms: Mapping[str, int]
    rent_us: int = 0
    """The rent of one host over the horizon, in microseconds."""

    @property
    def first(self) -> HostName:
        return self.names[0]

    def apart(self) -> list[HostKind]:
        """Each of the hosts as a kind of its own."""
        return [HostKind((name,), self.rooms, self.rent_us) for name in self.names]


def is_countable(candidates: Candidates) -> bool:
    """Whether the counting model applies: no feature depends on single wires, and units or hosts are interchangeable.

    No stream has a price on its way, and wirings close no cycles, whichever of the streams that match are taken.
    """
    problem, environment = candidates.problem, candidates.environment
    kinds = candidates.kinds
    is_carried = any(port.bytes_per_s for kind in kinds.values() for port in kind.outputs)
    return (
        problem.features <= COUNTABLE
        and not environment.required
        and not environment.links
        and not (environment.transfer_us and is_carried and environment.hosts)
        and not (Feature.ORDER in problem.features and problem.max_cost_us is not None)
        and all(map(_is_usual, chain.from_iterable(kind.inputs for kind in kinds.values())))
        and _are_there_several(candidates)
        and is_directed_acyclic_graph(_feeds(candidates))
    )


def _is_usual(port: InputPort) -> bool:
    return not (port.feedback or port.optional or port.distinct is not None or port.count == ALL)


def _are_there_several(candidates: Candidates) -> bool:
    """Whether there are new units of one transformation, or hosts, that may take each other's place."""
    groups = groups_of(candidates)
    return len(groups) < len(candidates.all) or any(len(kind.names) > 1 for kind in host_kinds(candidates, groups))


def _feeds(candidates: Candidates) -> DiGraph[str]:
    tags = {port.tag for kind in candidates.kinds.values() for port in kind.inputs}
    givers = {tag: {candidates.all[i].transformation.label for i in candidates.feeders(tag)} for tag in tags}
    inputs = [(label, port.tag) for label, kind in candidates.kinds.items() for port in kind.inputs]
    return DiGraph((giver, label) for label, tag in inputs for giver in givers[tag])


def groups_of(candidates: Candidates) -> list[Group]:
    """The groups of all candidates, in their order."""
    running = [Group((i,), candidate) for i, candidate in enumerate(candidates.all) if candidate.running is not None]
    new = grouped((c.transformation.label, i) for i, c in enumerate(candidates.all) if c.running is None)
    return [*running, *(Group(tuple(units), candidates.all[units[0]]) for units in new.values())]


def host_kinds(candidates: Candidates, groups: Sequence[Group]) -> list[HostKind]:
    """The kinds of hosts that units may be on; one where something runs is of its own kind."""
    environment, horizon_s = candidates.environment, candidates.problem.horizon_s
    if not environment.hosts:
        return [HostKind((None,), {})]
    occupied = {host for group in groups if group.first.running for host in group.first.hosts}
    resources = sorted({r for group in groups for place in group.first.places.values() for r in place.takes})
    kinds: dict[object, list[HostName]] = defaultdict(list)
    rooms_of: dict[HostName, dict[str, int]] = {}
    for host in environment.hosts:
        rooms = {each: room for each in resources if (room := host.room(each, horizon_s)) is not None}
        places = [(n, group.first.places.get(host.name)) for n, group in enumerate(groups)]
        there = tuple((n, place.cost_us, *sorted(place.takes.items())) for n, place in places if place is not None)
        own = host.name if host.name in occupied else None
        rooms_of[host.name] = rooms
        kinds[own, host.rent_us, tuple(rooms.items()), there].append(host.name)
    rents_us = {host.name: host.rent_us * horizon_s for host in environment.hosts}
    return [HostKind(tuple(names), rooms_of[names[0]], rents_us[str(names[0])]) for names in kinds.values()]
