"""Groups of interchangeable units and kinds of interchangeable hosts, which a model counts instead of naming them."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace
from itertools import chain

from networkx import DiGraph, is_directed_acyclic_graph

from cfgplan.domain import ALL, InputPort
from cfgplan.onward import grouped
from cfgplan.planners.exact.candidates import Candidates, HostKind
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
"""The features that a model of groups handles."""


def is_countable(candidates: Candidates) -> bool:
    """Whether units are counted: no feature depends on single wires, and units or hosts are interchangeable.

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
    if len(groups_of(candidates)) < len(candidates.all):
        return True
    return not all(kind.is_one for kind in host_kinds(candidates))


def _feeds(candidates: Candidates) -> DiGraph[str]:
    tags = {port.tag for kind in candidates.kinds.values() for port in kind.inputs}
    givers = {tag: {candidates.all[i].transformation.label for i in candidates.feeders(tag)} for tag in tags}
    inputs = [(label, port.tag) for label, kind in candidates.kinds.items() for port in kind.inputs]
    return DiGraph((giver, label) for label, tag in inputs for giver in givers[tag])


def groups_of(candidates: Candidates) -> list[tuple[int, ...]]:
    """The candidates in groups, in their order: the new units of a transformation together, each running one alone."""
    running = [(i,) for i, candidate in enumerate(candidates.all) if candidate.running is not None]
    new = grouped((c.transformation.label, i) for i, c in enumerate(candidates.all) if c.running is None)
    return [*running, *map(tuple, new.values())]


def host_kinds(candidates: Candidates) -> list[HostKind]:
    """The kinds of hosts that units may be on; one where something runs is of its own kind."""
    if not candidates.environment.hosts:
        return [*candidates.hosts]
    firsts = [candidates.all[group[0]] for group in groups_of(candidates)]
    occupied = {host for first in firsts if first.running for host in first.hosts}
    kinds: dict[object, list[HostKind]] = defaultdict(list)
    for host in candidates.hosts:
        places = [(n, first.places.get(host.first)) for n, first in enumerate(firsts)]
        there = tuple((n, place.cost_us, *sorted(place.takes.items())) for n, place in places if place is not None)
        own = host.first if host.first in occupied else None
        kinds[own, host.rent_us, tuple(host.rooms.items()), there].append(host)
    return [replace(hosts[0], names=tuple(host.first for host in hosts)) for hosts in kinds.values()]
