"""Offers what runs as a fleet's first plan: no plan is worse than to change nothing."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from graphlib import CycleError, TopologicalSorter

from cfgplan.domain import ComputationUnit
from cfgplan.planners.exact.candidates import Candidates
from cfgplan.planners.exact.decode import lean, without_broken
from cfgplan.planners.exact.first_plans import FirstPlans
from cfgplan.planners.exact.standing import Standing
from cfgplan.planners.exact.wiring import running_library
from cfgplan.planners.networks.keys import may_stay
from cfgplan.planning import Problem


def offer_what_runs(standing: Standing) -> None:
    """Offer what runs, less what nothing needs, if that is valid."""
    problem = standing.problem
    if standing.clock.tuning.is_solver_only:
        return
    environment, library = problem.environment, running_library(problem.environment)
    if any(t.min_instances and t not in library for t in environment.library):
        return
    candidates = Candidates(replace(problem, environment=replace(environment, library=library)))
    units = _wired(candidates)
    kept = {unit.id for unit in units}
    pinned = {t.label for t in library if t.pinned}
    if any(u.transformation in pinned and not u.standby and u.id not in kept for u in environment.units):
        return
    if _meets_targets(problem, units) and _is_grounded(candidates, units):
        units = lean(candidates, units)
        if FirstPlans(candidates, standing).is_valid(units):
            standing.offer(units)


def _wired(candidates: Candidates) -> list[ComputationUnit]:
    """The running units that are fed, without the topics that nobody wants, and the cold spares."""
    topics = {target.topic for target in candidates.environment.targets}
    units = [candidate.running for candidate in candidates.all if candidate.running is not None]
    hot = [
        replace(unit, publications=tuple(p for p in unit.publications if p.topic in topics))
        for unit in units
        if not unit.standby
    ]
    labels = {unit.transformation for unit in hot}
    hot = without_broken([unit for unit in hot if may_stay(candidates.problem, labels, unit)])
    return [*hot, *(unit for unit in units if unit.standby)]


def _meets_targets(problem: Problem, units: list[ComputationUnit]) -> bool:
    topics = Counter(publication.topic for unit in units for publication in unit.publications)
    return topics == Counter(target.topic for target in problem.environment.targets)


def _is_grounded(candidates: Candidates, units: list[ComputationUnit]) -> bool:
    """Whether no unit feeds itself, directly or through others, but by feedback inputs."""
    library = candidates.environment.transformation
    feeders = {
        unit.id: [s.stream.unit for s in unit.subscriptions if not library[unit.transformation].input[s.port].feedback]
        for unit in units
    }
    try:
        TopologicalSorter(feeders).prepare()
    except CycleError:
        return False
    return True
