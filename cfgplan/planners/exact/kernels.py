"""Good plans for a fleet before anything is proven: the problem among few units, then among more (kernel search).

Units of least reduced cost come first.
"""

from __future__ import annotations

from dataclasses import dataclass

from cfgplan.planners.bounding.bounds import Bound, cheapest_way, tightened
from cfgplan.planners.exact.best_case import least_prices_us
from cfgplan.planners.exact.candidates import Candidates
from cfgplan.planners.exact.first_plans import FirstPlans
from cfgplan.planners.exact.standing import Standing
from cfgplan.planning import Notion


@dataclass(frozen=True)
class Shortlist:
    """The transformations that a plan no dearer than the incumbent may have, and landmarks that every such plan hits.

    `order` sorts the transformations by reduced cost, the least first. Running them costs `least_us` or more.
    """

    labels: frozenset[str]
    least_us: int = 0
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
    cost = candidates.least_us
    prices_us = sum(least_prices_us(candidates).values())
    largest_us = standing.largest_us
    most = int(cost.sum()) if largest_us is None else largest_us - prices_us
    bound = tightened(Bound(network.core, cost), most, most, standing.clock)
    standing.raise_bound(bound.value + prices_us)
    names = [network.labels[i] for i in bound.core.labels.tolist()]
    known = bound.landmarks if Notion.QUALITY in candidates.problem.notions else bound.short()
    landmarks = tuple(([names[i] for i in one.counted.tolist()], one.least) for one in known)
    _, before = cheapest_way(bound.core, bound.residual)
    least = (before[:-1] + bound.residual).tolist()
    order = tuple(name for _, name in sorted(zip(least, names, strict=True)))
    standing.counts["landmarks"] = len(landmarks)
    if largest_us is None:
        return Shortlist(everything, bound.value, order, landmarks)
    left = {name for name, may in zip(names, bound.may_be_used(most).tolist(), strict=True) if may}
    left |= {network.labels[i] for i in network.pinned}
    left |= {c.transformation.label for c in candidates.all if c.may_wait and bound.value + c.waiting_cost_us <= most}
    standing.counts["left by bounds"] = len(left)
    return Shortlist(frozenset(left), bound.value, order, landmarks)


def look_among_few(candidates: Candidates, standing: Standing, first: FirstPlans) -> None:
    """Search among the incumbent's transformations and more and more others; offer plans and raise the bound."""
    from cfgplan.planners.exact.search import Search

    tuning, order = standing.clock.tuning, left_by_bounds(candidates, standing).order
    sizes = [size for size in tuning.fleet.sizes if 2 * size <= len(order)]

    asked = {c.transformation.label for i, c in enumerate(candidates.all) if candidates.is_asked_for(i)}

    def among(size: int) -> Candidates:
        return candidates.among(_best(standing).union(order[:size], asked))

    if sizes:
        FirstPlans(among(sizes[0]), standing).look(tuning.begin.attempts)
    first.look(tuning.begin.attempts)
    for size in standing.clock.each(sizes, 1):
        Search(among(size), standing, is_all=False).run(tuning.fleet.look)


def _best(standing: Standing) -> set[str]:
    """The incumbent's transformations; none if there is no incumbent."""
    return set() if standing.best is None else {unit.transformation for unit in standing.best.units}
