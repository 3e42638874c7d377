"""What `cfgplan run` would start first, without starting anything."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import TYPE_CHECKING

from cfgplan.cli.exits import OF_STATUS, Exit
from cfgplan.cli.screen import Screen
from cfgplan.planning import Decider, Problem

if TYPE_CHECKING:
    from cfgplan_runtime.operating.operation import Settings

    from cfgplan.explaining.best_effort import BestEffort


def first_update(problem: Problem, settings: Settings, decider: Decider) -> BestEffort:
    """What the first review of a run would decide, by the costs that are known by now."""
    from cfgplan_runtime.estimating.estimator import make_estimator
    from cfgplan_runtime.estimating.keeping import load

    from cfgplan.explaining.best_effort import best_effort
    from cfgplan.planners import PLANNERS
    from cfgplan.planners.undecided import Deciding

    estimator = make_estimator(settings.estimator, settings.guess)
    if settings.estimates is not None:
        load(estimator, settings.estimates, time.monotonic())
    environment = problem.environment
    library = estimator.estimated(environment.library, problem.horizon_s)
    estimated = replace(problem, environment=replace(environment, library=tuple(library)))
    deciding = Deciding(settings.planner or PLANNERS["cpsat"], decider)
    found = best_effort(estimated, deciding, time_limit_s=settings.policy.time_limit_s)
    return replace(found, problem=deciding.known(found.problem))


def exit_of(found: BestEffort) -> Exit:
    """The exit code: as of `solve --best-effort`."""
    code = OF_STATUS[found.plan.status]
    if code is Exit.OK and not found.exact:
        return Exit.NOT_PROVEN
    return Exit.UNMET if found.unmet and code is Exit.OK else code


def show(found: BestEffort, digest: str, screen: Screen) -> None:
    """Print it; as JSON it is a plan file."""
    if screen.json:
        from cfgplan.formats import dump_plan

        screen.write(dump_plan(found.plan, found.problem, digest))
    else:
        from cfgplan.cli.update_text import update_text

        screen.show(update_text(found.problem, found.plan, found.given_up))
