"""The same planner written in the obvious ways, for comparison: `module:function` planners."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress

from ortools.sat.python.cp_model import CpSolver

from cfgplan.planners.cpsat.prepared import Prepared
from cfgplan.planners.cpsat.search import Search
from cfgplan.planners.cpsat.standing import Standing
from cfgplan.planners.networks.site import Site, relevant
from cfgplan.planners.solving.clock import Clock, OutOfTimeError
from cfgplan.planning import Plan, Problem, Progress, Status
from cfgplan.reasons import Givers, startable, unmet_reasons
from experiments.planning.levels import everything_rests_on_something_lower


class Levels(Search):
    """The search with level variables: there is nothing to cut."""

    def begin(self) -> None:
        super().begin()
        everything_rests_on_something_lower(self.model)


class Defaults(Levels):
    """The same with the solver's default parameters but one worker."""

    def solver(self) -> CpSolver:
        solver = CpSolver()
        solver.parameters.num_workers = 1
        left_s = self.standing.clock.left_s()
        if left_s is not None:
            solver.parameters.max_time_in_seconds = left_s
        return solver


def _unprepared(search: type[Search], problem: Problem, limit_s: float | None, report: Report) -> Plan:
    clock = Clock(limit_s)
    givers = Givers(problem.environment.library, problem.similarity)
    possible = startable(problem.environment, givers)
    reasons = unmet_reasons(problem, possible=possible)
    if reasons:
        return Plan("cpsat", Status.INFEASIBLE, reasons=reasons, seconds=clock.end("closure"))
    labels = relevant(problem.environment, givers, possible)
    prepared = Prepared(sorted(labels))
    standing = Standing(Site(problem, givers, labels), prepared, clock, report)
    with suppress(OutOfTimeError):
        search(standing, prepared).run()
    clock.end("search")
    return standing.plan()


Report = Callable[[Progress], None] | None


def cuts_alone(problem: Problem, *, time_limit_s: float | None = None, report: Report = None) -> Plan:
    """Hub model with lazy cuts and the planner's parameters, without preprocessing, bounds or a first plan."""
    return _unprepared(Search, problem, time_limit_s, report)


def levels_alone(problem: Problem, *, time_limit_s: float | None = None, report: Report = None) -> Plan:
    """Hub model with level variables and the planner's parameters, without preprocessing."""
    return _unprepared(Levels, problem, time_limit_s, report)


def defaults_alone(problem: Problem, *, time_limit_s: float | None = None, report: Report = None) -> Plan:
    """Hub model with level variables and CP-SAT's default parameters on one worker."""
    return _unprepared(Defaults, problem, time_limit_s, report)
