"""The exact planner for the paper's future work: quality, hosts, conflicts, instances, spares.

First plans are made without search, then by the solver among few transformations of least reduced cost, and among more
(kernel search). Landmarks over units bound the cost and exclude expensive units; the solver proves the rest in the one
model.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import replace

from cfgplan.planners.bounding.bounds import Bound, cheapest_way, tightened
from cfgplan.planners.exact.best_case import least_of_all, least_prices_us
from cfgplan.planners.exact.candidates import Candidates
from cfgplan.planners.exact.first_plans import FirstPlans
from cfgplan.planners.exact.quality_chains import ChainCut, has_chains
from cfgplan.planners.exact.quality_cuts import chain_cuts
from cfgplan.planners.exact.remaining import Remaining, named_landmarks
from cfgplan.planners.exact.solve_state import SolveState
from cfgplan.planners.networks.core import Floats
from cfgplan.planners.solving.arrays import np
from cfgplan.planners.tuning import attempts_among
from cfgplan.planning import Feature


def plan_fleet(candidates: Candidates, state: SolveState, last: Collection[str]) -> None:
    """Look for first plans, one of them of the transformations in `last`, then for the best plan and its proof."""
    problem, clock = state.problem, state.clock
    _count(candidates, state)
    if clock.tuning.is_solver_only:
        if state.is_cost_proven:
            candidates, _ = _left(candidates, state)
        _solve(candidates, state)
        return
    least_us, rewired, started = least_of_all(candidates)
    state.raise_bound(least_us)
    clock.end("closure")
    first = FirstPlans(candidates, state)
    known = candidates.kinds.keys() & set(last)
    is_known = bool(known) and first.offer(first.units_of(known))
    is_too_dear = problem.survive is not None  # each attempt needs spares
    first.look(0 if is_too_dear or is_known else _attempts(candidates))
    clock.end("first plans")
    if state.best is not None and state.best.key == (state.min_unused, (), least_us, rewired, started):
        state.prove_cost()
        state.are_ties_proven = True
        return
    _search(candidates, state, first)


def solve_by_full_model(candidates: Candidates, state: SolveState) -> None:
    """Leave all to the solver, in the model of all wires of all candidates, without bounds and first plans."""
    _count(candidates, state)
    _solve(candidates, state, is_apart=True)


def _count(candidates: Candidates, state: SolveState) -> None:
    state.counts |= {"candidates": len(candidates.all), "conflicts": 0}
    required = candidates.environment.required
    state.min_unused = sum(not candidates.of(label) for label in required)


def _search(candidates: Candidates, state: SolveState, first: FirstPlans) -> None:
    """Search among few transformations, then among all that bounds leave.

    Where quality is priced, the few are those that the linear relaxation with chains uses.
    """
    clock, tuning = state.clock, state.clock.tuning.fleet
    is_chained = has_chains(candidates)
    is_cut = is_chained and bool(least_prices_us(candidates))
    if not is_chained or (not is_cut and len(candidates.network.labels) >= tuning.many):
        look_among_few(candidates, state, first)
    if state.is_over:
        return
    candidates, landmarks = _left(candidates, state)
    cuts, share = chain_cuts(candidates, landmarks, clock) if is_cut else ([], None)
    clock.end("bounds")
    if share is not None:
        _look_among_used(candidates, state, cuts, share)
    _solve(candidates, state, landmarks, cuts)


def _left(candidates: Candidates, state: SolveState) -> tuple[Candidates, list[tuple[list[str], int]]]:
    """The candidates that bounds leave, and landmarks of all plans."""
    left, network = remaining_by_bounds(candidates, state), candidates.network
    landmarks: list[tuple[list[str], int]] = []
    if left.bound is not None:
        is_short = Feature.QUALITY not in candidates.problem.features
        landmarks = [*named_landmarks(left.bound, network, is_short=is_short)]
        state.counts["landmarks"] = len(landmarks)
    return (candidates.among(left.names(network)) if left.is_complete else candidates), landmarks


def _look_among_used(candidates: Candidates, state: SolveState, cuts: Iterable[ChainCut], share: Floats) -> None:
    """Search among the incumbent's transformations and those that run to a `share` in the relaxation."""
    from cfgplan.planners.exact.search import Search

    used = _best(state) | {candidates.all[i].transformation.label for i in np.flatnonzero(share > 1e-6)}
    tuning = state.clock.tuning.fleet
    if tuning.fewer * len(used) < len(candidates.kinds):
        Search(candidates.among(used), state, is_all=False, cuts=cuts).run(tuning.look)


