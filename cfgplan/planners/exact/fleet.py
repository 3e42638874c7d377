"""The exact planner for what the paper leaves to the future: quality, hosts, conflicts, instances, spares.

First plans are made without search, then by the solver among few transformations. Landmarks over units bound the cost
and leave out what is too dear; the solver proves the rest in the one model.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from math import inf

import numpy as np

from cfgplan.planners.exact.best_case import bound_by_price, least_of_all, least_prices_us, leave_out_what_is_too_bad
from cfgplan.planners.exact.candidates import Candidates
from cfgplan.planners.exact.first_plans import FirstPlans
from cfgplan.planners.exact.kernels import left_by_bounds, look_among_few
from cfgplan.planners.exact.quality_chains import ChainCut, has_chains
from cfgplan.planners.exact.quality_cuts import chain_cuts
from cfgplan.planners.exact.standing import Standing
from cfgplan.planners.networks.core import Floats
from cfgplan.planning import Notion


def plan_fleet(candidates: Candidates, standing: Standing, last: Collection[str]) -> None:
    """Bring a plan forward from first plans to a proof. A first plan is made of the transformations in `last`."""
    problem, clock = standing.problem, standing.clock
    standing.counts |= {"candidates": len(candidates.all), "conflicts": 0}
    standing.fewest_unused = sum(not candidates.of(label) for label in problem.environment.required)
    if clock.tuning.is_solver_only:
        _solve(candidates, standing)
        return
    least_us, rewired, started = least_of_all(candidates)
    standing.raise_bound(least_us)
    clock.end("closure")
    first = FirstPlans(candidates, standing)
    known = candidates.labels & set(last)
    is_known = bool(known) and first.offer(first.units_of(known))
    attempts = 0 if problem.survive is not None or is_known else clock.tuning.begin.attempts
    first.look(attempts)  # each attempt needs spares where failures are to be survived
    clock.end("first plans")
    if standing.best is not None and standing.best.key == (standing.fewest_unused, (), least_us, rewired, started):
        standing.prove_cost()
        standing.are_ties_proven = True
        return
    if Notion.SURVIVAL not in problem.notions:  # a hot spare may get any quality
        leave_out_what_is_too_bad(candidates)
        candidates = candidates.among(candidates.labels)
    _search(candidates, standing, first)


def _search(candidates: Candidates, standing: Standing, first: FirstPlans) -> None:
    """Search among few transformations, then among all that bounds leave.

    Where quality is priced, the few are those that the linear relaxation with chains uses. Prices narrow its bounds.
    """
    clock, tuning = standing.clock, standing.clock.tuning.fleet
    is_chained = has_chains(candidates)
    is_cut = is_chained and bool(least_prices_us(candidates))
    if not is_chained or (not is_cut and len(candidates.network.labels) >= tuning.many):
        look_among_few(candidates, standing, first)
    slices = [tuning.round * tuning.growth**number for number in range(tuning.rounds if is_chained else 0)]
    for slice_s in (*slices, inf):
        if standing.is_over:
            break
        left = left_by_bounds(candidates, standing)
        if is_chained and standing.largest_us is not None:
            bound_by_price(candidates, standing.largest_us - left.least_us)
        candidates = candidates.among(left.labels)
        cuts, share = chain_cuts(candidates, left.landmarks, clock) if is_cut else ([], None)
        clock.end("bounds")
        if share is not None:
            _look_among_used(candidates, standing, cuts, share)
        _solve(candidates, standing, left.landmarks, cuts, slice_s)
        is_cut = is_chained


def _look_among_used(candidates: Candidates, standing: Standing, cuts: Iterable[ChainCut], share: Floats) -> None:
    """Search among the incumbent's transformations and those that run to a `share` in the relaxation."""
    from cfgplan.planners.exact.search import Search

    used = {candidates.all[i].transformation.label for i in np.flatnonzero(share > 1e-6)}
    if standing.best is not None:
        used |= {unit.transformation for unit in standing.best.units}
    tuning = standing.clock.tuning.fleet
    if tuning.fewer * len(used) < len(candidates.labels):
        Search(candidates.among(used), standing, is_all=False, cuts=cuts).run(tuning.look)


def _solve(
    candidates: Candidates,
    standing: Standing,
    landmarks: Iterable[tuple[list[str], int]] = (),
    cuts: Iterable[ChainCut] = (),
    slice_s: float = inf,
) -> None:
    """Run the solver for `slice_s` of its own seconds, without bounds to the end."""
    from cfgplan.planners.exact.search import Search

    search = Search(candidates, standing, landmarks=landmarks, cuts=cuts)
    standing.clock.end("model")
    search.run(slice_s)
    standing.clock.end("search")
