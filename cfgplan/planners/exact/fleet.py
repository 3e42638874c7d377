"""The exact planner for what the paper leaves to the future: quality, hosts, conflicts, instances, spares.

First plans are made without search. Where it does not matter who feeds whom, landmarks and a model of what is where
prove the cost. All else goes to a model that tells inputs apart where it has to.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from threading import Event
from typing import TYPE_CHECKING

from cfgplan.planners.exact.best_case import bound_by_price, least_of_all, leave_out_what_is_too_bad
from cfgplan.planners.exact.candidates import Candidates
from cfgplan.planners.exact.first_plans import FirstPlans
from cfgplan.planners.exact.flat import Flat
from cfgplan.planners.exact.flatness import is_flat
from cfgplan.planners.exact.quality_start import QualityStart
from cfgplan.planners.exact.running import offer_what_runs
from cfgplan.planners.exact.standing import Standing
from cfgplan.planners.solving.clock import Clock
from cfgplan.planners.tuning import USUAL, Tuning
from cfgplan.planning import Notion, Plan, Problem, Progress
from cfgplan.reasons import unmet_reasons

if TYPE_CHECKING:
    from cfgplan.planners.exact.flat_search import FlatSearch

__all__ = ["plan"]


def plan(
    problem: Problem,
    last: Collection[str] = (),
    *,
    time_limit_s: float | None = None,
    report: Callable[[Progress], None] | None = None,
    stop: Event | None = None,
    tuning: Tuning = USUAL,
) -> Plan:
    """The optimal update, see `planning.Planner`; `stop` ends it early with the best plan so far, as Ctrl-C does.

    `last` are the transformations of the last plan: a first plan is made of them if possible.
    """
    clock = Clock(time_limit_s, stop, tuning)
    standing = Standing(problem, clock, report)
    clock.run(lambda: _bring_forward(standing, last), standing.plan)
    clock.end("search")
    return standing.plan()


def _bring_forward(standing: Standing, last: Collection[str]) -> None:
    """Go through the stages, from what runs to a proof."""
    problem, clock = standing.problem, standing.clock
    if not clock.tuning.is_solver_only:
        offer_what_runs(standing)
    candidates = Candidates(problem, clock=clock)
    if reasons := unmet_reasons(problem, possible=candidates.possible):
        standing.is_infeasible, standing.reasons = True, reasons
        clock.end("closure")
        return
    standing.counts = {"candidates": len(candidates.all), "conflicts": 0}
    standing.fewest_unused = sum(not candidates.of(label) for label in problem.environment.required)
    if clock.tuning.is_solver_only:
        _solve(candidates, standing)
        return
    least_us, started = least_of_all(candidates)
    standing.raise_bound(least_us)
    clock.end("closure")
    first = FirstPlans(candidates, standing)
    known = candidates.labels & set(last)
    is_known = bool(known) and first.offer(first.units_of(known))
    attempts = 0 if problem.survive is not None or is_known else clock.tuning.begin.attempts
    first.look(attempts)  # each attempt needs spares where failures are to be survived
    clock.end("first plans")
    if standing.best is not None and standing.best.key == (standing.fewest_unused, least_us, 0, started):
        standing.prove_cost()
        standing.are_ties_proven = True
        return
    if Notion.SURVIVAL not in problem.notions:  # a hot spare may get any quality
        leave_out_what_is_too_bad(candidates)
    _search(candidates, standing, first)


def _search(candidates: Candidates, standing: Standing, first: FirstPlans) -> None:
    """Search a flat fleet by labels on hosts. What is open then, and all else, goes to the model of who feeds whom."""
    clock = standing.clock
    if is_flat(candidates):
        search = _solve_flat(candidates, standing, first)
        clock.end("flat")
        standing.are_ties_proven = search is not None and search.is_done
        if search is None or standing.are_ties_proven or standing.is_infeasible or clock.is_over():
            return
        if standing.is_cost_proven:
            candidates = candidates.among(search.left())
    from cfgplan.planners.exact.kernels import left_by_bounds, look_among_few_of

    if not standing.is_cost_proven:
        look_among_few_of(candidates, standing, first)
    left = left_by_bounds(candidates, standing)
    clock.end("bounds")
    _solve(candidates.among(left.labels), standing, left.landmarks)


def _solve(candidates: Candidates, standing: Standing, landmarks: Iterable[tuple[list[str], int]] = ()) -> None:
    """Run the solver to the end, in the model of who feeds whom."""
    from cfgplan.planners.exact.search import Search

    search = Search(candidates, standing, landmarks=landmarks)
    standing.clock.end("model")
    search.run()


def _solve_flat(candidates: Candidates, standing: Standing, first: FirstPlans) -> FlatSearch | None:
    """Search a flat fleet until its cost is proven. Returns the last search; None if no plan is possible."""
    from cfgplan.planners.exact.flat_search import FlatSearch  # the solver takes long to import
    from cfgplan.planners.exact.kernels import look_among_few, well_below_best_us

    problem, clock = candidates.problem, standing.clock
    slice_s, bound = clock.tuning.fleet.round, None
    quality = QualityStart(candidates, standing, first)
    flat = Flat(candidates)
    is_probing = bool(problem.environment.hosts) and not flat.is_impossible
    if is_probing:
        bound = look_among_few(flat, standing)
        slice_s *= 2
    elif standing.best is not None and quality.is_bounded_only and len(flat.labels) >= clock.tuning.fleet.many:
        bound = look_among_few(flat, standing)
    while not flat.is_impossible:
        limit_us = well_below_best_us(standing) if is_probing else None
        search = FlatSearch(flat, standing, slice_s, bound=bound, limit_us=limit_us, cuts=quality.cuts)
        has_ended = search.run()
        if standing.is_cost_proven or clock.is_over() or (has_ended and limit_us is None):
            return search
        is_probing, bound = False, None
        if limit_us is not None:
            continue
        slice_s *= clock.tuning.fleet.growth
        quality.look_closer()
        if standing.best is not None and Notion.QUALITY in problem.notions:
            bound_by_price(candidates, standing.best.key.cost_us - search.least_us)
            flat = Flat(candidates)
    standing.prove_infeasible()
    return None
