"""What is known before the search of a flat fleet whose targets ask for quality: a good plan, and so narrow ranges."""

from __future__ import annotations

from cfgplan.planners.cpsat.bounds import Bound
from cfgplan.planners.cpsat.greedy import first_plan
from cfgplan.planners.cpsat.tightening import tightened
from cfgplan.planners.fleet.best_case import bound_by_price
from cfgplan.planners.fleet.candidates import Candidates
from cfgplan.planners.fleet.flat import Flat
from cfgplan.planners.fleet.quality_chains import ChainCut
from cfgplan.planners.fleet.quality_cuts import chain_cuts
from cfgplan.planners.fleet.quality_plan import QualityPlanner, can_be_planned
from cfgplan.planners.fleet.standing import Standing

ATTEMPTS = 30
"""How many members of the cheapest plan are tried to be done without."""


def begin_with_quality(candidates: Candidates, standing: Standing) -> list[ChainCut]:
    """Offer a good plan, and bound what targets weigh by what it costs; returns cuts on chains of streams."""
    asked = {wish.attribute for target in candidates.environment.targets for wish in target.quality}
    flat = Flat(candidates) if asked else None
    if flat is None or flat.is_impossible:
        return []
    clock, graph, cost = standing.clock, flat.graph(), flat.costs()
    cheapest = first_plan(graph, cost, ATTEMPTS, clock.is_over)
    most_us = int(cost.sum() if cheapest is None else cost[sorted(cheapest)].sum())
    bound = tightened(Bound(graph.core, cost), most_us, most_us, clock)
    landmarks = [bound.core.labels[one.members].tolist() for one in bound.landmarks]
    planner = None
    if can_be_planned(candidates):
        planner = QualityPlanner(candidates, candidates.environment.quality[asked.pop()], clock)
    cuts, share = chain_cuts(flat, landmarks, clock)
    if planner is not None:
        plan = planner.best([cheapest and {flat.labels[label].unit for label in cheapest}], share)
        if plan is not None:
            best_us = standing.offer(planner.units(plan))[1]
            bound_by_price(candidates, best_us - bound.value)
    return cuts


def is_weighed(candidates: Candidates) -> bool:
    """Whether a target charges for quality."""
    return any(wish.weight_us for target in candidates.environment.targets for wish in target.quality)
