"""Single failures in the constraint model, as landmarks that have to be hit twice.

A landmark of a target is a set of transformations of which every way to meet the target runs one. After the failure of
a unit the others can still meet all targets exactly if every landmark has two units there: one of them may be the
failing one, and a lone cold spare does not meet the target now. After the failure of a host every landmark needs a unit
on another one. There are too many landmarks to name, so those that a solution misses are added, round by round.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from ortools.sat.python.cp_model import LinearExpr

from cfgplan.domain import ComputationUnit, Target
from cfgplan.planners.exact.candidates import Candidates
from cfgplan.planners.exact.model import Model
from cfgplan.planners.exact.reach import Reach
from cfgplan.planners.exact.survivors import failures, is_met, unmet


@dataclass(frozen=True)
class Missed:
    """A landmark that has too few units: one in all or, with a `host`, none on another host."""

    labels: frozenset[str]
    host: str | None = None


class Survival:
    """Finds the failures that a configuration does not survive, and demands the landmarks that it misses."""

    def __init__(self, candidates: Candidates) -> None:
        self.candidates = candidates
        dear: dict[str, int] = {}
        for candidate in candidates.all:
            label = candidate.transformation.label
            dear[label] = max(dear.get(label, 0), candidate.cost_us)
        self._by_cost = sorted(dear, key=lambda label: (-dear[label], label))
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
            units = [i for i, c in enumerate(self.candidates.all) if c.transformation.label in each.labels]
            if each.host is None:
                model.cp.add(LinearExpr.sum([model.is_there[i] for i in units]) >= 2)
            else:
                places = [places for i in units for places in (model.runs_on[i], model.waits_on[i])]
                model.cp.add_bool_or([there for on in places for host, there in on.items() if host != each.host])
        return bool(new)

    def _landmark(self, target: Target, left: Collection[str]) -> frozenset[str]:
        """All transformations but a largest set that does not meet the target; the dear ones go into the set first."""
        candidates = self.candidates
        without = set(left)
        reach = Reach(candidates.network, candidates.numbers(left))
        for label in candidates.clock.each(self._by_cost, 1):
            if label not in without:
                without.add(label)
                for number in candidates.numbers([label]):
                    reach.add(number)
                if is_met(candidates, reach, without, target):
                    without.remove(label)
                    reach.take_back()
        return frozenset(self._by_cost) - without
