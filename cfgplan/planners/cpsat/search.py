"""The search: one objective after the other, each by rounds of solving and cutting what is not grounded."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from math import ceil

from ortools.sat.python.cp_model import (
    FEASIBLE,
    INFEASIBLE,
    MODEL_INVALID,
    OPTIMAL,
    UNKNOWN,
    CpSolver,
    IntVar,
    LinearExpr,
    LinearExprT,
)

from cfgplan.planners.cpsat.decode import decode
from cfgplan.planners.cpsat.model import Model
from cfgplan.planners.cpsat.prepared import Prepared
from cfgplan.planners.cpsat.standing import Stage, Standing
from cfgplan.planners.cpsat.symmetry import one_of_those_alike_is_enough
from cfgplan.planners.networks.quality import Key
from cfgplan.planners.solving.clock import Clock, ContradictionError
from cfgplan.planners.solving.engine import OnSolution, repeatable_solver, solve

SMALL = 1000
"""With fewer booleans than this, probing and looking for symmetries take longer than they save."""
TINY = 400
"""With fewer than this, so does presolving for a second time."""
EXACT = 2**50
"""Up to here the solver's bound, a double, is exact."""
LARGEST = 2**62
"""No sum of the solver's integers may exceed this."""


class InfeasibleError(ContradictionError):
    """No plan meets all that was added to the model; without additions there always is one."""


