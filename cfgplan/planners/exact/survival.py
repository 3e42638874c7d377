"""Single failures in the constraint model, as landmarks that have to be hit twice.

A landmark of a target is a set of placements (transformations, on hosts where these matter). Each way to meet the
target runs a unit at one of them. After the failure of a unit the others can still meet all targets exactly if every
landmark has two units there: one of them may be the failing one, and a lone cold spare does not meet the target now.
After the failure of a host every landmark needs a unit on another one. There are too many landmarks to name, so those
that a solution misses are added, round by round.

If the number of units at a placement matters, only units beyond a certain number count: with at most that number at
each placement, the target can't be met.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass

from ortools.sat.python.cp_model import IntVar, LinearExpr

from cfgplan.domain import ComputationUnit, Target
from cfgplan.planners.exact.candidates import Candidates, HostName, Placement
from cfgplan.planners.exact.model import Model
from cfgplan.planners.exact.pruning import needed_in_all
from cfgplan.planners.exact.survivors import (
    UnitsByPlacement,
    are_counted,
    are_met,
    failures,
    placement_of,
    survive_without,
    unmet,
)
from cfgplan.planners.networks.reach import Reach
from cfgplan.planners.solving.engine import at_least


@dataclass(frozen=True)
class Missed:
    """A landmark that has too few units: one in all or, with a `host`, none on another host.

    `beyond` has its placements, each with a number: only the units of the placement beyond that number count.
    """

    beyond: frozenset[tuple[Placement, int]]
    host: str | None = None


class Survival:
    """Finds the failures that a configuration does not survive, and demands the landmarks that it misses."""

    def __init__(self, candidates: Candidates) -> None:
        self.candidates = candidates
        dear: dict[Placement, int] = {}
        self._most: Counter[Placement] = Counter()
        for candidate in candidates.all:
            placements = {
                placement_of(candidates.environment, candidate.transformation.label, host) for host in candidate.hosts
            }
            for placement in placements:
                dear[placement] = max(dear.get(placement, 0), candidate.cost_us)
            self._most.update(placements)
        if not are_counted(candidates):
            self._most = Counter(dict.fromkeys(dear, 1))
        self._by_cost = sorted(dear, key=lambda placement: (-dear[placement], placement[0], placement[1] or ""))
        self._known: set[Missed] = set()

    def missed(self, units: Collection[ComputationUnit]) -> list[Missed]:
        """Return the landmarks that have too few units in a configuration, one for each failure and target."""
        if self.candidates.problem.survive is None:
            return []
        found = [
            Missed(self._landmark(targets, failure.left), failure.host)
            for failure in failures(self.candidates, units)
            for targets in unmet(self.candidates, failure)
        ]
        return list(dict.fromkeys(found))

    def demand(self, model: Model, missed: Collection[Missed]) -> bool:
        """Demand enough units of every missed landmark. Returns whether one of them is new."""
        new = [each for each in missed if each not in self._known]
        self._known.update(new)
        for each in new:
            least = 2 if each.host is None else 1
            counting: list[IntVar] = []
            for placement, number in sorted(each.beyond, key=str):
                there = [
                    literal for host, literal in self._there(model, placement) if each.host is None or host != each.host
                ]
                counting += there if number == 0 else _beyond(model, there, number, least)
            at_least(model.cp, least, counting)
        return bool(new)

    def needless_spares(self, model: Model, true: Collection[int], units: list[ComputationUnit]) -> list[int]:
        """Return the candidates that a solution runs as spares although its `units` survive all failures without them.

        Empty if that does no harm: they feed no input that starts nothing, and take no stream from one.
        """
        there = {unit.id: unit for unit in units}
        said = {i: there[self.candidates.all[i].id] for i, spare in model.spares.items() if spare.index in true}
        needless = [i for i, unit in said.items() if survive_without(self.candidates, units, unit)]
        spares = {unit.id for i, unit in said.items() if i not in needless}
        needed = needed_in_all(self.candidates.problem, units, spares) if needless else set()
        for unit in units if needless else ():
            idle = self.candidates.environment.transformation[unit.transformation].idle_inputs
            for s in unit.subscriptions:
                takes_place = s.stream in model.serves and model.unit_of(s.stream) in model.idle_feeders
                if (s.port in idle and s.stream.unit not in needed) or (takes_place and unit.id not in needed):
                    return needless
        return []

    def forbid_spares(self, model: Model, true: Collection[int], needless: Collection[int]) -> None:
        """Forbid these spares beside all other units of the solution, which survive each failure without them."""
        states = [(i, literal) for i in model.runs_on for _, literal in model.there_on(i)]
        for spare in needless:
            others = [literal.negated() for i, literal in states if literal.index in true and i != spare]
            model.cp.add_bool_or([model.spares[spare].negated(), *others])

    def _there(self, model: Model, placement: Placement) -> Iterator[tuple[HostName, IntVar]]:
        """Yield the `is_there` booleans of a placement's units, with their hosts."""
        for i in self.candidates.units_of(placement[0]):
            for host, literal in model.there_on(i):
                if placement_of(self.candidates.environment, placement[0], host) == placement:
                    yield host, literal

    def _landmark(self, targets: tuple[Target, ...], left: UnitsByPlacement) -> frozenset[tuple[Placement, int]]:
        """Placements with a number of units each: with no more of each than its number, the targets are not met.

        The numbers begin with the units that are left, and grow as far as they can, those of expensive placements
        first. A placement with all its units is no part of the landmark.
        """
        candidates = self.candidates
        without = dict(left)
        reach = Reach(candidates.network.core, candidates.numbers(label for label, _ in left))
        for placement in candidates.clock.each(self._by_cost, 1):
            there = without.get(placement, 0)
            if not there:
                for number in candidates.numbers([placement[0]]):
                    reach.add(number)
            for most in range(self._most[placement], there, -1):
                without[placement] = most
                if not are_met(candidates, reach, without, targets):
                    break
            else:
                if there:
                    without[placement] = there
                else:
                    without.pop(placement, None)
                    reach.take_back()
        return frozenset(
            (placement, without.get(placement, 0))
            for placement in self._by_cost
            if without.get(placement, 0) < self._most[placement]
        )


def _beyond(model: Model, there: list[IntVar], number: int, most: int) -> list[IntVar]:
    """Up to `most` booleans: the first holds only if more than a `number` of some others hold, the next if one more."""
    found = []
    for more in range(1, min(most, len(there) - number) + 1):
        found.append(model.cp.new_bool_var(""))
        model.cp.add(LinearExpr.sum(there) >= number + more).only_enforce_if(found[-1])
    return found
