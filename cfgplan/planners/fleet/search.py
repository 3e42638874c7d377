"""One objective after the other: required transformations, cost, then rewired and started units."""

from __future__ import annotations

from collections.abc import Callable
from math import ceil, inf

from ortools.sat.python.cp_model import (
    FEASIBLE,
    INFEASIBLE,
    MODEL_INVALID,
    OPTIMAL,
    CpSolver,
    IntVar,
    LinearExpr,
    LinearExprT,
)

from cfgplan.domain import ComputationUnit, InputPort, Stream
from cfgplan.errors import InputError
from cfgplan.planners.fleet.candidates import Candidates
from cfgplan.planners.fleet.decode import decode, solution
from cfgplan.planners.fleet.first_plans import FirstPlans
from cfgplan.planners.fleet.instances import (
    there_are_as_many_units_as_asked_for_and_allowed,
    units_that_conflict_are_not_there_together,
)
from cfgplan.planners.fleet.model import Model
from cfgplan.planners.fleet.placing import hosts_bear_their_units, streams_are_carried_to_where_they_are_wanted
from cfgplan.planners.fleet.quality import targets_get_the_quality_they_ask_for, value_of_choice
from cfgplan.planners.fleet.standing import Standing
from cfgplan.planners.fleet.survival import Missed, Survival
from cfgplan.planners.fleet.survivors import bears_all_failures
from cfgplan.planners.solving.engine import OnSolution, repeatable_solver, solve
from cfgplan.qualities import QualityAttribute


class Search:
    """A problem on its way to its optimum: the model, the best plan so far, and what is proven."""

    def __init__(
        self,
        candidates: Candidates,
        standing: Standing,
        first: FirstPlans,
        slice_s: float = inf,
        *,
        is_all: bool = True,
    ) -> None:
        """With `is_all` false some candidates are left out: nothing is learned but plans.

        `first` makes plans of what does not survive yet; `slice_s` are the engine's own seconds for all rounds.
        """
        self.problem = candidates.problem
        self.standing = standing
        self.is_all = is_all
        self._first = first
        self._left_s = slice_s
        self.is_bounding_cost = False
        self.model = Model(candidates)
        hosts_bear_their_units(self.model)
        streams_are_carried_to_where_they_are_wanted(self.model)
        units_that_conflict_are_not_there_together(self.model)
        there_are_as_many_units_as_asked_for_and_allowed(self.model)
        self._ask_for_quality()
        self.survival = Survival(candidates)
        self.hint: dict[int, int] = {} if standing.best is None else _hint(self.model, standing.best[1])

    def _ask_for_quality(self) -> None:
        model = self.model

        def value_at(attribute: QualityAttribute, unit: int, port: InputPort, values: dict[Stream, IntVar]) -> IntVar:
            return value_of_choice(model, attribute, model.connects[unit, port.name].items(), values)

        targets_get_the_quality_they_ask_for(model, lambda target: model.publishes[target.topic].items(), value_at)

    def run(self) -> None:
        """Go through the objectives until the clock stops one."""
        model, standing = self.model, self.standing
        if model.uses_required:
            used = LinearExpr.sum(list(model.uses_required.values()))
            if not self.minimise(-used):
                return
            assert standing.best is not None
            standing.fewest_unused = standing.best[0][0]
            hopeless = sum(t.required for t in self.problem.environment.library) - len(model.uses_required)
            model.cp.add(used >= len(model.uses_required) + hopeless - standing.best[0][0])
        cost = model.cost()
        if not standing.is_cost_proven:
            self.is_bounding_cost = self.is_all
            if not self.minimise(cost):
                return
            self.is_bounding_cost = False
            if not self.is_all:
                return
            standing.prove_cost()
        assert standing.best is not None
        model.cp.add(cost <= standing.best[0][1])
        standing.are_ties_proven = self.minimise(model.changes())

    def minimise(self, objective: LinearExprT) -> bool:
        """Rounds of solving and of demanding what is missed; True with a proof that the best plan is best in this."""
        self.model.cp.minimize(objective)
        while self._left_s > 0 and not self.standing.clock.is_over():
            is_proven, missed = self._round()
            if not missed:
                return is_proven
            self.survival.demand(self.model, missed)
            self.standing.counts["rounds"] = self.standing.counts.get("rounds", 0) + 1
        return False

    def _round(self) -> tuple[bool, list[Missed]]:
        """Solve once: whether the solution is proven best, and what it misses."""
        self.model.cp.clear_hints()  # type: ignore[no-untyped-call]
        for index, value in self.hint.items():
            self.model.cp.add_hint(self.model.cp.get_int_var_from_proto_index(index), value)
        solver = self.solver()
        if self.is_bounding_cost:
            solver.best_bound_callback = lambda bound: self.standing.raise_bound(ceil(bound - 0.5))
        status = solve(solver, self.model.cp, OnSolution(self.look_at), self.standing.clock)
        self.standing.counts["conflicts"] += solver.num_conflicts
        self._left_s -= solver.response_proto.deterministic_time
        missed: list[Missed] = []
        if status == MODEL_INVALID:
            mend = "give the quality attributes a `worst` and a `best` that are closer, or fewer decimals"
            raise InputError.of("the numbers are too large to be computed exactly", mend=mend)
        if status == INFEASIBLE:
            if self.is_all:
                self.standing.prove_infeasible()
            return False, []
        if self.is_bounding_cost:
            self.standing.raise_bound(ceil(solver.best_objective_bound - 0.5))
        if status in (OPTIMAL, FEASIBLE):
            self.look_at(solver.boolean_value)
            missed = self.survival.missed(solution(self.model, solver.boolean_value))
            if missed:
                self._first.offer({i for i, runs in self.model.runs.items() if solver.boolean_value(runs)})
            self.hint = dict(enumerate(solver.response_proto.solution))
        return status == OPTIMAL, missed

    def look_at(self, holds: Callable[[IntVar], bool]) -> bool:
        """Take a solution as the best plan if it is one, and the best; in any case the solver may go on."""
        units = solution(self.model, holds)
        if bears_all_failures(self.model.candidates, units):
            self.standing.offer(decode(self.model, units))
        return True

    def solver(self) -> CpSolver:
        solver = repeatable_solver(small=False, time_limit_s=self.standing.clock.left_s())
        if self._left_s < inf:
            solver.parameters.max_deterministic_time = self._left_s
        return solver


def _hint(model: Model, units: list[ComputationUnit]) -> dict[int, int]:
    """Values of the booleans that say who is there, where, and who feeds whom."""
    by_id = {unit.id: unit for unit in units}
    fed = {(unit.id, s.port, s.stream) for unit in units for s in unit.subscriptions}
    published = {(p.topic, Stream(unit.id, p.port)) for unit in units for p in unit.publications}
    ids = [candidate.id for candidate in model.candidates.all]
    hint = {runs.index: int(ids[i] in by_id and not by_id[ids[i]].standby) for i, runs in model.runs.items()}
    hint |= {waits.index: int(ids[i] in by_id and by_id[ids[i]].standby) for i, waits in model.waits.items()}
    for i, places in model.is_on.items():
        here = by_id[ids[i]].host if ids[i] in by_id else ""
        hint |= {is_on.index: int(ids[i] in by_id and host == here) for host, is_on in places.items()}
    for (i, port), choices in model.connects.items():
        hint |= {taken.index: int((ids[i], port, stream) in fed) for stream, taken in choices.items()}
    for topic, choices in model.publishes.items():
        hint |= {taken.index: int((topic, stream) in published) for stream, taken in choices.items()}
    return hint
