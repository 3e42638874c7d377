"""Transformations alike: they meet the same demands, so that a cheapest plan has at most one of them.

Without the later of two, in a grounded order, all that it gave is still given, and earlier. So it must cost something,
and nobody may want two different ones.
"""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING

import numpy as np

from cfgplan.planners.cpsat.core import Ints
from cfgplan.planners.cpsat.network import Graph

if TYPE_CHECKING:
    from cfgplan.planners.cpsat.model import Model


def alike(network: Graph, cost: Ints) -> Ints:
    """A number for each label, equal for those of which a cheapest plan has at most one."""
    distinct = {network.fact_of_tag[p.tag] for t in network.transformations for p in t.inputs if p.distinct is not None}
    gives = network.core.gives
    first: dict[bytes, int] = {}
    kinds = np.arange(len(cost))
    for label in np.flatnonzero(cost).tolist():
        facts = gives[label]
        if distinct.isdisjoint(facts.tolist()):
            kinds[label] = first.setdefault(facts.tobytes(), label)
    return kinds


def one_of_those_alike_is_enough(model: Model) -> None:
    """Of new units that meet the same demands one runs, and those that need something need it together."""
    if model.tracked:
        return
    site = model.site
    ports = [port for candidate in site.candidates for port in candidate.transformation.inputs]
    demands = {site.feeders(tag) for tag in (*(p.tag for p in ports), *(t.tag for t in site.environment.targets))}
    given: dict[int, list[tuple[int, ...]]] = defaultdict(list)
    for feeders in sorted(demands):
        for feeder in feeders:
            given[feeder].append(feeders)
    apart = {feeder for port in ports if port.distinct is not None for feeder in site.feeders(port.tag)}
    groups: dict[tuple[tuple[int, ...], ...], list[int]] = defaultdict(list)
    for unit, candidate in enumerate(site.candidates):
        if candidate.running is None and unit not in apart:
            groups[tuple(given[unit])].append(unit)
    for units in groups.values():
        if len(units) > 1:
            model.cp.add_at_most_one(model.runs[unit] for unit in units)
            _needs_are_shared(model, units)


def _needs_are_shared(model: Model, units: list[int]) -> None:
    needing: dict[int, list[int]] = defaultdict(list)
    for unit in units:
        for hub in sorted(_hubs(model, unit)):
            needing[hub].append(unit)
    for hub, sharing in needing.items():
        if len(sharing) > 1:
            model.cp.add_at_most_one([model.literals[hub].negated(), *(model.runs[unit] for unit in sharing)])


def _hubs(model: Model, unit: int) -> set[int]:
    """The hubs through which a new unit is fed."""
    ports = model.site.candidates[unit].transformation.inputs
    return {model.hub(port.tag).index for port in ports if not port.feedback and not model.is_explicit(unit, port)}
