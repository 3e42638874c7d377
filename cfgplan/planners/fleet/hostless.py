"""What a fleet costs if hosts are forgotten: no less than that, and transfers come on top."""

from __future__ import annotations

from dataclasses import replace

from cfgplan.planners.fleet.candidates import Candidates
from cfgplan.planners.solving.clock import Clock
from cfgplan.planning import InterruptiblePlanner

SHARE = 0.2
"""Of the time that is left, for the problem without hosts."""


def hostless(candidates: Candidates, clock: Clock, planner: InterruptiblePlanner) -> tuple[int, frozenset[str]]:
    """A bound on all costs but transfers, and the transformations of the plan without hosts, by a planner."""
    problem, environment = candidates.problem, candidates.environment
    left_s = clock.left_s()
    anywhere = replace(
        environment,
        units=tuple(replace(c.running, host=None) for c in candidates.all if c.running is not None),
        library=tuple(replace(t, host=None, hosts=()) for t in environment.library),
        targets=tuple(replace(target, host=None) for target in environment.targets),
        hosts=(),
    )
    found = planner(
        replace(problem, environment=anywhere, max_cost_us=None),
        time_limit_s=None if left_s is None else SHARE * left_s,
        stop=clock.stop,
    )
    if found.change_set is None:
        return found.bound_us, frozenset()
    return found.bound_us, frozenset(unit.transformation for unit in anywhere.update(found.change_set).units)
