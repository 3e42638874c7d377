"""The exact planner: bounds and a first plan from arrays, then CP-SAT with lazily added groundedness.

Begin with `session`, which says what is done when. What is known on the way is in `structure`, `prepared` and `rest`,
and in the `standing` of the room `fleet`, where `rules` are those of the constraint model and `search` runs it. Where
nothing more than labels has to be chosen `deciding` needs no model. The rooms `networks`, `bounding`, `closing` and
`solving` can be read by themselves.
"""

from __future__ import annotations

from collections.abc import Callable
from threading import Event

from cfgplan.planners.cpsat.session import PlannerSession
from cfgplan.planning import Plan, Problem, Progress

__all__ = ["PlannerSession", "plan"]


def plan(
    problem: Problem,
    *,
    time_limit_s: float | None = None,
    report: Callable[[Progress], None] | None = None,
    stop: Event | None = None,
) -> Plan:
    """The optimal update, see `planning.Planner`; `stop` ends it early with the best plan so far, as Ctrl-C does."""
    return PlannerSession().plan(problem, time_limit_s=time_limit_s, report=report, stop=stop)
