"""A cheaper plan: members torn out of a plan at random, what is missing repaired at slightly wrong prices.

Iterated local search (Lourenço, Martin and Stützle 2003): where repairs no longer pay, a plan at wrong
prices is the next to begin with. Before, the best of all plans made of what the last few have is looked for
(optimized crossover: Aggarwal, Orlin and Tai 1997). Repeatable, since the random numbers are.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np

from cfgplan.planners.bounding.branching import Branching
from cfgplan.planners.networks.core import Floats, Ints
from cfgplan.planners.networks.greedy import FREE, cost_of, plan_at
from cfgplan.planners.networks.network import Graph

TORN = 3
"""At most so many members are torn out at a time."""
NOISE = 0.3
"""The standard deviation of the logarithm of a price."""
PATIENCE = 150
"""After so many repairs that did not pay, the search begins anew."""
CROSSED, STEPS = 5, 300
"""So many plans are crossed, in so many steps at most."""


class Repairs:
    """The best plan found so far, a set of labels that meets the goal."""

    def __init__(self, network: Graph, cost: Ints, plan: set[int]) -> None:
        self.best = plan
        self._network = network
        self._cost = cost
        self._draw = np.random.default_rng(len(cost))
        self._plan: set[int] | None = None
        self._in_vain = 0
        self._ends: deque[set[int]] = deque(maxlen=CROSSED - 1)

    def attempt(self, attempts: int, guide: Floats, is_over: Callable[[], bool]) -> None:
        """Repair or begin anew so many times, at prices around those of `guide`, infinite for what is not to be had."""
        for _ in range(attempts):
            if is_over():
                return
            price = guide * np.exp(self._draw.normal(0.0, NOISE, len(guide)))
            if self._plan is None:
                self._plan = plan_at(self._network, self._cost, price)
            else:
                self._repair(self._plan, price)
            if self._plan is not None and self._cost_of(self._plan) < self._cost_of(self.best):
                self.best = self._plan
            if self._plan is not None and self._in_vain >= PATIENCE:
                self._ends.append(self._plan)
                self._cross(is_over)
                self._plan, self._in_vain = None, 0

    def _repair(self, plan: set[int], price: Floats) -> None:
        members = sorted(label for label in plan if self._cost[label])
        if not members:
            self._in_vain = PATIENCE
            return
        torn = self._draw.choice(members, size=min(int(self._draw.integers(1, TORN + 1)), len(members)), replace=False)
        price[list(plan)] = FREE
        price[torn] = np.inf
        other = plan_at(self._network, self._cost, price)
        if other is not None and self._cost_of(other) < self._cost_of(plan):
            self._plan, self._in_vain = other, 0
        else:
            self._in_vain += 1

    def _cross(self, is_over: Callable[[], bool]) -> None:
        """Take the best plan that has no labels but those of the best one and of the last ones."""
        network = self._network
        if network.special or network.core.crowds is not None:
            return
        keep = np.zeros(len(self._cost), np.bool_)
        keep[list(self.best.union(*self._ends))] = True
        core, limit = network.core.restricted(keep), self._cost_of(self.best)
        search = Branching(core, self._cost[keep], limit, 1, is_over)
        search.run(STEPS)
        if search.best is not None:
            self.best = set(core.labels[sorted(search.best)].tolist()).union(network.pinned)

    def _cost_of(self, plan: set[int]) -> int:
        return cost_of(self._cost, plan)
