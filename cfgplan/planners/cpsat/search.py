"""The search: one objective after the other, each by rounds of solving and cutting what is not grounded."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from math import ceil

from ortools.sat.python import cp_model
from ortools.sat.python.cp_model import LinearExprT

from cfgplan.costs import keep_cost_us, start_cost_us
from cfgplan.domain import ComputationUnit
from cfgplan.planners.cpsat.decode import decode
from cfgplan.planners.cpsat.model import Model
from cfgplan.planners.cpsat.site import Site, relevant
from cfgplan.planning import Plan, Problem, Progress, Status
from cfgplan.reasons import Givers, startable, unmet_reasons

Key = tuple[int, int, int, int]
"""Unused required transformations, cost in microseconds, rewired and started units: the order of optimality."""


def plan(
    problem: Problem,
    *,
    time_limit_s: float | None = None,
    report: Callable[[Progress], None] | None = None,
) -> Plan:
    """The optimal update; see `planning.Planner`. Without a time limit it ends with a proof."""
    clock = Clock(time_limit_s)
    givers = Givers(problem.environment.library, problem.similarity)
    possible = startable(problem.environment, givers)
    if any(possible.isdisjoint(givers.of(target.tag)) for target in problem.environment.targets):
        return Plan("cpsat", Status.INFEASIBLE, reasons=unmet_reasons(problem), seconds=clock.phases("check"))
    site = Site(problem, givers, relevant(problem.environment, givers, possible))
    clock.phase("preprocess")
    model = Model(site)
    clock.phase("build")
    search = Search(model, clock, report)
    search.run()
    clock.phase("solve")
    return search.plan()


class Clock:
    """The time that is left, and what each phase took."""

    def __init__(self, time_limit_s: float | None) -> None:
        self._began = self._phase_began = time.monotonic()
        self._limit_s = time_limit_s
        self.seconds: dict[str, float] = {}

    def elapsed_s(self) -> float:
        return time.monotonic() - self._began

    def left_s(self) -> float | None:
        return None if self._limit_s is None else max(0.0, self._limit_s - self.elapsed_s())

    def phase(self, name: str) -> None:
        """Note that the phase `name` ends now."""
        now = time.monotonic()
        self.seconds[name] = self.seconds.get(name, 0.0) + now - self._phase_began
        self._phase_began = now

    def phases(self, name: str) -> dict[str, float]:
        self.phase(name)
        return self.seconds


class Stage(Enum):
    """What is being minimised."""

    REQUIRED = "unused required transformations"
    COST = "cost"
    CHANGES = "rewired and started units"
    DONE = "nothing: all is proven"


@dataclass
class Incumbent:
    """The best plan so far."""

    key: Key
    units: list[ComputationUnit]


class Search:
    """A model on its way to the optimum: the stage, the incumbent and the proven bound on the cost."""

    def __init__(self, model: Model, clock: Clock, report: Callable[[Progress], None] | None) -> None:
        self.model = model
        self.clock = clock
        self.report = report
        self.stage = Stage.REQUIRED
        self.best: Incumbent | None = None
        self.bound_us = 0
        self.counts = {"booleans": len(model.literals), "rounds": 0, "cuts": 0, "conflicts": 0}

    def run(self) -> None:
        """Go through the stages until the clock stops one."""
        model = self.model
        required = len(model.uses_required)
        used = sum(model.uses_required.values())
        if required and not self.minimise(required - used):
            return
        if required and self.best is not None:
            model.cp.add(used >= required - self.best.key[0] + self.hopeless_required())
        self.stage = Stage.COST
        if not self.minimise(model.cost()) or self.best is None:
            return
        self.raise_bound(self.best.key[1])
        model.cp.add(model.cost() <= self.best.key[1])
        self.stage = Stage.CHANGES
        if self.minimise(model.changes()):
            self.stage = Stage.DONE

    def hopeless_required(self) -> int:
        """How many required transformations can never be used, whatever is planned."""
        return sum(t.required for t in self.model.site.environment.library) - len(self.model.uses_required)

    def minimise(self, objective: LinearExprT) -> bool:
        """Rounds of solving and cutting; True with a proof that the incumbent is best in this stage."""
        self.model.cp.minimize(objective)
        while True:
            solver = self.solver()
            self.hint()
            self.counts["rounds"] += 1
            status = solver.solve(self.model.cp, OnSolution(self))
            self.counts["conflicts"] += solver.num_conflicts
            if self.stage is Stage.COST and status in (cp_model.OPTIMAL, cp_model.FEASIBLE, cp_model.UNKNOWN):
                self.raise_bound(ceil(solver.best_objective_bound - 0.5))
            if status == cp_model.INFEASIBLE:
                raise AssertionError("a problem whose targets can all be met has a plan")
            if status not in (cp_model.OPTIMAL, cp_model.FEASIBLE):
                return False
            true = {x.index for x in self.model.literals if solver.boolean_value(x)}
            level = self.level_of(self.consider(true))
            if status != cp_model.OPTIMAL:
                return False
            if level is not None and level <= round(solver.objective_value):
                return True
            self.cut(true)

    def level_of(self, key: Key | None) -> int | None:
        """The present stage's objective for a plan with this key."""
        if key is None:
            return None
        if self.stage is Stage.REQUIRED:
            return key[0] - self.hopeless_required()
        if self.stage is Stage.COST:
            return key[1]
        started = sum(candidate.running is None for candidate in self.model.site.candidates)
        return (started + 1) * key[2] + key[3]

    def consider(self, true: set[int]) -> Key | None:
        """The key of a solution, which becomes the incumbent if it is better; None if it is not grounded."""
        rank = self.model.support.grounded(true)
        units = decode(self.model, true, rank)
        if units is None:
            return None
        key = key_of(self.model.site.problem, units)
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

    def raise_bound(self, bound_us: int) -> None:
        if bound_us > self.bound_us:
            self.bound_us = bound_us
            self.tell()

    def tell(self) -> None:
        if self.report is not None:
            cost_us = self.best.key[1] if self.best else None
            self.report(Progress(self.clock.elapsed_s(), cost_us, self.bound_us))

    def solver(self) -> cp_model.CpSolver:
        """One worker is repeatable; a full linearisation is what proves these models."""
        solver = cp_model.CpSolver()
        solver.parameters.num_workers = 1
        solver.parameters.linearization_level = 2
        solver.parameters.cut_level = 0
        left_s = self.clock.left_s()
        if left_s is not None:
            solver.parameters.max_time_in_seconds = left_s
        return solver

    def hint(self) -> None:
        """Start from the incumbent's units."""
        self.model.cp.clear_hints()  # type: ignore[no-untyped-call]
        if self.best is not None:
            running = {unit.id for unit in self.best.units}
            for runs, candidate in zip(self.model.runs, self.model.site.candidates, strict=True):
                self.model.cp.add_hint(runs, candidate.id in running)

    def plan(self) -> Plan:
        """The answer at the present stage."""
        problem, max_cost_us = self.model.site.problem, self.model.site.problem.max_cost_us
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