class Search:
    """Rounds of solving and cutting that bring a standing forward."""

    def __init__(
        self,
        standing: Standing,
        prepared: Prepared,
        missed: Callable[[Collection[str], Clock], Iterable[tuple[Collection[str], int]]] = lambda *_: (),
    ) -> None:
        """`missed` finds landmarks that the transformations of a solution do not hit."""
        self.missed = missed
        self.standing = standing
        self.site = standing.site
        self.prepared = prepared
        self.model = Model(standing.site, standing.clock.check)

    def run(self) -> None:
        """Go through the stages until the clock stops one."""
        model = self.model
        self.begin()
        scale = self.changes_scale()
        if scale is not None:
            self.standing.stage = Stage.COST_AND_CHANGES
            if self.minimise(LinearExpr.weighted_sum([model.cost(), model.changes()], [scale, 1])):
                self.standing.stage = Stage.DONE
                self.standing.raise_bound(self.standing.best.key[1] if self.standing.best else 0)
            return
        required = len(model.uses_required)
        used = sum(model.uses_required.values())
        if required and not self.minimise(required - used):
            return
        if required and self.standing.best is not None:
            self.standing.fewest_unused = self.standing.best.key[0]
            model.cp.add(used >= required - self.standing.best.key[0] + self.hopeless_required())
        self.minimise_cost_then_changes()

    def run_with_all_required(self) -> bool:
        """Go through the stages for plans that use all required transformations; False if there are none."""
        self.begin()
        for used in self.model.uses_required.values():
            self.model.cp.add(used == 1)
        try:
            self.minimise_cost_then_changes()
        except InfeasibleError:
            return False
        return True

    def begin(self) -> None:
        """Add what is known before the first round."""
        model = self.model
        for name in ("rounds", "cuts", "conflicts"):
            self.standing.counts.setdefault(name, 0)
        self.standing.counts["booleans"] = len(model.literals)
        one_of_those_alike_is_enough(model)
        model.enough_of_each_run(self.prepared.landmarks())
        if self.prepared.cost_us is not None:
            model.cp.add(model.cost() <= self.prepared.cost_us)

    def minimise_cost_then_changes(self) -> None:
        """The last two stages."""
        model, standing = self.model, self.standing
        standing.stage = Stage.COST
        if standing.best is None or standing.best.key[1] > standing.bound_us or model.uses_required:
            if not self.minimise(model.cost()):
                return
            assert standing.best is not None
            standing.raise_bound(standing.best.key[1])
        model.cp.add(model.cost() <= standing.best.key[1])
        standing.stage = Stage.CHANGES
        if self.minimise(model.changes()):
            standing.stage = Stage.DONE

    def changes_scale(self) -> int | None:
        """What a microsecond must weigh against changes to add both up; None if the sum would not be exact."""
        started = sum(candidate.running is None for candidate in self.site.candidates)
        rewired = len(self.site.candidates) - started
        scale = (started + 1) * (rewired + 1)
        most = scale * (1 + sum(candidate.cost_us for candidate in self.site.candidates))
        if (
            self.standing.best is None
            or self.standing.best.key[1] * scale >= EXACT
            or most >= LARGEST
            or self.model.uses_required
        ):
            return None
        return scale

    def hopeless_required(self) -> int:
        """How many required transformations can never be used, whatever is planned."""
        return sum(t.required for t in self.site.environment.library) - len(self.model.uses_required)

    def minimise(self, objective: LinearExprT) -> bool:
        """Rounds of solving and cutting; True with a proof that the incumbent is best in this stage."""
        self.model.cp.minimize(objective)
        while not self.standing.clock.is_over():
            solver = self.solver()
            self.hint()
            self.standing.counts["rounds"] += 1
            solver.best_bound_callback = lambda bound: self.learn_bound(ceil(bound - 0.5))
            status = solve(solver, self.model.cp, OnSolution(self.look_at), self.standing.clock)
            self.standing.counts["conflicts"] += solver.num_conflicts
            if status in (OPTIMAL, FEASIBLE, UNKNOWN):
                self.learn_bound(ceil(solver.best_objective_bound - 0.5))
            if status == INFEASIBLE:
                raise InfeasibleError
            if status == MODEL_INVALID:
                raise ContradictionError("the engine refuses the model")
            if status not in (OPTIMAL, FEASIBLE):
                return False
            true = {x.index for x in self.model.literals if solver.boolean_value(x)}
            level = self.level_of(self.consider(true))
            if level is not None and status != OPTIMAL:
                return False
            if level is not None and level <= round(solver.objective_value):
                return True
            self.cut(true)
        return False

    def level_of(self, key: Key | None) -> int | None:
        """The present stage's objective for a plan with this key."""
        if key is None:
            return None
        if self.standing.stage is Stage.REQUIRED:
            return key[0] - self.hopeless_required()
        if self.standing.stage is Stage.COST:
            return key[1]
        started = sum(candidate.running is None for candidate in self.site.candidates)
        changes = (started + 1) * key[2] + key[3]
        scale = self.changes_scale() if self.standing.stage is Stage.COST_AND_CHANGES else 0
        return (scale or 0) * key[1] + changes

    def consider(self, true: set[int]) -> Key | None:
        """The key of a solution, which becomes the incumbent if it is better; None if it is not grounded."""
        rank = self.model.support.grounded(true)
        units = decode(self.model, true, rank)
        return None if units is None else self.standing.offer(units)

    def look_at(self, holds: Callable[[IntVar], bool]) -> bool:
        """Look at a solution on the way: one that is grounded is a plan, after which the solver may go on.

        One that is not is forbidden at once, since to see what is best beside it takes long.
        """
        return self.consider({literal.index for literal in self.model.literals if holds(literal)}) is not None

    def cut(self, true: set[int]) -> None:
        """Forbid a solution that is not grounded, and all others that fail for the same reason."""
        support = self.model.support
        literals = self.model.literals
        rank = support.grounded(true)
        unfounded, ways_in = support.cut(true, rank)
        assert unfounded, "a solution without a plan has something that is not grounded"
        for proposition in unfounded:
            self.model.needs_any(literals[proposition], [literals[way] for way in ways_in])
        self.standing.counts["cuts"] += len(unfounded)
        running = zip(self.model.runs, self.site.candidates, strict=True)
        used = {candidate.transformation.label for runs, candidate in running if runs.index in true}
        self.model.enough_of_each_run(self.missed(used, self.standing.clock))

    def learn_bound(self, objective: int) -> None:
        """What a bound on the present stage's objective says about the cost."""
        if self.standing.stage is Stage.COST:
            self.standing.raise_bound(objective)
        elif self.standing.stage is Stage.COST_AND_CHANGES:
            self.standing.raise_bound(objective // (self.changes_scale() or 1))

    def solver(self) -> CpSolver:
        """An engine for one round, with the time that is left."""
        size = len(self.model.literals)
        solver = repeatable_solver(small=size < SMALL, time_limit_s=self.standing.clock.left_s())
        if size < TINY:
            solver.parameters.max_presolve_iterations = 1
        return solver

    def hint(self) -> None:
        """Start from the incumbent's units."""
        self.model.cp.clear_hints()  # type: ignore[no-untyped-call]
        if self.standing.best is not None:
            running = {unit.id for unit in self.standing.best.units}
            for runs, candidate in zip(self.model.runs, self.site.candidates, strict=True):
                self.model.cp.add_hint(runs, candidate.id in running)
