"""The search minimises one objective after the other. Each round solves the model and forbids a bad solution."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from functools import partial
from math import inf

from ortools.sat.python.cp_model import CpSolver, CpSolverSolutionCallback, IntVar, LinearExpr, LinearExprT

from cfgplan.domain import Objective
from cfgplan.planners.exact.candidates import ONLY_IN_THE_MODEL, Candidates
from cfgplan.planners.exact.decode import decode
from cfgplan.planners.exact.first_plans import FirstPlans
from cfgplan.planners.exact.model import Model, ModelRule
from cfgplan.planners.exact.pruning import lean
from cfgplan.planners.exact.quality import running_units_bound_the_badness_of_chains
from cfgplan.planners.exact.quality_chains import ChainCut
from cfgplan.planners.exact.rounds import InfeasibleError, minimised
from cfgplan.planners.exact.rules import RULES
from cfgplan.planners.exact.solve_state import SolveState
from cfgplan.planners.exact.survival import Survival
from cfgplan.planners.exact.wiring import named
from cfgplan.planners.networks.keys import Key
from cfgplan.planners.solving.clock import Clock, ContradictionError
from cfgplan.planners.solving.engine import LARGEST_PRODUCT, repeatable_solver
from cfgplan.planning import Feature

EXACT = 2**50
"""Up to here the solver's bound, a double, is exact."""
LARGEST = 2**62
"""No sum of the solver's integers may exceed this."""
Landmarks = Iterable[tuple[Iterable[str], int]]
"""Labels of which every plan has so many or more; each counts as often as it is named."""
LandmarkFinder = Callable[[Collection[str], Clock], Landmarks]
"""Finds landmarks that the transformations of a solution do not hit."""


