"""Good plans for a fleet before anything is proven: the problem among few units, then among more (kernel search).

Units of least reduced cost come first.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from cfgplan.planners.bounding.bounds import Bound, cheapest_way
from cfgplan.planners.bounding.tightening import tightened
from cfgplan.planners.exact.best_case import least_prices_us, leave_out_what_is_too_bad
from cfgplan.planners.exact.candidates import Candidates
from cfgplan.planners.exact.first_plans import FirstPlans
from cfgplan.planners.exact.flat import Flat
from cfgplan.planners.exact.flat_search import FlatSearch
from cfgplan.planners.exact.standing import Standing


def look_among_few(flat: Flat, standing: Standing) -> Bound:
    """Search among the incumbent's transformations and more and more others; offer what is found.

    Returns the bound by which the others are ordered.
    """
    candidates = flat.candidates
    _look_among(_best(standing), candidates, standing, None)
    bound = Bound(flat.graph().core, flat.costs())
    most = sum(flat.cost_us)
    if standing.best is not None:
        most = standing.best.key.cost_us - sum(least_prices_us(candidates).values())
    bound = tightened(bound, most, most, standing.clock)
    order = _by_least_cost(flat, bound)
    for size in standing.clock.tuning.fleet.sizes:
        if 2 * size > len(order) or standing.clock.is_over():
            break
        more = {candidates.all[unit].transformation.label for unit in order[:size]}
        limit_us = well_below_best_us(standing) if candidates.environment.hosts else None
        _look_among(_best(standing) | more, candidates, standing, limit_us)
    return bound


def _look_among(labels: Collection[str], candidates: Candidates, standing: Standing, limit_us: int | None) -> None:
    few = Candidates(candidates.problem, candidates.closure, labels, candidates.clock)
    leave_out_what_is_too_bad(few)
    flat = Flat(few)
    if not flat.is_impossible:
        FlatSearch(flat, standing, standing.clock.tuning.fleet.look, is_all=False, limit_us=limit_us).run()


@dataclass(frozen=True)
class Shortlist:
    """The transformations that a plan no dearer than the incumbent may have, and landmarks that every such plan hits.

    `order` sorts the transformations by reduced cost, the least first.
    """

    labels: frozenset[str]
    order: tuple[str, ...] = ()
    landmarks: tuple[tuple[list[str], int], ...] = ()


def left_by_bounds(candidates: Candidates, standing: Standing) -> Shortlist:
    """Leave out transformations by reduced costs, and raise the proven bound.

    Hosts, transfers, failures, conflicts and numbers only add to the cost, and quality adds at least its least price.
    """
    network = candidates.network
    everything = frozenset(candidate.transformation.label for candidate in candidates.all)
    if len(network.targets) < len(candidates.environment.targets):
        return Shortlist(everything)
    cost = np.array([min(c.cost_us for c in candidates.of(label)) for label in network.labels], np.int64)
    prices_us = sum(least_prices_us(candidates).values())
    largest_us = standing.largest_us
    most = int(cost.sum()) if largest_us is None else largest_us - prices_us
    bound = tightened(Bound(network.core, cost), most, most, standing.clock)
    standing.raise_bound(bound.value + prices_us)
    names = [network.labels[i] for i in bound.core.labels.tolist()]
    landmarks = tuple(([names[i] for i in one.counted.tolist()], one.least) for one in bound.short())
    _, before = cheapest_way(bound.core, bound.residual)
    least = (before[:-1] + bound.residual).tolist()
    order = tuple(name for _, name in sorted(zip(least, names, strict=True)))
    standing.counts["landmarks"] = len(landmarks)
    if largest_us is None:
        return Shortlist(everything, order, landmarks)
    left = {name for name, may in zip(names, bound.may_be_used(most).tolist(), strict=True) if may}
    left |= {network.labels[i] for i in network.pinned}
    left |= {c.transformation.label for c in candidates.all if c.may_wait and bound.value + c.waiting_cost_us <= most}
    standing.counts["left by bounds"] = len(left)
    return Shortlist(frozenset(left), order, landmarks)


def look_among_few_of(candidates: Candidates, standing: Standing, first: FirstPlans) -> None:
    """Search among the incumbent's transformations and more and more others; offer plans and raise the bound."""
    from cfgplan.planners.exact.search import Search

    tuning, order = standing.clock.tuning, left_by_bounds(candidates, standing).order
    sizes = [size for size in tuning.fleet.sizes if 2 * size <= len(order)]

    def among(size: int) -> Candidates:
        return candidates.among(_best(standing).union(order[:size]))

    if sizes:
        FirstPlans(among(sizes[0]), standing).look(tuning.begin.attempts)
    first.look(tuning.begin.attempts)
    for size in standing.clock.each(sizes, 1):
        Search(among(size), standing, is_all=False).run(tuning.fleet.look)


def _best(standing: Standing) -> set[str]:
    """The incumbent's transformations; none if there is no incumbent."""
    return set() if standing.best is None else {unit.transformation for unit in standing.best.units}


def well_below_best_us(standing: Standing) -> int | None:
    """A limit so far below the incumbent's cost that it is refuted soon if no plan is within it.

    None without an incumbent.
    """
    if standing.best is None:
        return None
    best_us, parts = standing.best.key.cost_us, standing.clock.tuning.fleet.gap
    return best_us - (best_us - standing.bound_us) // parts - 1


def _by_least_cost(flat: Flat, bound: Bound) -> list[int]:
    """The units by their reduced cost, the least first."""
    _, before = cheapest_way(bound.core, bound.residual)
    least: dict[int, int] = {}
    for label, us in zip(bound.core.labels.tolist(), (before[:-1] + bound.residual).tolist(), strict=True):
        unit = flat.labels[label].unit
        least[unit] = min(us, least.get(unit, us))
    return sorted(least, key=lambda unit: (least[unit], unit))
