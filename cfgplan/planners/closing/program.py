"""The linear program over landmarks: the cheapest fractions of labels that hit each of them.

Its dual is the best way to charge the landmarks. New landmarks only cut off the last solution, so that the dual simplex
method continues from there.
"""

from __future__ import annotations

from itertools import repeat
from typing import TYPE_CHECKING

from cfgplan.planners.bounding.bounds import Bound
from cfgplan.planners.bounding.landmarks import Landmark
from cfgplan.planners.networks.core import Core, Floats, Ints
from cfgplan.planners.networks.network import Network
from cfgplan.planners.solving.arrays import np
from cfgplan.planners.solving.clock import Clock

if TYPE_CHECKING:
    from ortools.linear_solver import pywraplp  # type: ignore[import-untyped]

FROM_THE_LAST_BASIS = "use_preprocessing: false use_dual_simplex: true initial_condition_number_threshold: 1e300"
"""With preprocessing, or doubts about the last basis, the engine would start over each time."""

FINEST, LARGEST_CHARGES = 1024, 2**58
"""Charges are integers in 1/FINEST of a cost unit, or in coarser parts if their sum would exceed LARGEST."""


def label_kinds(network: Network, cost: Ints) -> Ints:
    """Return a number for each label, equal for labels that meet the same demands: a cheapest plan has at most one of
    each.

    If a plan had two, the later one in a grounded order could go: the earlier one gives all that it gives. This holds
    only for labels that cost something, and whose facts are not demanded by a distinct group.
    """
    needed = (port for t in network.transformations for port in t.needed_inputs)
    distinct = {network.fact_of_tag[port.tag] for port in needed if port.distinct is not None}
    gives = network.core.gives
    first: dict[bytes, int] = {}
    kinds = np.arange(len(cost))
    for label in np.flatnonzero(cost).tolist():
        facts = gives[label]
        if distinct.isdisjoint(facts.tolist()):
            kinds[label] = first.setdefault(facts.tobytes(), label)
    return kinds


class Feeding:
    """The rows that say how used labels are fed; `uses` says how much of each label is used.

    A fact is needed as much as the labels that need it are used, and offered as much as its providers are used; labels
    of the same kind need it together. The prices of these rows are moved from facts to labels (Lagrangian relaxation:
    Geoffrion 1974). For any such prices, landmarks may be charged from the remaining costs.
    """

    def __init__(self, core: Core, kinds: Ints, engine: pywraplp.Solver, uses: list[pywraplp.Variable]) -> None:
        self._core = core
        needers = np.flatnonzero(core.needs.row_of_item < core.goal)
        labels, facts = core.needs.row_of_item[needers], core.needs.items[needers]
        pairs, self._pair = np.unique(kinds[labels] * len(core.providers) + facts, return_inverse=True)
        self._labels, self._needed = labels, pairs % len(core.providers)
        loops = np.isin(
            core.providers.row_of_item * core.goal + core.providers.items,
            facts * core.goal + labels,
        )
        self._fact_of_offer, self._offering = core.providers.row_of_item[~loops], core.providers.items[~loops]
        self._takes = np.ones(len(core.providers), np.int64) if core.takes is None else core.takes
        infinity = engine.infinity()
        wanted = set(core.needs[core.goal].tolist())
        needed = [
            engine.NumVar(float(i in wanted), 1.0 if i in wanted else infinity, "") for i in range(len(core.providers))
        ]
        self._offered = [engine.RowConstraint(0.0, infinity, "") for _ in needed]
        for row, needs, takes in zip(self._offered, needed, self._takes.tolist(), strict=True):
            row.SetCoefficient(needs, -float(takes))
        for fact, label in zip(self._fact_of_offer.tolist(), self._offering.tolist(), strict=True):
            self._offered[fact].SetCoefficient(uses[label], 1.0)
        self._together = [engine.RowConstraint(0.0, infinity, "") for _ in pairs]
        for row, fact in zip(self._together, self._needed.tolist(), strict=True):
            row.SetCoefficient(needed[fact], 1.0)
        for pair, label in zip(self._pair.tolist(), labels.tolist(), strict=True):
            self._together[pair].SetCoefficient(uses[label], -1.0)

    def charged(self, cost: Ints, unit: float) -> tuple[int, Ints]:
        """Return the bound by these rows alone at their prices in the last solution, and each label's
        remaining cost.
        """
        core = self._core
        price = np.array([max(0, int(row.dual_value() * unit)) for row in self._offered], np.int64)
        paid = np.array([max(0, int(row.dual_value() * unit)) for row in self._together], np.int64)
        left = cost.copy()
        np.subtract.at(left, self._offering, price[self._fact_of_offer])
        np.add.at(left, self._labels, paid[self._pair])
        price *= self._takes
        np.subtract.at(price, self._needed, paid)
        wanted = core.needs[core.goal]
        value = int(price[wanted].sum() + np.minimum(np.delete(price, wanted), 0).sum() + np.minimum(left, 0).sum())
        return value, np.maximum(left, 0)


