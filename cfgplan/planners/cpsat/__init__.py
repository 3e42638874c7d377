"""The exact planner: bounds and a first plan from arrays, then CP-SAT with lazily added groundedness."""

from __future__ import annotations

from collections.abc import Callable
from threading import Event

from cfgplan.planners.cpsat.search import Grounding
from cfgplan.planners.cpsat.session import PlannerSession
from cfgplan.planning import Plan, Problem, Progress

__all__ = ["Grounding", "PlannerSession", "plan"]


def plan(
    problem: Problem,
    *,
    time_limit_s: float | None = None,
    report: Callable[[Progress], None] | None = None,
    stop: Event | None = None,
) -> Plan:
    """The optimal update, see `planning.Planner`; `stop` ends it early with the best plan so far, as Ctrl-C does."""
    return PlannerSession().plan(problem, time_limit_s=time_limit_s, report=report, stop=stop)
