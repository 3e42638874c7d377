"""What is done before the search where targets ask for quality: a good plan, cuts, narrower bounds."""

from __future__ import annotations

from cfgplan.planners.bounding.bounds import Bound, tightened
from cfgplan.planners.exact.best_case import bound_by_price, demands_of_quality, least_prices_us
from cfgplan.planners.exact.candidates import Candidates
from cfgplan.planners.exact.first_plans import FirstPlans
from cfgplan.planners.exact.quality_chains import ChainCut
from cfgplan.planners.exact.quality_cuts import CLOSE, QUICK, Spreads, chain_cuts
from cfgplan.planners.exact.quality_plan import QualityPlanner, can_be_planned
from cfgplan.planners.exact.standing import Standing
from cfgplan.planners.networks.greedy import cost_of, first_plan
from cfgplan.planning import Notion


class QualityStart:
    """Offers a good plan, finds cuts on chains of streams, and bounds what targets weigh by the plan's cost.

    It `is_asked` for where one attribute counts and one stream is best for all, and `is_weighed` if that has a price.
    """

    def __init__(self, candidates: Candidates, standing: Standing, first: FirstPlans) -> None:
        self.candidates, self.standing, self._first = candidates, standing, first
        self.cuts: list[ChainCut] = []
        wishes = [wish for target in candidates.environment.targets for wish in target.quality]
        self._asked = sorted({wish.attribute for wish in wishes})
        self.is_asked = (
            len(self._asked) == 1
            and Notion.SURVIVAL not in candidates.problem.notions
            and not any(demands_of_quality(candidates).values())
        )
        self.is_weighed = self.is_asked and any(wish.weight_us for wish in wishes)
        self._least_us, self._is_close = 0, False
        if self.is_weighed:
            self._look(QUICK)

    def look_closer(self) -> None:
        """Narrow the bounds by a better plan; the first time look for cuts again, and take more time."""
        if self.is_asked and not self._is_close:
            self._is_close = True
            self._look(CLOSE)
        else:
            self._narrow()

    def _narrow(self) -> None:
        if self.standing.largest_us is not None:
            bound_by_price(self.candidates, self.standing.largest_us - self._least_us)
            self.candidates = self.candidates.among(self.candidates.labels)

    def _look(self, spreads: Spreads) -> None:
        candidates, clock = self.candidates, self.standing.clock
        network, cost = candidates.network, candidates.least_us
        if len(network.targets) < len(candidates.environment.targets):
            return
        cheapest = first_plan(network, cost, clock.tuning.begin.attempts, clock)
        planner = None
        if can_be_planned(candidates):
            planner = QualityPlanner(candidates, candidates.environment.quality[self._asked[0]], clock)
        way = cheapest and candidates.first_of_each(network.labels[n] for n in cheapest)
        if planner is not None and way is not None and planner.total_us(way) is not None:
            self._first.offer(way)
        # A plan that is good may be dear: landmarks must hold of all, not of the cheapest alone.
        all_us = int(cost.sum())
        enough_us = all_us if cheapest is None else cost_of(cost, cheapest)
        bound = tightened(Bound(network.core, cost), enough_us, all_us, clock)
        self.standing.raise_bound(bound.value + sum(least_prices_us(candidates).values()))
        self.cuts, share = chain_cuts(candidates, bound, clock, spreads)
        if planner is not None:
            plan = planner.best([way], share)
            if plan is not None:
                self._first.offer(plan)
        self._least_us = bound.value
        self._narrow()
