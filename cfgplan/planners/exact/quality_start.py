"""What a flat fleet whose targets ask for quality is given before its search: a good plan, cuts, narrower bounds."""

from __future__ import annotations

from cfgplan.planners.bounding.bounds import Bound
from cfgplan.planners.bounding.tightening import tightened
from cfgplan.planners.exact.best_case import bound_by_price, least_prices_us
from cfgplan.planners.exact.candidates import Candidates
from cfgplan.planners.exact.first_plans import FirstPlans
from cfgplan.planners.exact.flat import Flat
from cfgplan.planners.exact.quality_chains import ChainCut
from cfgplan.planners.exact.quality_cuts import CLOSE, QUICK, Spreads, chain_cuts
from cfgplan.planners.exact.quality_plan import QualityPlanner, can_be_planned
from cfgplan.planners.exact.standing import Standing
from cfgplan.planners.networks.greedy import first_plan


class QualityStart:
    """Offers a good plan, finds cuts on chains of streams, and bounds what targets weigh by the plan's cost."""

    def __init__(self, candidates: Candidates, standing: Standing, first: FirstPlans) -> None:
        self.candidates, self.standing, self._first = candidates, standing, first
        self.cuts: list[ChainCut] = []
        wishes = [wish for target in candidates.environment.targets for wish in target.quality]
        self._asked = sorted({wish.attribute for wish in wishes})
        self._ahead = [CLOSE] if wishes else []
        self.is_bounded_only = bool(wishes) and not any(wish.weight_us for wish in wishes)
        if wishes and not self.is_bounded_only:
            self._look(QUICK)

    def look_closer(self) -> None:
        """Look again and take more time, once."""
        if self._ahead:
            self._look(self._ahead.pop())

    def _look(self, spreads: Spreads) -> None:
        candidates, clock = self.candidates, self.standing.clock
        flat = Flat(candidates)
        if flat.is_impossible:
            return
        graph, cost = flat.graph(), flat.costs()
        cheapest = first_plan(graph, cost, clock.tuning.begin.attempts, clock.is_over)
        planner = None
        if can_be_planned(candidates):
            planner = QualityPlanner(candidates, candidates.environment.quality[self._asked[0]], clock)
        way = cheapest and {flat.labels[label].unit for label in cheapest}
        if planner is not None and way is not None and planner.total_us(way) is not None:
            self._first.offer(way)
        # A plan that is good may be dear: landmarks must hold of all, not of the cheapest alone.
        all_us = int(cost.sum())
        enough_us = all_us if cheapest is None else int(cost[sorted(cheapest)].sum())
        bound = tightened(Bound(graph.core, cost), enough_us, all_us, clock)
        self.standing.raise_bound(bound.value + sum(least_prices_us(candidates).values()))
        landmarks = [bound.core.labels[one.members].tolist() for one in bound.landmarks]
        self.cuts, share = chain_cuts(flat, landmarks, clock, spreads)
        if planner is not None:
            plan = planner.best([way], share)
            if plan is not None:
                self._first.offer(plan)
        if self.standing.best is not None:
            bound_by_price(candidates, self.standing.best.key.cost_us - bound.value)