class OnSolution(cp_model.CpSolverSolutionCallback):
    """Looks at every solution on the way: one that is grounded is a plan."""

    def __init__(self, search: Search) -> None:
        super().__init__()
        self._search = search

    def on_solution_callback(self) -> None:
        self._search.consider({x.index for x in self._search.model.literals if self.boolean_value(x)})


def key_of(problem: Problem, units: list[ComputationUnit]) -> Key:
    """How good a wiring is, in the order of optimality."""
    changes = problem.environment.change_to(units)
    library = problem.environment.transformation
    cost_us = sum(
        (keep_cost_us if unit.id in problem.environment.unit else start_cost_us)(
            library[unit.transformation], problem.horizon_s
        )
        for unit in units
    )
    return len(unused_required(problem, units)), cost_us, len(changes.rewired), len(changes.started)


def unused_required(problem: Problem, units: list[ComputationUnit]) -> tuple[str, ...]:
    """The labels of the required transformations without a unit that serves a target."""
    by_id = {unit.id: unit for unit in units}
    ahead = [unit.id for unit in units if unit.publications]
    serving = set(ahead)
    for unit_id in ahead:
        new = {s.stream.unit for s in by_id[unit_id].subscriptions} - serving
        serving |= new
        ahead += sorted(new)
    used = {by_id[unit_id].transformation for unit_id in serving}
    return tuple(t.label for t in problem.environment.library if t.required and t.label not in used)
