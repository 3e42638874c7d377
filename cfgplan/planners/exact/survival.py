"""Single failures in the constraint model, as landmarks that have to be hit twice.

A landmark of a target is a set of sites (transformations, and hosts where these matter) of which every way to meet the
target runs one. After the failure of a unit the others can still meet all targets exactly if every landmark has two
units there: one of them may be the failing one, and a lone cold spare does not meet the target now. After the failure
of a host every landmark needs a unit on another one. There are too many landmarks to name, so those that a solution
misses are added, round by round.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from ortools.sat.python.cp_model import LinearExpr

from cfgplan.domain import ComputationUnit, Target
from cfgplan.planners.exact.candidates import Candidates
from cfgplan.planners.exact.model import Model
from cfgplan.planners.exact.reach import Reach
from cfgplan.planners.exact.survivors import Site, failures, is_met, site_of, unmet


@dataclass(frozen=True)
class Missed:
    """A landmark that has too few units: one in all or, with a `host`, none on another host."""

    sites: frozenset[Site]
    host: str | None = None


class Survival:
    """Finds the failures that a configuration does not survive, and demands the landmarks that it misses."""

    def __init__(self, candidates: Candidates) -> None:
        self.candidates = candidates
        dear: dict[Site, int] = {}
        for candidate in candidates.all:
            for host in candidate.hosts:
                site = site_of(candidates.environment, candidate.transformation.label, host)
                dear[site] = max(dear.get(site, 0), candidate.cost_us)
        self._by_cost = sorted(dear, key=lambda site: (-dear[site], site[0], site[1] or ""))
        self._known: set[Missed] = set()

    def missed(self, units: Collection[ComputationUnit]) -> list[Missed]:
        """The landmarks of which a configuration has too few units, one for each failure and target."""
        if self.candidates.problem.survive is None:
            return []
        found = [
            Missed(self._landmark(target, failure.left), failure.host)
            for failure in failures(self.candidates, units)
            for target in unmet(self.candidates, failure)
        ]
        return list(dict.fromkeys(found))

    def demand(self, model: Model, missed: Collection[Missed]) -> bool:
        """Demand enough units of every missed landmark. Returns whether one of them is new."""
        new = [each for each in missed if each not in self._known]
        self._known.update(new)
        for each in new:
            there = [
                (host, literal)
                for i, c in enumerate(self.candidates.all)
                for host, literal in (*model.runs_on[i].items(), *model.waits_on[i].items())
                if site_of(self.candidates.environment, c.transformation.label, host) in each.sites
            ]
            if each.host is None:
                model.cp.add(LinearExpr.sum([literal for _, literal in there]) >= 2)
            else:
                model.cp.add_bool_or([literal for host, literal in there if host != each.host])
        return bool(new)

    def _landmark(self, target: Target, left: Collection[Site]) -> frozenset[Site]:
        """All sites but a largest set that does not meet the target; the dear ones go into the set first."""
        candidates = self.candidates
        without = set(left)
        reach = Reach(candidates.network, candidates.numbers(label for label, _ in left))
        for site in candidates.clock.each(self._by_cost, 1):
            if site not in without:
                without.add(site)
                for number in candidates.numbers([site[0]]):
                    reach.add(number)
                if is_met(candidates, reach, without, target):
                    without.remove(site)
                    reach.take_back()
        return frozenset(self._by_cost) - without
