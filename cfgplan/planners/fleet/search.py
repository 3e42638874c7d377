"""One objective after the other: required transformations, cost, then rewired and started units."""

from __future__ import annotations

from collections.abc import Callable
from math import ceil

from ortools.sat.python.cp_model import (
    FEASIBLE,
    INFEASIBLE,
    MODEL_INVALID,
    OPTIMAL,
    CpSolver,
    CpSolverSolutionCallback,
    IntVar,
    LinearExpr,
    LinearExprT,
)

from cfgplan.domain import ComputationUnit
from cfgplan.errors import InputError
from cfgplan.planners.cpsat.clock import Clock
from cfgplan.planners.cpsat.engine import repeatable_solver, solve
from cfgplan.planners.fleet.candidates import Candidates
from cfgplan.planners.fleet.decode import decode
from cfgplan.planners.fleet.instances import (
    there_are_as_many_units_as_asked_for_and_allowed,
    units_that_conflict_are_not_there_together,
)
from cfgplan.planners.fleet.keys import Key, key_of, unused_required
from cfgplan.planners.fleet.model import Model
from cfgplan.planners.fleet.placing import hosts_bear_their_units, streams_are_carried_to_where_they_are_wanted
from cfgplan.planners.fleet.quality import targets_get_the_quality_they_ask_for
from cfgplan.planners.fleet.reasons import joint_reasons
from cfgplan.planners.fleet.survival import every_failure_leaves_a_stream_for_every_target
from cfgplan.planning import Plan, Problem, Progress, Status


class Search:
    """A problem on its way to its optimum: the model, the best plan so far, and what is proven."""

    def __init__(self, candidates: Candidates, clock: Clock, report: Callable[[Progress], None] | None) -> None:
        self.problem: Problem = candidates.problem
        self.clock = clock
        self.report = report
        self.best: tuple[Key, list[ComputationUnit]] | None = None
        self.bound_us = 0
        self.is_infeasible = False
        self.is_cost_proven = False
        self.is_optimal = False
        self.is_bounding_cost = False
        self.model = Model(candidates)
        hosts_bear_their_units(self.model)
        streams_are_carried_to_where_they_are_wanted(self.model)
        units_that_conflict_are_not_there_together(self.model)
        there_are_as_many_units_as_asked_for_and_allowed(self.model)
        targets_get_the_quality_they_ask_for(self.model)
        every_failure_leaves_a_stream_for_every_target(self.model)
        self.counts = {"candidates": len(candidates.all), "conflicts": 0}
        self.hint: dict[int, int] = {}

    def run(self) -> None:
        """Go through the objectives until the clock stops one."""
        model = self.model
        if model.uses_required:
            used = LinearExpr.sum(list(model.uses_required.values()))
            if not self.minimise(-used):
                return
            assert self.best is not None
            hopeless = sum(t.required for t in self.problem.environment.library) - len(model.uses_required)
            model.cp.add(used >= len(model.uses_required) + hopeless - self.best[0][0])
        cost = model.cost()
        self.is_bounding_cost = True
        if not self.minimise(cost):
            return
        assert self.best is not None
        self.is_bounding_cost = False
        self.is_cost_proven = True
        self.raise_bound(self.best[0][1])
        model.cp.add(cost <= self.best[0][1])
        self.is_optimal = self.minimise(model.changes())

    def minimise(self, objective: LinearExprT) -> bool:
        """Solve; True with a proof that the best plan is best in this objective."""
        self.model.cp.minimize(objective)
        self.model.cp.clear_hints()  # type: ignore[no-untyped-call]
        for index, value in self.hint.items():
            self.model.cp.add_hint(self.model.cp.get_int_var_from_proto_index(index), value)
        solver = self.solver()
        if self.is_bounding_cost:
            solver.best_bound_callback = lambda bound: self.raise_bound(ceil(bound - 0.5))
        status = solve(solver, self.model.cp, _OnSolution(self.look_at), self.clock)
        self.counts["conflicts"] += solver.num_conflicts
        if status == MODEL_INVALID:
            mend = "give the quality attributes a `worst` and a `best` that are closer, or fewer decimals"
            raise InputError.of("the numbers are too large to be computed exactly", mend=mend)
        if status == INFEASIBLE:
            self.is_infeasible = self.best is None
            return False
        if self.is_bounding_cost:
            self.raise_bound(ceil(solver.best_objective_bound - 0.5))
        if status in (OPTIMAL, FEASIBLE):
            self.look_at(lambda literal: solver.boolean_value(literal))
            self.hint = {
                index: solver.value(self.model.cp.get_int_var_from_proto_index(index))
                for index in range(len(self.model.cp.proto.variables))
            }
        return status == OPTIMAL

    def look_at(self, holds: Callable[[IntVar], bool]) -> None:
        """Take a solution as the best plan if it is."""
        units = decode(self.model, holds)
        key = key_of(self.problem, units)
        if self.best is None or key < self.best[0]:
            self.best = (key, units)
            self.tell()

    def raise_bound(self, bound_us: int) -> None:
        if bound_us > self.bound_us:
            self.bound_us = bound_us
            self.tell()

    def tell(self) -> None:
        if self.report is not None:
            cost_us = self.best[0][1] if self.best else None
            self.report(Progress(self.clock.elapsed_s(), cost_us, self.bound_us))

    def solver(self) -> CpSolver:
        return repeatable_solver(small=False, time_limit_s=self.clock.left_s())

    def plan(self) -> Plan:
        """The answer so far."""
        problem, counts, seconds = self.problem, self.counts, self.clock.seconds
        if self.is_infeasible:
            reasons = joint_reasons(problem)
            return Plan("cpsat", Status.INFEASIBLE, reasons=reasons, seconds=seconds, counts=counts)
        largest = problem.max_cost_us
        if largest is not None and self.bound_us > largest:
            cost_us = self.best[0][1] if self.best is not None and self.is_cost_proven else None
            return Plan("cpsat", Status.TOO_EXPENSIVE, None, cost_us, self.bound_us, seconds=seconds, counts=counts)
        if self.best is None or (largest is not None and self.best[0][1] > largest):
            return Plan("cpsat", Status.UNKNOWN, bound_us=self.bound_us, seconds=seconds, counts=counts)
        key, units = self.best
        return Plan(
            "cpsat",
            Status.OPTIMAL if self.is_optimal else Status.FEASIBLE,
            problem.environment.change_to(units),
            key[1],
            min(self.bound_us, key[1]),
            unused_required=unused_required(problem, units),
            seconds=seconds,
            counts=counts,
        )


class _OnSolution(CpSolverSolutionCallback):
    def __init__(self, look_at: Callable[[Callable[[IntVar], bool]], None]) -> None:
        super().__init__()
        self._look_at = look_at

    def on_solution_callback(self) -> None:
        self._look_at(self.boolean_value)
