"""Capacity of interchangeable hosts: limits on units from patterns, the sets of units that fit on one host.

The units on hosts of a kind are a sum of as many patterns. If by some weights no pattern weighs more than `most`, these
units weigh at most `most` times the number of hosts. Weights that say the most are the prices of the linear program
that takes the fewest patterns (Gilmore and Gomory 1961); the patterns that it needs are made one after the other.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from ortools.sat.python.cp_model import OPTIMAL, CpSolverSolutionCallback, LinearExpr

from cfgplan.planners.exact.candidates import Candidates, HostKind, HostName
from cfgplan.planners.exact.model import Model
from cfgplan.planners.exact.rules import PLACED
from cfgplan.planners.exact.units import most_on_one
from cfgplan.planners.solving.clock import Clock
from cfgplan.planners.solving.engine import repeatable_solver, solve

FINE = 1_000
"""Weights are integers, in so many parts of a host."""

Pattern = Mapping[int, int]
"""How many units of each group one host has, by the numbers of the groups."""


class Weights(NamedTuple):
    """A packing constraint: the weight of a unit of each group, and the most that one host of a kind carries."""

    of: Mapping[int, int]
    most: int

    def limit(self, model: Model, host: HostName) -> None:
        """Add the constraint that the units on hosts of a kind weigh at most what that number of hosts carries."""
        weight = LinearExpr.sum([weight * model.numbers_on[n][host] for n, weight in self.of.items()])
        model.cp.add(weight <= self.most * model.uses[host])


class Patterns:
    """The patterns of a kind of hosts, as far as they are known, and the limits that were found."""

    def __init__(self, candidates: Candidates, groups: Sequence[tuple[int, ...]], hosts: HostKind) -> None:
        from ortools.linear_solver import pywraplp  # type: ignore[import-untyped]

        self.limits: list[Weights] = []
        host = hosts.apart()[0]
        one = Model(candidates.aggregated(groups, [host]), PLACED)
        self._cp, units = one.cp, one.candidates.all
        self._there = {n: numbers[host.first] for n, numbers in one.numbers_on.items() if numbers}
        self._known: list[Pattern] = []
        self._engine, self._optimal = pywraplp.Solver.CreateSolver("GLOP"), pywraplp.Solver.OPTIMAL
        self._weights = {}
        most = candidates.clock.tuning.fleet.company
        for n in self._there:
            transformation = units[n].transformation
            least = -most if transformation.label in candidates.environment.companions else 0.0
            largest = most if transformation.beside else 1 / max(1, most_on_one(units[n], host))
            self._weights[n] = self._engine.NumVar(least, largest, "")
        self._engine.Objective().SetMaximization()

    def is_too_much(self, there: Pattern, hosts: int, clock: Clock) -> bool:
        """Whether a new limit forbids these units on so many hosts; it is appended to `limits`.

        False also if the time is over before one is found.
        """
        for n, weight in self._weights.items():
            self._engine.Objective().SetCoefficient(weight, there.get(n, 0) + 1 / FINE)
        while not clock.is_over() and self._engine.Solve() == self._optimal:
            weights = {n: round(FINE * weight.solution_value()) for n, weight in self._weights.items()}
            patterns = self._heavy(weights, clock)
            if not patterns:
                return False
            limit = Weights(weights, max(_weight(weights, pattern) for pattern in patterns))
            if _weight(weights, there) > limit.most * hosts:
                self.limits.append(limit)
                return True
            new = [pattern for pattern in patterns if pattern not in self._known]
            if not new:
                return False
            self._known += new
            for pattern in new:
                row = self._engine.RowConstraint(-self._engine.infinity(), 1.0, "")
                for n, number in pattern.items():
                    row.SetCoefficient(self._weights[n], float(number))
        return False

    def _heavy(self, weights: Mapping[int, int], clock: Clock) -> list[Pattern]:
        """Patterns that include a heaviest one. Empty if that takes too long to prove."""
        self._cp.maximize(LinearExpr.sum([weights[n] * there for n, there in self._there.items()]))
        found: list[Pattern] = []

        def look_at(solution: CpSolverSolutionCallback) -> bool:
            found.append({n: number for n, there in self._there.items() if (number := solution.value(there))})
            return True

        solver = repeatable_solver(small=True, tiny=True, time_limit_s=clock.left_s())
        solver.parameters.max_deterministic_time = clock.tuning.fleet.price
        return found if solve(solver, self._cp, clock, look_at) == OPTIMAL else []


def _weight(weights: Mapping[int, int], units: Pattern) -> int:
    return sum(weights[n] * number for n, number in units.items())
