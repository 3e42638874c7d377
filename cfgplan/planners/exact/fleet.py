"""The exact planner for the paper's future work: quality, hosts, conflicts, instances, spares.

First plans are made without search, then by the solver among few transformations of least reduced cost, and among more
(kernel search). Landmarks over units bound the cost and exclude expensive units; the solver proves the rest in the one
model.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import replace

import numpy as np

from cfgplan.planners.bounding.bounds import Bound, cheapest_way, tightened
from cfgplan.planners.exact.best_case import least_of_all, least_prices_us
from cfgplan.planners.exact.candidates import Candidates
from cfgplan.planners.exact.first_plans import FirstPlans
from cfgplan.planners.exact.quality_chains import ChainCut, has_chains
from cfgplan.planners.exact.quality_cuts import chain_cuts
from cfgplan.planners.exact.remaining import Remaining, named_landmarks
from cfgplan.planners.exact.standing import Standing
from cfgplan.planners.networks.core import Floats
from cfgplan.planning import Feature


def plan_fleet(candidates: Candidates, standing: Standing, last: Collection[str]) -> None:
    """Look for first plans, one of them of the transformations in `last`, then for the best plan and its proof."""
    problem, clock = standing.problem, standing.clock
    _count(candidates, standing)
    if clock.tuning.is_solver_only:
        if standing.is_cost_proven:
            candidates, _ = _left(candidates, standing)
        _solve(candidates, standing)
        return
    least_us, rewired, started = least_of_all(candidates)
    standing.raise_bound(least_us)
    clock.end("closure")
    first = FirstPlans(candidates, standing)
    known = candidates.kinds.keys() & set(last)
    is_known = bool(known) and first.offer(first.units_of(known))
    attempts = 0 if problem.survive is not None or is_known else clock.tuning.begin.attempts
    first.look(attempts)  # each attempt needs spares where failures are to be survived
    clock.end("first plans")
    if standing.best is not None and standing.best.key == (standing.fewest_unused, (), least_us, rewired, started):
        standing.prove_cost()
        standing.are_ties_proven = True
        return
    _search(candidates, standing, first)


def solve_apart(candidates: Candidates, standing: Standing) -> None:
    """Leave all to the solver, in the model of all wires of all candidates, without bounds and first plans."""
    _count(candidates, standing)
    _solve(candidates, standing, is_apart=True)


def _count(candidates: Candidates, standing: Standing) -> None:
    standing.counts |= {"candidates": len(candidates.all), "conflicts": 0}
    required = candidates.environment.required
    standing.fewest_unused = sum(not candidates.of(label) for label in required)


def _search(candidates: Candidates, standing: Standing, first: FirstPlans) -> None:
    """Search among few transformations, then among all that bounds leave.

    Where quality is priced, the few are those that the linear relaxation with chains uses.
    """
    clock, tuning = standing.clock, standing.clock.tuning.fleet
    is_chained = has_chains(candidates)
    is_cut = is_chained and bool(least_prices_us(candidates))
    if not is_chained or (not is_cut and len(candidates.network.labels) >= tuning.many):
        look_among_few(candidates, standing, first)
    if standing.is_over:
        return
    candidates, landmarks = _left(candidates, standing)
    cuts, share = chain_cuts(candidates, landmarks, clock) if is_cut else ([], None)
    clock.end("bounds")
    if share is not None:
        _look_among_used(candidates, standing, cuts, share)
    _solve(candidates, standing, landmarks, cuts)


def _left(candidates: Candidates, standing: Standing) -> tuple[Candidates, list[tuple[list[str], int]]]:
    """The candidates that bounds leave, and landmarks of all plans."""
    left, network = left_by_bounds(candidates, standing), candidates.network
    landmarks: list[tuple[list[str], int]] = []
    if left.bound is not None:
        is_short = Feature.QUALITY not in candidates.problem.features
        landmarks = [*named_landmarks(left.bound, network, is_short=is_short)]
        standing.counts["landmarks"] = len(landmarks)
    return (candidates.among(left.names(network)) if left.is_complete else candidates), landmarks


def _look_among_used(candidates: Candidates, standing: Standing, cuts: Iterable[ChainCut], share: Floats) -> None:
    """Search among the incumbent's transformations and those that run to a `share` in the relaxation."""
    from cfgplan.planners.exact.search import Search

    used = _best(standing) | {candidates.all[i].transformation.label for i in np.flatnonzero(share > 1e-6)}
    tuning = standing.clock.tuning.fleet
    if tuning.fewer * len(used) < len(candidates.kinds):
        Search(candidates.among(used), standing, is_all=False, cuts=cuts).run(tuning.look)


