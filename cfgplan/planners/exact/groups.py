"""Groups of interchangeable units and kinds of interchangeable hosts, which a model counts instead of naming them."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace
from typing import Final

from cfgplan.onward import grouped
from cfgplan.planners.exact.candidates import Candidates, HostKind
from cfgplan.planners.exact.rules import RULES
from cfgplan.planners.exact.tracking import Tracking, in_cycles
from cfgplan.planning import Feature

NAMED: Final = frozenset({Feature.QUALITY, Feature.LATENCY, Feature.SURVIVAL})
"""The features by which it matters which unit feeds which, everywhere."""


def is_countable(candidates: Candidates) -> bool:
    """Whether units are counted: many units or hosts may take each other's place, and no stream has a price."""
    problem, environment = candidates.problem, candidates.environment
    kinds = candidates.kinds
    is_carried = any(port.bytes_per_s for kind in kinds.values() for port in kind.outputs)
    return (
        NAMED.isdisjoint(problem.features)
        and not environment.links
        and not (environment.transfer_us and is_carried and environment.hosts)
        and not (Feature.ORDER in problem.features and problem.max_cost_us is not None)
        and _is_much_smaller(candidates)
    )


def _is_much_smaller(candidates: Candidates) -> bool:
    """Whether groups have fewer places than units, and many times fewer if some units are told apart."""
    firsts = {kind.first for kind in host_kinds(candidates)}
    grouped_places = sum(len(firsts & candidates.all[group[0]].places.keys()) for group in groups_of(candidates))
    places = sum(len(candidate.places) for candidate in candidates.all)
    if _explicit_units(candidates):
        return places >= candidates.clock.tuning.fleet.shared * grouped_places
    return places > grouped_places


def groups_of(candidates: Candidates) -> list[tuple[int, ...]]:
    """The candidates in groups, in their order: the new units of a transformation together, each running one alone.

    New units are alone too if it matters who feeds them.
    """
    apart = _explicit_units(candidates)
    running = [(i,) for i, candidate in enumerate(candidates.all) if candidate.running is not None]
    new = [(i, c.transformation.label) for i, c in enumerate(candidates.all) if c.running is None]
    together = grouped((i if label in apart else label, i) for i, label in new)
    return [*running, *map(tuple, together.values())]


def _explicit_units(candidates: Candidates) -> set[str]:
    """The transformations whose units are no group: the model says for each unit who feeds it, or whom it feeds."""
    all_of, cycles = candidates.all, in_cycles(candidates)
    apart = {all_of[i].transformation.label for i in Tracking.of(candidates).units | cycles}
    found = set(apart)
    for label, kind in candidates.kinds.items():
        for port in kind.inputs:
            if port.is_explicit or label in apart:
                found.add(label)
                if port.count != 1:
                    found.update(all_of[i].transformation.label for i in candidates.feeders(port.tag))
    return found


def host_kinds(candidates: Candidates) -> list[HostKind]:
    """The kinds of hosts that units may be on; one where something runs is of its own kind."""
    if not candidates.environment.hosts:
        return [*candidates.hosts]
    firsts = [candidates.all[group[0]] for group in groups_of(candidates)]
    occupied = {host for first in firsts if first.running for host in first.hosts}
    environment, kinds = candidates.environment, defaultdict[object, list[HostKind]](list)
    asked = [rule.trait for rule in RULES if rule.trait is not None and rule.is_asked_by(candidates.problem.features)]
    for host in candidates.hosts:
        places = [(n, first.places.get(host.first)) for n, first in enumerate(firsts)]
        there = tuple((n, place.cost_us, *sorted(place.takes.items())) for n, place in places if place is not None)
        own = host.first if host.first in occupied else None
        traits = tuple(trait(environment, environment.host[host.first or ""]) for trait in asked)
        kinds[own, host.rent_us, tuple(host.rooms.items()), there, traits].append(host)
    return [replace(hosts[0], names=tuple(host.first for host in hosts)) for hosts in kinds.values()]
