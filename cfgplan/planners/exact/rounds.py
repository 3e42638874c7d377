"""The loop of the search: each round solves a model, and checks its solution."""

from __future__ import annotations

from collections.abc import Callable
from math import ceil
from typing import TypeVar

from ortools.sat.python.cp_model import (
    FEASIBLE,
    INFEASIBLE,
    MODEL_INVALID,
    OPTIMAL,
    CpSolver,
    CpSolverSolutionCallback,
    LinearExprT,
)

from cfgplan.errors import InputError
from cfgplan.planners.exact.model import Model
from cfgplan.planners.exact.solve_state import SolveState
from cfgplan.planners.solving.clock import ContradictionError
from cfgplan.planners.solving.engine import repeatable_solver, solve

Found = TypeVar("Found")


class InfeasibleError(Exception):
    """No plan meets all that was added to the model."""


def minimised(
    model: Model,
    objective: LinearExprT,
    state: SolveState,
    *,
    solver: Callable[[], CpSolver | None],
    look_at: Callable[[CpSolverSolutionCallback], bool],
    learn: Callable[[int], None],
    taken: Callable[[CpSolver, bool], Found | None],
) -> Found | None:
    """Minimise an objective in rounds. Returns the value of `taken` for the last solution; None if time is over.

    `solver` makes a solver for each round and hints at a solution; None ends the rounds. `look_at` gets each solution
    that the solver finds, and returns whether the round continues. `learn` gets bounds. `taken` gets the solution of a
    round, and whether it is proven best; it returns None if the model forbids that solution now. Raises
    InfeasibleError.
    """
    model.cp.minimize(objective)
    while (engine := solver()) is not None:
        state.counts["rounds"] += 1
        status = solve(engine, model.cp, state.clock, look_at, lambda bound: learn(ceil(bound - 0.5)))
        state.counts["conflicts"] += engine.num_conflicts
        if status == INFEASIBLE and engine.parameters.cp_model_probing_level == 0:
            # Without probing, the engine has called models with costs far apart infeasible that have a solution.
            slice_s = engine.parameters.max_deterministic_time
            engine = repeatable_solver(small=False, time_limit_s=state.clock.left_s())
            engine.parameters.max_deterministic_time = slice_s
            status = solve(engine, model.cp, state.clock, look_at, lambda bound: learn(ceil(bound - 0.5)))
            state.counts["conflicts"] += engine.num_conflicts
        if status == INFEASIBLE:
            raise InfeasibleError
        if status == MODEL_INVALID:
            _refuse(model)
        if status not in (OPTIMAL, FEASIBLE):
            return None
        found = taken(engine, status == OPTIMAL)
        if found is not None:
            return found
    return None


def _refuse(model: Model) -> None:
    """Raise the error that says why the engine refuses a model."""
    if model.problem.is_plain or model.is_grouped:
        raise ContradictionError("the engine refuses the model")
    mend = "give the quality attributes a `worst` and a `best` that are closer, or fewer decimals"
    raise InputError.of("the numbers are too large to be computed exactly", mend=mend)
