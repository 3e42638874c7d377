"""The candidates whose feeders matter: a rule asks what a unit runs for, or units might feed each other in a cycle."""

from __future__ import annotations

from collections.abc import Iterator, Set
from typing import NamedTuple

from cfgplan.onward import grouped, reached
from cfgplan.planners.exact.candidates import Candidates


class Tracking(NamedTuple):
    """Sets of candidates, by their numbers."""

    idle_feeders: frozenset[int]
    """Those that may feed inputs which start nothing."""
    keeping_each_other: frozenset[int]
    """Those of which several might need each other only, so that none of them could be left out."""
    units: frozenset[int]
    """These, required ones, and all downstream of them: those whose feeders matter."""

    @classmethod
    def of(cls, candidates: Candidates) -> Tracking:
        idle_feeders, keeping_each_other = _feeders_of_idle_inputs(candidates), _keeping_each_other(candidates)
        required = (i for i, c in enumerate(candidates.all) if c.may_run and c.transformation.required)
        apart = idle_feeders | keeping_each_other
        company = candidates.environment.companions if apart else frozenset()
        return cls(idle_feeders, keeping_each_other, _downstream_of(candidates, sorted(apart.union(required)), company))


def in_cycles(candidates: Candidates) -> frozenset[int]:
    """The candidates that may feed each other in a cycle without feedback inputs."""
    from networkx import DiGraph, strongly_connected_components

    kinds = candidates.kinds
    tags = {(label, port.tag) for label, kind in kinds.items() for port in kind.inputs if not port.feedback}
    providers = {tag: {candidates.all[i].transformation.label for i in candidates.feeders(tag)} for _, tag in tags}
    graph = DiGraph((provider, label) for label, tag in sorted(tags) for provider in providers[tag])
    cycles = (
        cycle for cycle in strongly_connected_components(graph) if len(cycle) > 1 or graph.has_edge(*cycle, *cycle)
    )
    return frozenset(i for cycle in cycles for label in cycle for i in candidates.units_of(label))


def _feeders_of_idle_inputs(candidates: Candidates) -> frozenset[int]:
    tags = {port.tag for kind in candidates.kinds.values() for port in kind.inputs if port.starts_nothing}
    return frozenset(feeder for tag in tags for feeder in candidates.feeders(tag))


def _keeping_each_other(candidates: Candidates) -> frozenset[int]:
    """The candidates that may run in a cycle only for a number or for company, each of them needed by another.

    So may those that others run with, or that numbers ask for, if they feed a cycle that feedback or company closes.
    """
    kinds, asked = candidates.kinds, candidates.environment.companions
    asked |= {label for label, kind in kinds.items() if kind.min_instances}
    several = [label for label in sorted(asked & kinds.keys()) if len(candidates.units_of(label)) > 1]
    if not several:
        return frozenset()
    from networkx import MultiDiGraph, strongly_connected_components

    cycle_of: dict[str, int] = {}
    graph: MultiDiGraph[str] = MultiDiGraph()
    closing = {(other, label) for label, kind in kinds.items() for other in kind.beside if other in kinds}
    graph.add_edges_from(closing)
    feeds: set[tuple[str, str]] = set()
    for label, kind in kinds.items():
        for port in kind.inputs:
            providers = {candidates.all[i].transformation.label for i in candidates.feeders(port.tag)}
            feeds.update((provider, label) for provider in providers if not port.starts_nothing)
            closing.update((provider, label) for provider in providers if port.feedback and not port.starts_nothing)
    graph.add_edges_from(feeds)
    for number, cycle in enumerate(strongly_connected_components(graph)):
        cycle_of.update(dict.fromkeys(cycle, number))
    closed = {cycle_of[one] for one, other in closing if cycle_of[one] == cycle_of[other]}
    feeding = {one for one, other in feeds if cycle_of[one] == cycle_of[other] and cycle_of[one] in closed}
    return frozenset(i for label in several if label in feeding for i in candidates.units_of(label))


def _downstream_of(candidates: Candidates, starts: list[int], company: Set[str]) -> frozenset[int]:
    """Some candidates and all that they may feed, or run with if they are `company`, directly or through others."""
    if not starts:
        return frozenset()
    inputs = [(i, c.transformation.inputs) for i, c in enumerate(candidates.all) if c.may_run]
    needing = grouped((port.tag, i) for i, ports in inputs for port in ports)
    fed_by = grouped((feeder, tag) for tag in needing for feeder in candidates.feeders(tag))

    def users(i: int) -> Iterator[int]:
        label = candidates.all[i].transformation.label
        beside = enumerate(candidates.all) if label in company else ()
        yield from (user for user, c in beside if label in c.transformation.beside and c.may_run)
        for tag in fed_by[i]:
            yield from needing.pop(tag, ())

    return frozenset(reached(starts, users))
