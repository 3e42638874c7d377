"""The search: one objective after the other, each by rounds of solving and of forbidding what is no plan."""

from __future__ import annotations

from collections.abc import Callable, Iterable
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

from cfgplan.domain import InputPort
from cfgplan.errors import InputError
from cfgplan.planners.fleet.candidates import Candidates
from cfgplan.planners.fleet.decode import decode, lean, named
from cfgplan.planners.fleet.first_plans import FirstPlans
from cfgplan.planners.fleet.model import Model
from cfgplan.planners.fleet.quality import Values, targets_get_the_quality_they_ask_for, value_of_choice
from cfgplan.planners.fleet.standing import Standing
from cfgplan.planners.fleet.survival import Survival
from cfgplan.planners.networks.quality import Key
from cfgplan.planners.solving.engine import OnSolution, repeatable_solver, solve
from cfgplan.qualities import QualityAttribute

SMALL = 1000
"""With fewer booleans than this, probing and looking for symmetries take longer than they save."""
MANY_PLACES = 20_000
"""The same where there are hosts."""
TINY = 400
"""With fewer than this, so does presolving for a second time."""
EXACT = 2**50
"""Up to here the solver's bound, a double, is exact."""
LARGEST = 2**62
"""No sum of the solver's integers may exceed this."""


