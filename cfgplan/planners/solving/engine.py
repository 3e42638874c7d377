"""CP-SAT as cfgplan runs it: repeatable, interruptible at any moment, with results checked against its number range."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import inf
from threading import Event, Thread
from typing import Final

from ortools.sat.python.cp_model import (
    FEASIBLE,
    INFEASIBLE,
    OPTIMAL,
    UNKNOWN,
    CpModel,
    CpSolver,
    CpSolverSolutionCallback,
    CpSolverStatus,
    IntVar,
    LinearExpr,
)

from cfgplan.planners.solving.clock import Clock

WIDEST: Final = 2**31 - 1
"""With full linearisation CP-SAT 9.15 cuts off solutions in which a variable has a larger value."""
LARGEST_PRODUCT: Final = 2**53
"""Products of a coefficient and a value are doubles in the engine's linear relaxation: exact up to here."""


class ExactModel(CpModel):
    """A model that knows whether all its numbers are small enough for the engine's fastest setting."""

    def __init__(self) -> None:
        super().__init__()
        self._seen = 0
        self._largest: dict[int, int] = {}
        self._is_exact = True

    def is_exact(self) -> bool:
        """Whether no variable and no product in a constraint or in the objective is too large. Looks at new ones."""
        proto = self.proto
        constraints, number = proto.constraints, len(proto.constraints)
        while self._is_exact and self._seen < number:
            constraint = constraints[self._seen]
            self._seen += 1
            if constraint.has_linear():
                linear = constraint.linear
                self._is_exact = self._are_small(linear.vars, linear.coeffs)
        return self._is_exact and self._are_small(proto.objective.vars, proto.objective.coeffs)

    def _are_small(self, variables: Sequence[int], coefficients: Sequence[int]) -> bool:
        for variable, coefficient in zip(variables, coefficients, strict=True):
            largest = self._largest.get(variable)
            if largest is None:
                reference = variable if variable >= 0 else -variable - 1
                domain = self.proto.variables[reference].domain  # ascending; it takes no negative index
                largest = self._largest[variable] = max(-domain[0], domain[len(domain) - 1])
            if largest > WIDEST or abs(coefficient) * largest > LARGEST_PRODUCT:
                return False
        return True


def repeatable_solver(*, small: bool, tiny: bool = False, time_limit_s: float | None) -> CpSolver:
    """A solver with one worker, which is repeatable, and full linearisation (the default proves 10 times as slowly).

    In `small` models, probing and looking for symmetries take longer than they save. In `tiny` ones, so does presolving
    more than once.
    """
    solver = CpSolver()
    solver.parameters.num_workers = 1
    solver.parameters.catch_sigint_signal = False
    solver.parameters.linearization_level = 2
    solver.parameters.cut_level = 0
    if small:
        solver.parameters.cp_model_probing_level = 0
        solver.parameters.symmetry_level = 0
    if tiny:
        solver.parameters.max_presolve_iterations = 1
    if time_limit_s is not None:
        solver.parameters.max_time_in_seconds = time_limit_s
    return solver


def at_least(model: CpModel, least: int, literals: Sequence[IntVar]) -> None:
    """Demand that at least `least` of the literals hold; a repeated literal counts as often as it is given."""
    if least == 1:
        model.add_bool_or(literals)
    else:
        model.add(sum(literals) >= least)


def solve(
    solver: CpSolver,
    model: ExactModel,
    clock: Clock,
    look_at: Callable[[CpSolverSolutionCallback], bool] = lambda _: True,
    learn: Callable[[float], None] | None = None,
) -> CpSolverStatus:
    """Solve in a thread, so that `stop` and Ctrl-C end it with the best solution so far.

    `look_at` is called at each solution, and returns whether to continue. `learn` is called with bounds on the
    objective. A model with larger numbers than the engine is exact with is solved without full linearisation, and the
    engine's "optimal" or "infeasible" stands only if it says so without any linearisation too: else the status is
    "feasible" or "unknown". No bound is learned before that.

    Raises KeyboardInterrupt if Ctrl-C comes before the thread has started, and the exceptions of `look_at`. No solving
    thread is left behind: it would make the process abort when that ends.
    """
    is_exact = model.is_exact()
    if not is_exact:
        solver.parameters.linearization_level = min(solver.parameters.linearization_level, 1)
    elif learn is not None:
        solver.best_bound_callback = learn
    status = _solve_in_a_thread(solver, model, clock, look_at)
    if not is_exact:
        if status not in (OPTIMAL, INFEASIBLE):
            return status
        if not _is_confirmed(solver, model, clock, status):
            return FEASIBLE if status == OPTIMAL else UNKNOWN
    if learn is not None and status in (OPTIMAL, FEASIBLE, UNKNOWN):
        learn(solver.best_objective_bound)
    return status


def _is_confirmed(solver: CpSolver, model: CpModel, clock: Clock, status: CpSolverStatus) -> bool:
    """Whether the engine finds nothing, or nothing better, without linearisation too, in as much of its time."""
    rest, objective = model.clone(), model.proto.objective
    if status == OPTIMAL:
        if not len(objective.vars):
            return True
        reached = solver.response_proto.solution
        variables = [rest.get_int_var_from_proto_index(index) for index in objective.vars]
        best = sum(weight * reached[index] for index, weight in zip(objective.vars, objective.coeffs, strict=True))
        rest.clear_objective()  # type: ignore[no-untyped-call]
        rest.add(LinearExpr.weighted_sum(variables, list(objective.coeffs)) <= best - 1)
    second = repeatable_solver(small=False, time_limit_s=clock.left_s())
    second.parameters.linearization_level = 0
    if (slice_s := solver.parameters.max_deterministic_time) < inf:
        second.parameters.max_deterministic_time = slice_s
    return _solve_in_a_thread(second, rest, clock, lambda _: True) == INFEASIBLE


def _solve_in_a_thread(
    solver: CpSolver, model: CpModel, clock: Clock, look_at: Callable[[CpSolverSolutionCallback], bool]
) -> CpSolverStatus:
    callback = _OnSolution(look_at)
    status: list[CpSolverStatus] = []
    raised: list[BaseException] = []
    begun, done, is_given_up = Event(), Event(), Event()

    def work() -> None:
        begun.set()
        try:
            if not is_given_up.is_set():
                status.append(solver.solve(model, callback))
        except BaseException as error:  # told where it can be caught
            raised.append(error)
        finally:
            done.set()

    try:
        Thread(target=work, daemon=True).start()
    except KeyboardInterrupt:
        clock.stop.set()
        is_given_up.set()
        if not begun.is_set():
            raise
    while True:
        try:
            while not done.wait(0.05):
                if clock.is_over():
                    solver.stop_search()
            break
        except KeyboardInterrupt:
            clock.stop.set()
    if raised:
        raise raised[0]
    if is_given_up.is_set() and not status:
        raise KeyboardInterrupt
    return status[0]


class _OnSolution(CpSolverSolutionCallback):
    """Calls `look_at` with itself, which knows the values of the solution."""

    def __init__(self, look_at: Callable[[CpSolverSolutionCallback], bool]) -> None:
        super().__init__()
        self._look_at = look_at

    def on_solution_callback(self) -> None:
        if not self._look_at(self):
            self.stop_search()
