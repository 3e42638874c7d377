"""Whether a plan is the only one at its cost, asked of the solver over labels alone."""

from __future__ import annotations

import numpy as np

from cfgplan.planners.bounding.bounds import Bound
from cfgplan.planners.networks.core import Ints
from cfgplan.planners.solving.clock import Clock


def is_without_rival(bound: Bound, plan: Ints, limit: int, clock: Clock) -> bool:
    """True if it is proven that all plans of the bound's core within `limit` use labels of `plan` only.

    Only landmarks stand for groundedness, so False may be wrong.
    """
    from ortools.sat.python.cp_model import INFEASIBLE, CpModel

    from cfgplan.planners.solving.engine import at_least, repeatable_solver

    core, model = bound.core, CpModel()
    uses = [model.new_bool_var("") for _ in range(core.goal)]
    offered = [model.new_bool_var("") for _ in range(len(core.givers))]
    for fact in range(len(core.givers)):
        first = np.setdiff1d(core.givers[fact], core.needed_by[fact]).tolist()
        model.add_bool_or([offered[fact].negated(), *(uses[label] for label in first)])
    for label in range(core.goal):
        for fact in core.needs[label].tolist():
            model.add_implication(uses[label], offered[fact])
    for fact in core.needs[core.goal].tolist():
        model.add_bool_or([offered[fact]])
    for landmark in bound.landmarks:
        at_least(model, landmark.least, [uses[label] for label in landmark.counted.tolist()])
    model.add_bool_or([uses[i] for i in np.flatnonzero(~np.isin(core.labels, plan)).tolist()])
    model.add(sum(int(cost) * use for cost, use in zip(bound.cost, uses, strict=True)) <= limit)
    left_s, longest_s = clock.left_s(), clock.tuning.rest.rival
    longest_s = longest_s if left_s is None else min(longest_s, left_s)
    return repeatable_solver(small=core.goal < 1000, time_limit_s=longest_s).solve(model) == INFEASIBLE
