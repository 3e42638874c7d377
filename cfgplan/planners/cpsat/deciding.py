"""Small problems are decided by a search of the planner's own, before anything is prepared for the solver.

Building a model and calling the solver takes longer there than looking at all that bounds leave.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from cfgplan.planners.cpsat.bounds import Bound
from cfgplan.planners.cpsat.branching import Branching
from cfgplan.planners.cpsat.chains import chained_bound
from cfgplan.planners.cpsat.clock import Clock
from cfgplan.planners.cpsat.core import Core, Ints
from cfgplan.planners.cpsat.greedy import first_plan, without_redundant
from cfgplan.planners.cpsat.network import Network
from cfgplan.planners.cpsat.prepared import Prepared
from cfgplan.planners.cpsat.site import Site
from cfgplan.planners.cpsat.standing import Standing
from cfgplan.planners.cpsat.structure import Structure
from cfgplan.planners.cpsat.weighing import Weighing
from cfgplan.planning import Problem, Progress

SMALL, FILTERED = 600, 120
"""So many labels a problem may have; with more than so many it pays to leave out those that are too dear by themselves.
"""
FIRST, STEPS, SOON = 300, 1500, 0.01
"""So many steps a search may take at first, and in all if so much of it is done by then."""


def decided(
    problem: Problem, structure: Structure, steps: int, clock: Clock, report: Callable[[Progress], None] | None
) -> Standing | None:
    """The best plan that is found in so many steps; where its cost is proven, but not that no other changes less, with
    all labels that such a plan could have: `is_complete`.

    None if the problem is not for such a search: a plan must be no more than its labels, without distinct and feedback
    inputs.
    """
    network = structure.network
    if not steps or network.special or len(network.labels) > SMALL:
        return None
    weighing = Weighing.with_changes(problem, network, structure.pinned)
    plan = None if weighing is None else first_plan(network, weighing.weight, 0, clock.is_over)
    if weighing is None or plan is None:
        return None
    limit, nodes = weighing.of_plan(_numbers(plan)), 0
    is_proven = weighing.least(chained_bound(network.core, weighing.weight)) >= limit
    if not is_proven:
        core, weight = _filtered(network.core, weighing, limit)
        search = Branching(core, weight, limit, weighing.step, clock.is_over)
        is_proven = search.run(min(steps, FIRST)) or (search.done >= SOON and search.run(max(0, steps - FIRST)))
        nodes = search.nodes
        structure.remember(search.bound, weighing.scale)
        if search.best is not None:
            plan = set(core.labels[sorted(search.best)].tolist()).union(network.pinned)
    plan = _lean(network, weighing.weight, plan)
    value = weighing.of_plan(_numbers(plan)) if is_proven else 0
    labels = [network.labels[i] for i in sorted(plan)]
    prepared = Prepared(
        labels,
        labels,
        bound_us=weighing.cost_us(value),
        counts={"nodes": nodes, "left by bounds": len(labels)},
        fewest_changes=weighing.changes(value),
        is_complete=False,
    )
    standing = Standing(Site(problem, structure.givers, labels), prepared, clock, report)
    if is_proven and standing.best is not None and not standing.is_over:
        limit = weighing.of_key(standing.best.key)
        core, weight = _filtered(network.core, weighing, limit)
        search = Branching(core, weight, limit, weighing.step, clock.is_over)
        others = search.others(np.flatnonzero(np.isin(core.labels, _numbers(plan))).tolist(), steps)
        if others is not None:
            plan |= set(core.labels[sorted(others)].tolist())
            labels = [network.labels[i] for i in sorted(plan)]
            counts = {**prepared.counts, "left by bounds": len(labels)}
            standing.go_on_with(replace(prepared, labels=labels, counts=counts, is_complete=True))
    clock.end("bounds")
    return standing


def _numbers(labels: set[int]) -> Ints:
    return np.array(sorted(labels), np.int64)


def _lean(network: Network, weight: Ints, plan: set[int]) -> set[int]:
    """The plan without what it can do without for nothing."""
    while not weight[_numbers(plan)].all():
        lean = without_redundant(network, weight, plan)
        if lean == plan:
            break
        plan = lean
    return plan


def _filtered(core: Core, weighing: Weighing, limit: int) -> tuple[Core, Ints]:
    """The part of a core that may be in a plan better than `limit`, if it is not small anyway, and its weights."""
    if core.goal <= FILTERED:
        return core, weighing.weight
    bound = Bound(core, weighing.weight)
    part = bound.restricted(bound.may_be_used(limit - weighing.step))
    return part.core, part.cost
