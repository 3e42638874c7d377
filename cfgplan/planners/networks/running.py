"""What runs as a plan: nothing is started, and what nothing needs is stopped.

It is known before anything is searched for, so that no plan is worse than to change nothing.
"""

from __future__ import annotations

from cfgplan.domain import ComputationUnit, Environment, Transformation
from cfgplan.planners.networks.site import Site
from cfgplan.planners.networks.wiring import wire
from cfgplan.planning import Problem
from cfgplan.reasons import Givers, startable


def what_runs(problem: Problem) -> list[ComputationUnit] | None:
    """The running units that targets and pinned units need, rewired where they have to be; None if they are too few.

    They are valid where nothing is asked beyond the paper.
    """
    library = running_library(problem.environment)
    givers = Givers(library, problem.similarity)
    possible = startable(Environment((), library), givers)
    if not possible.issuperset(t.label for t in library if t.pinned):
        return None
    site = Site(problem, givers, possible)
    return wire(site, [i for i, candidate in enumerate(site.candidates) if candidate.running is not None])


def running_library(environment: Environment) -> tuple[Transformation, ...]:
    """The transformations that have a unit, in the library's order."""
    labels = {unit.transformation for unit in environment.units}
    return tuple(t for t in environment.library if t.label in labels)
