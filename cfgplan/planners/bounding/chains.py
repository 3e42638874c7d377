"""A quick lower bound: the dearest chains that can't be avoided, each charged as a whole.

h_max of a fact is a sum of landmarks, one for each level up to it. The zone of a level holds the facts at or above it
from which the fact comes by the dearest needs. All of them are charged at once, and another chain is charged from what
they leave of the labels' costs. Where few labels need more than one fact at a time this meets the optimum after a few
rounds; elsewhere single landmarks are better (`bounds`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from cfgplan.planners.bounding.bounds import cheapest_way
from cfgplan.planners.networks.core import NEVER, Core, Ints


def chained_bound(core: Core, cost: Ints, certain: Sequence[int], is_over: Callable[[], bool]) -> int:
    """A lower bound on a plan's cost: the labels that are `certain` to run, plus chains until the time is over."""
    residual, value = cost.copy(), int(cost[certain].sum())
    residual[certain] = 0
    wanted = core.needs[core.goal]
    facts, before = cheapest_way(core, residual)
    while len(wanted):
        end = int(wanted[np.argmax(facts[wanted])])
        level = int(facts[end])
        value = min(value + level, int(NEVER))
        if level == 0 or value == NEVER or is_over():
            break
        charges = _charges(core, facts, before, end)
        # With crowds, the cheaper givers of a fact would be charged more than they have left.
        residual -= charges if core.crowds is None else np.minimum(charges, residual)
        facts, before = cheapest_way(core, residual, facts)
    return value


def _charges(core: Core, facts: Ints, before: Ints, end: int) -> Ints:
    """The charge on each label by the landmarks of a chain: from the level of its needs to the level it enters."""
    labels, dearest = core.needs_with(facts, before)
    level = np.zeros_like(facts)
    level[end] = facts[end]
    while True:
        entered = core.most_of_gifts(level)
        higher = level.copy()
        np.maximum.at(higher, dearest, np.minimum(entered, before)[labels])
        if (higher == level).all():
            charges: Ints = np.maximum(entered - before, 0)[:-1]
            return charges
        level = higher