class Search:
    """Rounds of solving and cutting: each gives the state a better plan, a bound, or the model a cut."""

    def __init__(
        self,
        candidates: Candidates,
        state: SolveState,
        *,
        is_all: bool = True,
        is_apart: bool = False,
        landmarks: Landmarks = (),
        cuts: Iterable[ChainCut] = (),
        missed: LandmarkFinder = lambda *_: (),
        rules: Sequence[ModelRule] = RULES,
    ) -> None:
        """With `is_all` false some candidates are left out: the search gives plans, but no bounds.

        `is_apart` is the model's. `landmarks` hold of every plan that may be optimal; `missed` finds more of them.
        """
        self.problem = candidates.problem
        self.state = state
        self.is_all = is_all
        self._missed = missed
        self._left_s = inf
        self._unexplained = 0
        self._has_hosts = bool(candidates.environment.hosts)
        self._survival, self._first = None, None
        if self.problem.survive is not None:
            self._survival = Survival(candidates)
            if not ONLY_IN_THE_MODEL & self.problem.features:
                self._first = FirstPlans(candidates, state)
        self.model = Model(candidates, rules, is_apart=is_apart)
        self.model.enough_of_each_run(landmarks)
        running_units_bound_the_badness_of_chains(self.model, cuts)
        self._cost = self.model.cost()
        if (largest_us := state.largest_us) is not None:
            self.model.cp.add(self._cost <= largest_us)
        for name in ("rounds", "cuts", "conflicts"):
            state.counts.setdefault(name, 0)
        state.counts["booleans"] = len(self.model.literals)

    def run(self, slice_s: float = inf) -> None:
        """Minimise unused required transformations, cost and changes, until the clock or `slice_s` ends it.

        `slice_s` is in the engine's own seconds.
        """
        self._left_s = slice_s
        try:
            if self._use_required() and self._minimise_in_order():
                self._minimise_cost_then_changes()
        except InfeasibleError:
            if self.is_all:
                self.state.prove_infeasible()
        except ContradictionError as error:
            if self.is_all:
                raise
            self.state.note_failure(str(error))

    def run_with_all_required(self) -> bool:
        """Minimise cost, then changes, of plans that use all required transformations; False if there are none.

        Transformations that can never be used do not count.
        """
        for used in self.model.uses_required.values():
            self.model.cp.add_bool_or([used])
        try:
            self._minimise_cost_then_changes()
        except InfeasibleError:
            return False
        return True

    def _use_required(self) -> bool:
        """Use as many required transformations as possible; False if the time is over before that is proven."""
        model, state, required = self.model, self.state, len(self.problem.environment.required)
        if model.uses_required:
            used = LinearExpr.sum([*model.uses_required.values()])
            if not self.minimise(-used, lambda key: key.unused - required):
                return False
            assert state.best is not None
            if self.is_all:
                state.min_unused = state.best.key.unused
            model.cp.add(used >= required - state.best.key.unused)
        return True

    def _minimise_in_order(self) -> bool:
        """Minimise the objectives before and beside the cost in order, each with the earlier ones at their minimum.

        False if the time is over before all are proven, or if each plan is proven to cost more than is allowed.
        """
        state, largest_us = self.state, self.problem.max_cost_us
        named = self.problem.environment.minimise if Feature.ORDER in self.problem.features else ()
        if named and largest_us is not None:
            is_too_dear = self.model.boolean()
            self.model.cp.add(self._cost <= largest_us).only_enforce_if(is_too_dear.negated())
            if not self._minimise_one(is_too_dear, 0, None):
                return False
            if state.best is not None and state.best.key.first[0]:
                state.raise_bound(largest_us + 1)
                return False
        for place, each in enumerate(named[:-1] if named[-1:] == (Objective.COST,) else named, 1):
            if not self._minimise_one(self.model.objective(each), place, partial(state.raise_bound_of, each)):
                return False
            if each is Objective.COST:
                state.prove_cost()
        return True

    def _minimise_one(self, objective: LinearExprT, place: int, learn: Callable[[int], None] | None) -> bool:
        """Minimise an objective of `Key.first`, and fix it at its minimum. False if the time is over."""
        if not self.minimise(objective, lambda key: key.first[place], learn) or not self.is_all:
            return False
        assert self.state.best is not None
        least = self.state.best.key.first[place]
        if learn is not None:
            learn(least)
        self.model.cp.add(objective <= least)
        return True

    def _minimise_cost_then_changes(self) -> None:
        """Minimise both in one sum where that is exact, else one after the other."""
        model, state, scale = self.model, self.state, self._scale()
        is_proven = state.is_cost_proven
        if not is_proven and scale:
            both = LinearExpr.weighted_sum([self._cost, model.changes()], [scale, 1])

            def level_of(key: Key) -> int:
                return scale * key.cost_us + self._changes(key)

            if self.minimise(both, level_of, lambda bound: state.raise_bound(bound // scale)) and self.is_all:
                state.prove_all()
            return
        if not is_proven:
            if not self.minimise(self._cost, lambda key: key.cost_us, state.raise_bound) or not self.is_all:
                return
            state.prove_cost()
            assert state.best is not None
            model.cp.add(self._cost <= state.best.key.cost_us)
        state.are_ties_proven = self.minimise(model.changes(), self._changes)

    def _changes(self, key: Key) -> int:
        """A plan's rewired and started units, as the model adds them up."""
        return (self.model.most_started() + 1) * key.rewired + key.started

    def _scale(self) -> int:
        """The weight of a microsecond in a sum of cost and changes; 0 if the sum would not be exact."""
        candidates, best = self.model.candidates, self.state.best
        started = self.model.most_started()
        scale = (started + 1) * (len(candidates.all) - started + 1)
        largest_us = self.problem.largest_cost_us(self.problem.horizon_s)
        exact_us = largest_us if best is None else best.key.cost_us
        dearest_us = max((candidate.cost_us for candidate in candidates.all), default=0)
        is_exact = scale * (1 + exact_us) < EXACT and scale * dearest_us < LARGEST_PRODUCT
        return scale if is_exact and scale * (1 + largest_us) < LARGEST else 0

    def minimise(
        self, objective: LinearExprT, level_of: Callable[[Key], int], learn: Callable[[int], None] | None = None
    ) -> bool:
        """Solve and forbid in rounds. True if the incumbent is proven best in this objective; False if time is over.

        `level_of` gives the objective of a plan. `learn` is called with bounds on it. Raises InfeasibleError if no plan
        exists. The rounds end: each forbids a solution.
        """
        state = self.state

        def learn_bound(bound: int) -> None:
            if learn is not None and self.is_all:
                learn(bound)

        def taken(solver: CpSolver, is_best: bool) -> bool | None:
            self._left_s -= solver.response_proto.deterministic_time
            true = self.true_of(solver.boolean_value)
            key = self.consider(true)
            if key is None:
                self.forbid(true)
                return None
            if level_of(key) > round(solver.objective_value):
                raise ContradictionError("a plan costs or changes more than the model says")
            return is_best

        return bool(
            minimised(
                self.model,
                objective,
                state,
                solver=self._next_solver,
                look_at=self._look_at,
                learn=learn_bound,
                taken=taken,
            )
        )

    def _next_solver(self) -> CpSolver | None:
        """A solver for one round, with the incumbent as a hint; None if the time is over."""
        if self._left_s <= 0 or self.state.clock.is_over():
            return None
        self.model.hint(() if self.state.best is None else self.state.best.units)
        return self.solver()

    def true_of(self, holds: Callable[[IntVar], bool]) -> set[int]:
        return {literal.index for literal in self.model.literals if holds(literal)}

    def consider(self, true: set[int]) -> Key | None:
        """Offer a solution as a plan. Returns its key, or None if the solution is no plan."""
        units, survival = decode(self.model, true), self._survival
        if units is None:
            return None
        if survival is not None and (survival.missed(units) or survival.needless_spares(self.model, true, units)):
            return None
        candidates = self.model.candidates
        return self.state.offer(candidates, named(candidates, lean(candidates, units)))

    def _look_at(self, solution: CpSolverSolutionCallback) -> bool:
        """Check a solution that the solver found on its way. Returns True, to continue, if it is a plan.

        A solution without a plan stops the solver and is forbidden at once, since proving the best one beside it takes
        long. With hosts the solver continues, since a new start takes longer there.
        """
        return self.consider(self.true_of(solution.boolean_value)) is not None or self._has_hosts

    def forbid(self, true: set[int]) -> None:
        """Forbid a solution that is no plan, and all others that fail for the same reason.

        If no reason is known, only this solution is forbidden, which needs a boolean for each wire. Raises
        ContradictionError without these, or after too many such solutions.
        """
        model, cp, candidates = self.model, self.model.cp, self.model.candidates
        running = {i for i, runs in model.runs.items() if runs.index in true}
        units = None if self._survival is None else decode(model, true)
        if self._survival is not None and units is not None:
            if missed := self._survival.missed(units):
                if self._survival.demand(model, missed):
                    if self._first is not None:
                        self._first.offer(running)
                    return
            elif needless := self._survival.needless_spares(model, true, units):
                self._survival.forbid_spares(model, true, needless)
                return
        unfounded, ways_in = model.anywhere.cut(true, model.anywhere.grounded(true))
        if not unfounded:
            unfounded, ways_in = model.support.cut(true, model.support.grounded(true))
        if not unfounded or not true.isdisjoint(ways_in):
            self._forbid_alone(true)
            return
        ways = [cp.get_bool_var_from_proto_index(way) for way in ways_in]
        for proposition in unfounded:
            model.needs_any(cp.get_bool_var_from_proto_index(proposition), ways)
        self.state.counts["cuts"] += len(unfounded)
        used = {candidates.all[i].transformation.label for i in running}
        model.enough_of_each_run(self._missed(used, self.state.clock))

    def _forbid_alone(self, true: set[int]) -> None:
        """Forbid the placement, waiting, staying and wiring of a solution."""
        model = self.model
        self._unexplained += 1
        if (
            self._unexplained > self.state.clock.tuning.solve.unexplained
            or not model.is_apart
            or decode(model, true) is None
        ):
            raise ContradictionError("a solution is no plan, though all of it is grounded")
        places = [on for each in (model.runs_on, model.waits_on) for places in each.values() for on in places.values()]
        wires = [
            taken
            for each in (model.connects, model.publishes, model.meets)
            for choices in each.values()
            for taken in choices.values()
        ]
        decided = {literal.index: literal for literal in (*places, *model.stays.values(), *wires)}
        model.cp.add_bool_or([~literal if index in true else literal for index, literal in decided.items()])

    def solver(self) -> CpSolver:
        """A solver for one round, with the time that is left."""
        size, tuning = len(self.model.literals), self.state.clock.tuning
        is_large = self._has_hosts or self.model.asks_for_quality
        solver = repeatable_solver(
            small=size < (tuning.fleet.small if is_large else tuning.solve.small),
            tiny=size < tuning.solve.tiny,
            time_limit_s=self.state.clock.left_s(),
        )
        if ONLY_IN_THE_MODEL & self.problem.features and size < tuning.fleet.wired and not self.model.is_small:
            solver.parameters.linearization_level = 1
        if self._left_s < inf:
            solver.parameters.max_deterministic_time = self._left_s
        return solver