class LandmarkProgram:
    """Finds the cheapest fractions of labels that are fed and hit all landmarks; labels of equal `kinds` are
    interchangeable.

    `value` is the optimum of the last solution: a bound on cost, except for rounding.
    """

    def __init__(self, core: Core, kinds: Ints, cost: Ints) -> None:
        from ortools.linear_solver import pywraplp

        self._optimal = pywraplp.Solver.OPTIMAL
        self._engine = pywraplp.Solver.CreateSolver("GLOP")
        self._engine.SuppressOutput()
        self._engine.SetSolverSpecificParametersAsString(FROM_THE_LAST_BASIS)
        self._unit = float(max(1, cost.max()))
        infinity = self._engine.infinity()
        self._uses = [self._engine.NumVar(0.0, infinity, "") for _ in cost]
        objective = self._engine.Objective()
        for uses, price in zip(self._uses, cost.tolist(), strict=True):
            objective.SetCoefficient(uses, price / self._unit)
        self._core, self._cost = core, cost
        self._parts = max(1, min(FINEST, LARGEST_CHARGES // (1 + int(cost.sum()))))
        self._feeding = Feeding(core, kinds, self._engine, self._uses)
        self._rows: list[pywraplp.Constraint] = []
        self._known: set[tuple[int, bytes]] = set()
        self.members = 0
        self.value = 0.0
        self.weights: list[int] = []
        self._fed: tuple[int, Ints] = 0, cost * self._parts

    def add(self, landmark: Landmark) -> bool:
        """Demand that the landmark is hit. Returns False if that is demanded already."""
        members, multi_demand = landmark.members, landmark.multi_demand
        key = landmark.least, landmark.counted.tobytes()
        if key in self._known:
            return False
        self._known.add(key)
        self.members += len(members)
        row = self._engine.RowConstraint(float(landmark.least), self._engine.infinity(), "")
        counts = repeat(1.0) if multi_demand is None else multi_demand.counts.tolist()
        for label, count in zip(members.tolist(), counts, strict=False):
            row.SetCoefficient(self._uses[label], count)
        self._rows.append(row)
        return True

    def solve(self, time_limit_s: float | None) -> Floats | None:
        """The cheapest fractions, None if they are not found in time."""
        if time_limit_s is not None:
            self._engine.SetTimeLimit(1 + int(900 * time_limit_s))
        if self._engine.Solve() != self._optimal:
            return None
        self.value = self._engine.Objective().Value() * self._unit
        unit = self._unit * self._parts
        self._fed = self._feeding.charged(self._cost * self._parts, unit)
        self.weights = [max(0, int(row.dual_value() * unit)) for row in self._rows]
        return np.array([uses.solution_value() for uses in self._uses])

    def bound(self, landmarks: list[Landmark]) -> Bound:
        """The last solution's bound in whole costs; `landmarks` are those added, in their order."""
        value, left = self._fed
        fine = Bound(self._core, left, landmarks)
        fine.recharge(self.weights)
        return fine.as_of(self._parts, value, self._cost)


def charged(bound: Bound, clock: Clock) -> Bound:
    """Charge a bound's landmarks in the best way.

    Returns the bound as it was if that takes too long or is no better.
    """
    if not bound.landmarks or not clock.has_steps(clock.tuning.rise.building * bound.core.links):
        return bound
    program = LandmarkProgram(bound.core, np.arange(bound.core.goal), bound.cost)
    landmarks = [landmark for landmark in bound.landmarks if program.add(landmark)]
    best = bound if program.solve(clock.left_s()) is None else program.bound(landmarks)
    return max(best, bound, key=lambda one: one.value)
