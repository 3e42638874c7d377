"""The search: one objective after the other, each by rounds of solving and cutting what is not grounded."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from math import ceil

from ortools.sat.python.cp_model import (
    FEASIBLE,
    INFEASIBLE,
    OPTIMAL,
    UNKNOWN,
    CpSolver,
    IntVar,
    LinearExpr,
    LinearExprT,
)

from cfgplan.domain import ComputationUnit
from cfgplan.planners.cpsat.clock import Clock
from cfgplan.planners.cpsat.decode import decode
from cfgplan.planners.cpsat.engine import OnSolution, repeatable_solver, solve
from cfgplan.planners.cpsat.levels import everything_rests_on_something_lower
from cfgplan.planners.cpsat.model import Model
from cfgplan.planners.cpsat.prepared import Prepared
from cfgplan.planners.cpsat.quality import Key, key_of, unused_required
from cfgplan.planners.cpsat.site import Site
from cfgplan.planners.cpsat.wiring import forced_changes, wire
from cfgplan.planning import Plan, Progress, Status

SMALL = 1000
"""With fewer booleans than this, probing and looking for symmetries take longer than they save."""
EXACT = 2**50
"""Up to here the solver's bound, a double, is exact."""
LARGEST = 2**62
"""No sum of the solver's integers may exceed this."""


class Stage(Enum):
    """What is being minimised."""

    REQUIRED = "unused required transformations"
    COST = "cost"
    CHANGES = "rewired and started units"
    COST_AND_CHANGES = "cost, then rewired and started units, in one sum"
    DONE = "nothing: all is proven"


class Grounding(Enum):
    """How the model makes sure that every unit's data comes from sources."""

    CUTS = "lazy cuts"
    LEVELS = "level variables"


@dataclass
class Incumbent:
    """The best plan so far."""

    key: Key
    units: list[ComputationUnit]


