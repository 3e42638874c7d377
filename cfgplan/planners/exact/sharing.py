"""A model of wiring alone: can given units be rewired to meet the targets although outputs limit their consumers?

Outputs with a limit on consumers, and inputs that take all streams, make the choice of units and wires matter.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Final

from ortools.sat.python.cp_model import FEASIBLE, INFEASIBLE, OPTIMAL

from cfgplan.planners.exact import company, idle_inputs, inputs, targets, units
from cfgplan.planners.exact.candidates import Candidates
from cfgplan.planners.exact.model import Model, ModelRule
from cfgplan.planners.solving.clock import OutOfTimeError
from cfgplan.planners.solving.engine import repeatable_solver, solve

_WIRED: Final[tuple[ModelRule, ...]] = (
    *units.STATES,
    *inputs.FEEDING,
    *targets.MET,
    idle_inputs.a_stream_serves_no_more_than_it_may,
    company.companions_run_beside_a_running_unit,
)


def can_share(candidates: Candidates) -> bool:
    """Whether some of the units can be wired to meet all targets. Raises OutOfTimeError by the candidates' clock."""
    model = Model(candidates, _WIRED, is_apart=True, orders_rings=True)
    for i, (one, following) in enumerate(pairwise(candidates.all)):
        if (one.transformation.label, one.hosts) == (following.transformation.label, following.hosts):
            model.cp.add_implication(model.runs[i + 1], model.runs[i])
    solver = repeatable_solver(small=True, tiny=True, time_limit_s=candidates.clock.left_s())
    status = solve(solver, model.cp, candidates.clock)
    if status not in (OPTIMAL, FEASIBLE, INFEASIBLE):
        raise OutOfTimeError
    return status != INFEASIBLE
