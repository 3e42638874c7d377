"""The exact planner for what the paper leaves to the future: quality, hosts, conflicts, instances, spares.

One constraint model in which every possible subscription has a boolean, solved objective by objective.
"""

from __future__ import annotations

from collections.abc import Callable
from threading import Event

from cfgplan.planners.cpsat.clock import Clock
from cfgplan.planners.fleet.candidates import Candidates
from cfgplan.planning import Plan, Problem, Progress, Status
from cfgplan.reasons import unmet_reasons

__all__ = ["plan"]


def plan(
    problem: Problem,
    *,
    time_limit_s: float | None = None,
    report: Callable[[Progress], None] | None = None,
    stop: Event | None = None,
) -> Plan:
    """The optimal update, see `planning.Planner`; `stop` ends it early with the best plan so far, as Ctrl-C does."""
    clock = Clock(time_limit_s, stop)
    if reasons := unmet_reasons(problem):
        return Plan("cpsat", Status.INFEASIBLE, reasons=reasons, seconds=clock.end("closure"))
    candidates = Candidates(problem)
    clock.end("closure")
    if clock.is_over():
        return Plan("cpsat", Status.UNKNOWN, seconds=clock.seconds)
    from cfgplan.planners.fleet.search import Search  # the solver takes long to import

    search = Search(candidates, clock, report)
    clock.end("model")
    search.run()
    clock.end("search")
    return search.plan()
