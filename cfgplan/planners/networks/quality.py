"""How good a wiring is, in the order of optimality (Definition 10 and its ties)."""

from __future__ import annotations

from collections.abc import Collection

from cfgplan.costs import keep_cost_us, start_cost_us
from cfgplan.domain import ComputationUnit
from cfgplan.planning import Problem

Key = tuple[int, int, int, int]
"""Unused required transformations, cost in microseconds, rewired and started units: the order of optimality."""


def key_of(problem: Problem, units: list[ComputationUnit]) -> Key:
    """How good a wiring is, in the order of optimality."""
    changes = problem.environment.change_to(units)
    library = problem.environment.transformation
    cost_us = sum(
        (keep_cost_us if unit.id in problem.environment.unit else start_cost_us)(
            library[unit.transformation], problem.horizon_s
        )
        for unit in units
    )
    return len(unused_required(problem, units)), cost_us, len(changes.rewired), len(changes.started)


def unused_required(problem: Problem, units: Collection[ComputationUnit]) -> tuple[str, ...]:
    """The labels of the required transformations without a unit that serves a target."""
    by_id = {unit.id: unit for unit in units}
    ahead = [unit.id for unit in units if unit.publications]
    serving = set(ahead)
    for unit_id in ahead:
        new = {s.stream.unit for s in by_id[unit_id].subscriptions} - serving
        serving |= new
        ahead += sorted(new)
    used = {by_id[unit_id].transformation for unit_id in serving}
    return tuple(label for label in problem.environment.required if label not in used)
