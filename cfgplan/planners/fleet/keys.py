"""How good a configuration of a fleet is, in the order of optimality."""

from __future__ import annotations

from collections.abc import Collection

from cfgplan.domain import ComputationUnit
from cfgplan.figures import cost_parts
from cfgplan.planners.networks.quality import Key, unused_required
from cfgplan.planning import Problem


def key_of(problem: Problem, units: Collection[ComputationUnit]) -> Key:
    """How good a configuration is; its cost has transfers, spares and missed quality in it."""
    changes = problem.environment.change_to(units)
    cost_us = cost_parts(problem, units).total_us
    return len(unused_required(problem, units)), cost_us, len(changes.rewired), len(changes.started)