def _solve(
    candidates: Candidates,
    state: SolveState,
    landmarks: Iterable[tuple[list[str], int]] = (),
    cuts: Iterable[ChainCut] = (),
    *,
    is_apart: bool = False,
) -> None:
    from cfgplan.planners.exact.search import Search

    search = Search(candidates, state, is_apart=is_apart, landmarks=landmarks, cuts=cuts)
    state.clock.end("model")
    search.run()
    state.clock.end("search")


def remaining_by_bounds(candidates: Candidates, state: SolveState) -> Remaining:
    """Leave out transformations by reduced costs, and raise the proven bound.

    Hosts, transfers, failures, conflicts and numbers only add to the cost, and quality adds at least its least price.
    """
    network, everything = candidates.network, np.arange(len(candidates.network.labels))
    if len(network.targets) < len(candidates.environment.targets):
        return Remaining(everything, 0, is_complete=False)
    cost = candidates.least_us
    prices_us = sum(least_prices_us(candidates).values())
    largest_us = state.largest_us
    most = int(cost.sum()) if largest_us is None else largest_us - prices_us
    bound = tightened(Bound(network.core, cost), most, most, state.clock)
    state.raise_bound(bound.value + prices_us)
    if largest_us is None:
        return Remaining(everything, bound.value, bound, is_complete=False)
    waiting = {c.transformation.label for c in candidates.all if c.may_wait and bound.value + c.waiting_cost_us <= most}
    part = Remaining.by(bound, most)
    kept = [*map(int, part.labels), *network.pinned, *candidates.numbers(waiting)]
    state.counts["left by bounds"] = len(set(kept))
    return replace(part, labels=np.unique(np.array(kept, np.int64)))


def _by_reduced_cost(candidates: Candidates, bound: Bound | None) -> list[str]:
    """The transformations by their reduced costs, the least first; empty without a bound."""
    if bound is None:
        return []
    _, before = cheapest_way(bound.core, bound.residual)
    least = (before[:-1] + bound.residual).tolist()
    names = [candidates.network.labels[i] for i in bound.core.labels.tolist()]
    return [name for _, name in sorted(zip(least, names, strict=True))]


def look_among_few(candidates: Candidates, state: SolveState, first: FirstPlans) -> None:
    """Search among the incumbent's transformations and a growing number of others; offer plans and raise the bound."""
    from cfgplan.planners.exact.search import Search

    tuning = state.clock.tuning
    is_small = len(candidates.network.labels) < 2 * min(tuning.fleet.sizes)
    order = [] if is_small else _by_reduced_cost(candidates, remaining_by_bounds(candidates, state).bound)
    sizes = [size for size in tuning.fleet.sizes if 2 * size <= len(order)]

    def among(size: int) -> Candidates:
        return candidates.among(_best(state).union(order[:size]))

    if sizes:
        FirstPlans(among(sizes[0]), state).look(_attempts(candidates))
    first.look(_attempts(candidates))
    for size in state.clock.each(sizes, 1):
        Search(among(size), state, is_all=False).run(tuning.fleet.look)


def _attempts(candidates: Candidates) -> int:
    """Return how many members of a first plan are tried to be left out: where quality counts, as many in small problems
    as in large ones, since their proof takes longer.
    """
    tuning, asks_for_quality = candidates.clock.tuning, Feature.QUALITY in candidates.problem.features
    return tuning.begin.attempts if asks_for_quality else attempts_among(candidates.network.labels, tuning)


def _best(state: SolveState) -> set[str]:
    """The labels of the incumbent's transformations; empty without an incumbent."""
    return set() if state.best is None else {unit.transformation for unit in state.best.units}
