"""CP-SAT as it is run here: repeatable, and to be stopped at any moment."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from threading import Event, Thread

from ortools.sat.python.cp_model import CpModel, CpSolver, CpSolverSolutionCallback, CpSolverStatus, IntVar

from cfgplan.planners.solving.clock import Clock


def repeatable_solver(*, small: bool, time_limit_s: float | None) -> CpSolver:
    """A solver with one worker, which is repeatable, and full linearisation (the default proves 10 times as slowly).

    In `small` models, probing and looking for symmetries take longer than they save.
    """
    solver = CpSolver()
    solver.parameters.num_workers = 1
    solver.parameters.catch_sigint_signal = False
    solver.parameters.linearization_level = 2
    solver.parameters.cut_level = 0
    if small:
        solver.parameters.cp_model_probing_level = 0
        solver.parameters.symmetry_level = 0
    if time_limit_s is not None:
        solver.parameters.max_time_in_seconds = time_limit_s
    return solver


def at_least(model: CpModel, least: int, literals: Sequence[IntVar]) -> None:
    """Demand that at least `least` of the literals hold; one that is there twice counts twice."""
    if least == 1:
        model.add_bool_or(literals)
    else:
        model.add(sum(literals) >= least)


def solve(
    solver: CpSolver,
    model: CpModel,
    clock: Clock,
    look_at: Callable[[CpSolverSolutionCallback], bool] = lambda _: True,
) -> CpSolverStatus:
    """Solve in a thread, so that `stop` and Ctrl-C end it with the best solution so far.

    `look_at` is called at each solution, and returns whether to go on. Raises KeyboardInterrupt if Ctrl-C comes before
    the thread is there, and what `look_at` raises. No solving thread is left behind: it would make the process abort
    when that ends.
    """
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
                if clock.stop.is_set():
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