class Search:
    """Rounds of solving and cutting that bring a standing forward."""

    def __init__(
        self,
        candidates: Candidates,
        standing: Standing,
        *,
        is_all: bool = True,
        is_apart: bool = False,
        landmarks: Iterable[tuple[Iterable[str], int]] = (),
    ) -> None:
        """With `is_all` false some candidates are left out: nothing is learned but plans. `is_apart` is the model's.

        What `landmarks` say holds of every plan that is no dearer than the best.
        """
        self.problem = candidates.problem
        self.standing = standing
        self.is_all = is_all
        self._first = FirstPlans(candidates, standing)
        self._left_s = inf
        self._has_hosts = bool(candidates.environment.hosts)
        self.model = Model(candidates, is_apart=is_apart)
        self._ask_for_quality()
        self.model.enough_of_each_run(landmarks)
        self.survival = Survival(candidates)
        self._cost = self.model.cost()
        standing.counts["booleans"] = len(self.model.literals)

    def _ask_for_quality(self) -> None:
        model = self.model

        def value_at(attribute: QualityAttribute, unit: int, port: InputPort, values: Values) -> IntVar:
            return value_of_choice(model, attribute, model.connects[unit, port.name].items(), values)

        targets_get_the_quality_they_ask_for(model, lambda target: model.publishes[target.label].items(), value_at)

    def run(self, slice_s: float = inf) -> None:
        """Go through the objectives until the clock stops one, or `slice_s` of the engine's own seconds are over."""
        model, standing = self.model, self.standing
        self._left_s = slice_s
        if model.uses_required:
            hopeless = self._hopeless_required()
            used = LinearExpr.sum(list(model.uses_required.values()))
            if not self.minimise(-used, lambda key: key[0] - hopeless - len(model.uses_required), 0):
                return
            assert standing.best is not None
            if self.is_all:
                standing.fewest_unused = standing.best[0][0]
            model.cp.add(used >= len(model.uses_required) + hopeless - standing.best[0][0])
        elif standing.best is not None:
            model.cp.add(self._cost <= standing.best[0][1])
        is_proven, scale = standing.is_cost_proven, self._scale()
        if not is_proven and scale:
            both = LinearExpr.weighted_sum([self._cost, model.changes()], [scale, 1])
            if self.minimise(both, lambda key: scale * key[1] + self._changes(key), scale) and self.is_all:
                standing.prove_cost()
                standing.are_ties_proven = True
            return
        if not is_proven:
            if not self.minimise(self._cost, lambda key: key[1], 1) or not self.is_all:
                return
            standing.prove_cost()
            assert standing.best is not None
            model.cp.add(self._cost <= standing.best[0][1])
        standing.are_ties_proven = self.minimise(model.changes(), self._changes, 0)

    def _hopeless_required(self) -> int:
        """How many required transformations can never be used, whatever is planned."""
        return sum(t.required for t in self.problem.environment.library) - len(self.model.uses_required)

    def _changes(self, key: Key) -> int:
        """A plan's rewired and started units, as the model adds them up."""
        return (len(self.model.started()) + 1) * key[2] + key[3]

    def _scale(self) -> int:
        """What a microsecond weighs against changes where both are added up; 0 if the sum would not be exact."""
        model, candidates = self.model, self.model.candidates
        started = len(model.started())
        rewired = len(candidates.all) - started
        scale = (started + 1) * (rewired + 1)
        most = scale * (1 + self.problem.largest_cost_us(self.problem.horizon_s))
        is_exact = self.standing.best is None or self.standing.best[0][1] * scale < EXACT
        return scale if most < LARGEST and is_exact else 0

    def minimise(self, objective: LinearExprT, level_of: Callable[[Key], int], scale: int) -> bool:
        """Rounds of solving and of forbidding; True with a proof that the best plan is best in this.

        `level_of` gives the objective of a plan. A microsecond of cost weighs `scale` in it, 0 if it does not count.
        """
        self.model.cp.minimize(objective)
        standing = self.standing
        while self._left_s > 0 and not standing.clock.is_over():
            standing.counts["rounds"] = standing.counts.get("rounds", 0) + 1
            solver = self._solver()
            self._hint()
            if scale and self.is_all:
                solver.best_bound_callback = lambda bound: standing.raise_bound(ceil(bound - 0.5) // scale)
            status = solve(solver, self.model.cp, OnSolution(self._look_at), standing.clock)
            standing.counts["conflicts"] = standing.counts.get("conflicts", 0) + solver.num_conflicts
            self._left_s -= solver.response_proto.deterministic_time
            if status == MODEL_INVALID:
                mend = "give the quality attributes a `worst` and a `best` that are closer, or fewer decimals"
                raise InputError.of("the numbers are too large to be computed exactly", mend=mend)
            if status == INFEASIBLE:
                if self.is_all:
                    standing.prove_infeasible()
                return False
            if scale and self.is_all:
                standing.raise_bound(ceil(solver.best_objective_bound - 0.5) // scale)
            if status not in (OPTIMAL, FEASIBLE):
                return False
            true = self.true_of(solver.boolean_value)
            key = self.consider(true)
            if key is not None and status == OPTIMAL and level_of(key) <= round(solver.objective_value):
                return True
            if key is not None and status != OPTIMAL:
                return False
            if key is None:
                self.forbid(true)
        return False

    def true_of(self, holds: Callable[[IntVar], bool]) -> set[int]:
        return {literal.index for literal in self.model.literals if holds(literal)}

    def consider(self, true: set[int]) -> Key | None:
        """The key of a solution, kept if it beats the best plan; None if it is no plan."""
        units = decode(self.model, true)
        if units is None or self.survival.missed(units):
            return None
        return self.standing.offer(named(self.model.candidates, lean(self.model.candidates, units)))

    def _look_at(self, holds: Callable[[IntVar], bool]) -> bool:
        """Look at a solution on the way: after a plan the solver may go on.

        What is none is forbidden at once, since to see what is best beside it takes long; but for hosts, where to begin
        anew takes longer.
        """
        return self.consider(self.true_of(holds)) is not None or self._has_hosts

    def forbid(self, true: set[int]) -> None:
        """Forbid a solution that is no plan, and all others that fail for the same reason."""
        model, cp = self.model, self.model.cp
        units = decode(model, true)
        if units is not None:
            missed = self.survival.missed(units)
            self.survival.demand(model, missed)
            self._first.offer({i for i, runs in model.runs.items() if runs.index in true})
            return
        unfounded, ways_in = model.anywhere.cut(true, model.anywhere.grounded(true))
        if not unfounded:
            unfounded, ways_in = model.support.cut(true, model.support.grounded(true))
        assert unfounded, "a solution without a plan has something that is not grounded"
        ways = [cp.get_bool_var_from_proto_index(way) for way in ways_in]
        for proposition in unfounded:
            model.needs_any(cp.get_bool_var_from_proto_index(proposition), ways)
        self.standing.counts["cuts"] = self.standing.counts.get("cuts", 0) + len(unfounded)

    def _solver(self) -> CpSolver:
        """An engine for one round, with the time that is left."""
        size = len(self.model.literals)
        solver = repeatable_solver(
            small=size < (20000 if self._has_hosts else SMALL), time_limit_s=self.standing.clock.left_s()
        )
        if size < TINY:
            solver.parameters.max_presolve_iterations = 1
        if self._left_s < inf:
            solver.parameters.max_deterministic_time = self._left_s
        return solver

    def _hint(self) -> None:
        """Start from the best plan's units and hosts."""
        model = self.model
        model.cp.clear_hints()  # type: ignore[no-untyped-call]
        if self.standing.best is None:
            return
        there = {unit.id: unit for unit in self.standing.best[1]}
        for places, is_standby in ((model.runs_on, False), (model.waits_on, True)):
            for i, on in places.items():
                unit = there.get(model.candidates.all[i].id)
                here = unit is not None and unit.standby == is_standby
                for host, literal in on.items():
                    model.cp.add_hint(literal, here and unit is not None and unit.host == host)
