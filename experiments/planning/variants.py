"""Simpler variants of the planner, for comparison: planners for `module:function`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress

from ortools.sat.python.cp_model import CpSolver

from cfgplan.planners.exact.candidates import Candidates
from cfgplan.planners.exact.model import ModelRule
from cfgplan.planners.exact.rules import RULES
from cfgplan.planners.exact.search import Search
from cfgplan.planners.exact.solve_state import SolveState
from cfgplan.planners.reducing.closure import Closure
from cfgplan.planners.solving.clock import Clock, OutOfTimeError
from cfgplan.planning import Plan, Problem, Progress, Status, refuse_features
from cfgplan.reasons import unmet_reasons
from experiments.planning.levels import everything_rests_on_something_lower

Report = Callable[[Progress], None] | None
LEVELS = (*RULES, everything_rests_on_something_lower)


class Defaults(Search):
    """The search with the solver's default parameters, on one worker."""

    def solver(self) -> CpSolver:
        solver = CpSolver()
        solver.parameters.num_workers = 1
        left_s = self.state.clock.left_s()
        if left_s is not None:
            solver.parameters.max_time_in_seconds = left_s
        return solver


def _unprepared(
    search: type[Search], rules: Sequence[ModelRule], problem: Problem, limit_s: float | None, report: Report
) -> Plan:
    refuse_features(problem, "the model alone")
    clock = Clock(limit_s)
    closure = Closure.of(problem, clock)
    reasons = unmet_reasons(problem, possible=closure.possible)
    if reasons:
        return Plan("cpsat", Status.INFEASIBLE, reasons=reasons, seconds=clock.end("closure"))
    state = SolveState(problem, clock, report)
    with suppress(OutOfTimeError):
        search(Candidates(problem, closure, clock=clock), state, rules=rules).run()
    clock.end("search")
    return state.plan()


def cuts_alone(problem: Problem, *, time_limit_s: float | None = None, report: Report = None) -> Plan:
    """Plan by the hub model with lazy cuts and the planner's parameters; no preprocessing, bounds or first plan."""
    return _unprepared(Search, RULES, problem, time_limit_s, report)


def levels_alone(problem: Problem, *, time_limit_s: float | None = None, report: Report = None) -> Plan:
    """Plan by the hub model with level variables and the planner's parameters, without preprocessing."""
    return _unprepared(Search, LEVELS, problem, time_limit_s, report)


def defaults_alone(problem: Problem, *, time_limit_s: float | None = None, report: Report = None) -> Plan:
    """Plan by the hub model with level variables and CP-SAT's default parameters on one worker."""
    return _unprepared(Defaults, LEVELS, problem, time_limit_s, report)