class Search:
    """A site on its way to the optimum: the stage, the incumbent and the proven bound on the cost."""

    def __init__(
        self,
        site: Site,
        prepared: Prepared,
        clock: Clock,
        report: Callable[[Progress], None] | None,
        grounding: Grounding = Grounding.CUTS,
    ) -> None:
        self.site = site
        self.grounding = grounding
        self.prepared = prepared
        self.clock = clock
        self.report = report
        self.stage = Stage.REQUIRED
        self.best: Incumbent | None = None
        self.bound_us = 0
        self.counts = {**prepared.counts}
        self.raise_bound(prepared.bound_us)

    def run(self) -> None:
        """Begin with the first plan; where that is not proven optimal, go on with the model."""
        if self.prepared.plan is not None:
            chosen = self.site.first_of_each(self.prepared.plan)
            units = wire(self.site, chosen)
            if units is not None:
                self.offer(units)
            if self.is_proven(chosen):
                self.stage = Stage.DONE
                return
        if not self.clock.is_over():
            self.run_model(Model(self.site))

    def is_proven(self, chosen: set[int]) -> bool:
        """Whether the incumbent is the only choice of units at its cost, with no more rewired than must be."""
        return (
            self.best is not None
            and self.best.key[:2] == (0, self.bound_us)
            and len(chosen) == len(self.site.candidates) == len(self.best.units)
            and self.best.key[2] == forced_changes(self.site, chosen)
        )

    def run_model(self, model: Model) -> None:
        """Go through the stages until the clock stops one."""
        self.model = model
        self.counts |= {"booleans": len(model.literals), "rounds": 0, "cuts": 0, "conflicts": 0}
        model.some_member_of_each_runs(self.prepared.landmarks)
        if self.grounding is Grounding.LEVELS:
            everything_rests_on_something_lower(model)
        if self.prepared.cost_us is not None:
            model.cp.add(model.cost() <= self.prepared.cost_us)
        scale = self.changes_scale()
        if scale is not None:
            self.stage = Stage.COST_AND_CHANGES
            if self.minimise(LinearExpr.weighted_sum([model.cost(), model.changes()], [scale, 1])):
                self.stage = Stage.DONE
                self.raise_bound(self.best.key[1] if self.best else 0)
            return
        required = len(model.uses_required)
        used = sum(model.uses_required.values())
        if required and not self.minimise(required - used):
            return
        if required and self.best is not None:
            model.cp.add(used >= required - self.best.key[0] + self.hopeless_required())
        self.stage = Stage.COST
        if self.best is None or self.best.key[1] > self.bound_us or required:
            if not self.minimise(model.cost()):
                return
            assert self.best is not None
            self.raise_bound(self.best.key[1])
        model.cp.add(model.cost() <= self.best.key[1])
        self.stage = Stage.CHANGES
        if self.minimise(model.changes()):
            self.stage = Stage.DONE

    def changes_scale(self) -> int | None:
        """What a microsecond must weigh against changes to add both up; None if the sum would not be exact."""
        started = sum(candidate.running is None for candidate in self.site.candidates)
        rewired = len(self.site.candidates) - started
        scale = (started + 1) * (rewired + 1)
        most = scale * (1 + sum(candidate.cost_us for candidate in self.site.candidates))
        if self.best is None or self.best.key[1] * scale >= EXACT or most >= LARGEST or self.model.uses_required:
            return None
        return scale

    def hopeless_required(self) -> int:
        """How many required transformations can never be used, whatever is planned."""
        return sum(t.required for t in self.site.environment.library) - len(self.model.uses_required)

    def minimise(self, objective: LinearExprT) -> bool:
        """Rounds of solving and cutting; True with a proof that the incumbent is best in this stage."""
        self.model.cp.minimize(objective)
        while not self.clock.is_over():
            solver = self.solver()
            self.hint()
            self.counts["rounds"] += 1
            solver.best_bound_callback = lambda bound: self.learn_bound(ceil(bound - 0.5))
            status = solve(solver, self.model.cp, OnSolution(self.look_at), self.clock)
            self.counts["conflicts"] += solver.num_conflicts
            if status in (OPTIMAL, FEASIBLE, UNKNOWN):
                self.learn_bound(ceil(solver.best_objective_bound - 0.5))
            if status == INFEASIBLE:
                raise AssertionError("a problem whose targets can all be met has a plan")
            if status not in (OPTIMAL, FEASIBLE):
                return False
            true = {x.index for x in self.model.literals if solver.boolean_value(x)}
            level = self.level_of(self.consider(true))
            if status != OPTIMAL:
                return False
            if level is not None and level <= round(solver.objective_value):
                return True
            self.cut(true)
        return False

    def level_of(self, key: Key | None) -> int | None:
        """The present stage's objective for a plan with this key."""
        if key is None:
            return None
        if self.stage is Stage.REQUIRED:
            return key[0] - self.hopeless_required()
        if self.stage is Stage.COST:
            return key[1]
        started = sum(candidate.running is None for candidate in self.site.candidates)
        changes = (started + 1) * key[2] + key[3]
        scale = self.changes_scale() if self.stage is Stage.COST_AND_CHANGES else 0
        return (scale or 0) * key[1] + changes

    def consider(self, true: set[int]) -> Key | None:
        """The key of a solution, which becomes the incumbent if it is better; None if it is not grounded."""
        rank = self.model.support.grounded(true)
        units = decode(self.model, true, rank)
        return None if units is None else self.offer(units)

    def look_at(self, holds: Callable[[IntVar], bool]) -> None:
        """Look at a solution on the way: one that is grounded is a plan."""
        self.consider({literal.index for literal in self.model.literals if holds(literal)})

    def offer(self, units: list[ComputationUnit]) -> Key:
        """Take a plan as the incumbent if it is the best so far; returns its key."""
        key = key_of(self.site.problem, units)
        if self.best is None or key < self.best.key:
            self.best = Incumbent(key, units)
            self.tell()
        return key

    def cut(self, true: set[int]) -> None:
        """Forbid a solution that is not grounded, and all others that fail for the same reason."""
        support = self.model.support
        literals = self.model.literals
        unfounded, ways_in = support.cut(true, support.grounded(true))
        assert unfounded, "a solution without a plan has something that is not grounded"
        for proposition in unfounded:
            self.model.needs_any(literals[proposition], [literals[way] for way in ways_in])
        self.counts["cuts"] += len(unfounded)

    def learn_bound(self, objective: int) -> None:
        """What a bound on the present stage's objective says about the cost."""
        if self.stage is Stage.COST:
            self.raise_bound(objective)
        elif self.stage is Stage.COST_AND_CHANGES:
            self.raise_bound(objective // (self.changes_scale() or 1))

    def raise_bound(self, bound_us: int) -> None:
        if bound_us > self.bound_us:
            self.bound_us = bound_us
            self.tell()

    def tell(self) -> None:
        if self.report is not None:
            cost_us = self.best.key[1] if self.best else None
            self.report(Progress(self.clock.elapsed_s(), cost_us, self.bound_us))

    def solver(self) -> CpSolver:
        """An engine for one round, with the time that is left."""
        return repeatable_solver(small=len(self.model.literals) < SMALL, time_limit_s=self.clock.left_s())

    def hint(self) -> None:
        """Start from the incumbent's units."""
        self.model.cp.clear_hints()  # type: ignore[no-untyped-call]
        if self.best is not None:
            running = {unit.id for unit in self.best.units}
            for runs, candidate in zip(self.model.runs, self.site.candidates, strict=True):
                self.model.cp.add_hint(runs, candidate.id in running)

    def plan(self) -> Plan:
        """The answer at the present stage."""
        problem, max_cost_us = self.site.problem, self.site.problem.max_cost_us
        counts, seconds = self.counts, self.clock.seconds
        proven = self.stage in (Stage.CHANGES, Stage.DONE)
        if max_cost_us is not None and self.bound_us > max_cost_us:
            cost_us = self.best.key[1] if self.best is not None and proven else None
            return Plan("cpsat", Status.TOO_EXPENSIVE, None, cost_us, self.bound_us, seconds=seconds, counts=counts)
        if self.best is None or (max_cost_us is not None and self.best.key[1] > max_cost_us):
            return Plan("cpsat", Status.UNKNOWN, bound_us=self.bound_us, seconds=seconds, counts=counts)
        return Plan(
            "cpsat",
            Status.OPTIMAL if self.stage is Stage.DONE else Status.FEASIBLE,
            problem.environment.change_to(self.best.units),
            self.best.key[1],
            self.bound_us,
            unused_required=unused_required(problem, self.best.units),
            seconds=seconds,
            counts=counts,
        )
