"""Offers what runs as a first plan: no plan is worse than to change nothing."""

from __future__ import annotations

from cfgplan.domain import ComputationUnit, Environment
from cfgplan.planners.exact.candidates import Candidates, Closure
from cfgplan.planners.exact.configuration import wire
from cfgplan.planners.exact.standing import Standing
from cfgplan.reasons import Givers, startable


def offer_what_runs(standing: Standing) -> None:
    """Offer what runs, rewired where it has to be and less what nothing needs, if that is valid."""
    problem, environment = standing.problem, standing.problem.environment
    if standing.clock.tuning.is_solver_only:
        return
    labels = {unit.transformation for unit in environment.units}
    library = tuple(t for t in environment.library if t.label in labels)
    givers = Givers(library, problem.similarity)
    possible = startable(Environment((), library), givers)
    if not possible.issuperset(t.label for t in library if t.pinned) or any(
        possible.isdisjoint(givers.of(target.tag)) for target in environment.targets
    ):
        return
    candidates = Candidates(problem, Closure(givers, possible, possible))
    units = wire(candidates, [i for i, c in enumerate(candidates.all) if c.running is not None and c.may_run])
    if units is not None and not problem.is_plain:
        units = _valid(candidates, units, standing)
    if units is not None:
        standing.offer(units)


def _valid(candidates: Candidates, hot: list[ComputationUnit], standing: Standing) -> list[ComputationUnit] | None:
    """These units and the cold spares that wait, less what nothing needs; None if that is not valid."""
    from cfgplan.planners.exact.decode import lean
    from cfgplan.planners.exact.first_plans import FirstPlans

    cold = [c.running for c in candidates.all if c.running is not None and c.running.standby]
    units = lean(candidates, [*hot, *cold])
    return units if FirstPlans(candidates, standing).is_valid(units) else None