def _solve(
    candidates: Candidates,
    standing: Standing,
    landmarks: Iterable[tuple[list[str], int]] = (),
    cuts: Iterable[ChainCut] = (),
    *,
    is_apart: bool = False,
) -> None:
    from cfgplan.planners.exact.search import Search

    search = Search(candidates, standing, is_apart=is_apart, landmarks=landmarks, cuts=cuts)
    standing.clock.end("model")
    search.run()
    standing.clock.end("search")


def left_by_bounds(candidates: Candidates, standing: Standing) -> Remaining:
    """Leave out transformations by reduced costs, and raise the proven bound.

    Hosts, transfers, failures, conflicts and numbers only add to the cost, and quality adds at least its least price.
    """
    network, everything = candidates.network, np.arange(len(candidates.network.labels))
    if len(network.targets) < len(candidates.environment.targets):
        return Remaining(everything, 0, is_complete=False)
    cost = candidates.least_us
    prices_us = sum(least_prices_us(candidates).values())
    largest_us = standing.largest_us
    most = int(cost.sum()) if largest_us is None else largest_us - prices_us
    bound = tightened(Bound(network.core, cost), most, most, standing.clock)
    standing.raise_bound(bound.value + prices_us)
    if largest_us is None:
        return Remaining(everything, bound.value, bound, is_complete=False)
    waiting = {c.transformation.label for c in candidates.all if c.may_wait and bound.value + c.waiting_cost_us <= most}
    part = Remaining.by(bound, most)
    kept = [*part.labels.tolist(), *network.pinned, *candidates.numbers(waiting)]
    standing.counts["left by bounds"] = len(set(kept))
    return replace(part, labels=np.unique(np.array(kept, np.int64)))


def _by_reduced_cost(candidates: Candidates, bound: Bound | None) -> list[str]:
    """The transformations by their reduced costs, the least first; empty without a bound."""
    if bound is None:
        return []
    _, before = cheapest_way(bound.core, bound.residual)
    least = (before[:-1] + bound.residual).tolist()
    names = [candidates.network.labels[i] for i in bound.core.labels.tolist()]
    return [name for _, name in sorted(zip(least, names, strict=True))]


def look_among_few(candidates: Candidates, standing: Standing, first: FirstPlans) -> None:
    """Search among the incumbent's transformations and a growing number of others; offer plans and raise the bound."""
    from cfgplan.planners.exact.search import Search

    tuning, order = standing.clock.tuning, _by_reduced_cost(candidates, left_by_bounds(candidates, standing).bound)
    sizes = [size for size in tuning.fleet.sizes if 2 * size <= len(order)]

    def among(size: int) -> Candidates:
        return candidates.among(_best(standing).union(order[:size]))

    if sizes:
        FirstPlans(among(sizes[0]), standing).look(tuning.begin.attempts)
    first.look(tuning.begin.attempts)
    for size in standing.clock.each(sizes, 1):
        Search(among(size), standing, is_all=False).run(tuning.fleet.look)


def _best(standing: Standing) -> set[str]:
    """The labels of the incumbent's transformations; empty without an incumbent."""
    return set() if standing.best is None else {unit.transformation for unit in standing.best.units}
