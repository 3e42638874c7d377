"""Looks for a cheaper plan: members are torn out at random, and the plan is repaired at perturbed prices.

Iterated local search (Lourenço, Martin and Stützle 2003): where repairs no longer pay, a plan made at perturbed prices
is the next start. The random numbers are seeded, so a run is repeatable.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from cfgplan.planners.networks.core import Floats, Ints
from cfgplan.planners.networks.greedy import FREE, cost_of, plan_at
from cfgplan.planners.networks.network import Graph
from cfgplan.planners.tuning import USUAL, Close


class Repairs:
    """The best plan found so far, a set of labels that meets the goal."""

    def __init__(self, network: Graph, cost: Ints, plan: set[int], tuning: Close = USUAL.close) -> None:
        self._tuning = tuning
        self.best = plan
        self._network = network
        self._cost = cost
        self._draw = np.random.default_rng(len(cost))
        self._plan: set[int] | None = None
        self._in_vain = 0

    def attempt(self, attempts: int, guide: Floats, is_over: Callable[[], bool]) -> None:
        """Try `attempts` random repairs or restarts.

        A label's price is drawn around `guide`; a forbidden label costs infinity.
        """
        for _ in range(attempts):
            if is_over():
                return
            price = guide * np.exp(self._draw.normal(0.0, self._tuning.noise, len(guide)))
            if self._plan is None:
                self._plan = plan_at(self._network, self._cost, price)
            else:
                self._repair(self._plan, price)
            if self._plan is not None and self._cost_of(self._plan) < self._cost_of(self.best):
                self.best = self._plan
            if self._in_vain >= self._tuning.in_vain:
                self._plan, self._in_vain = None, 0

    def _repair(self, plan: set[int], price: Floats) -> None:
        members = sorted(label for label in plan if self._cost[label])
        if not members:
            self._in_vain = self._tuning.in_vain
            return
        most = int(self._draw.integers(1, self._tuning.torn + 1))
        torn = self._draw.choice(members, size=min(most, len(members)), replace=False)
        price[list(plan)] = FREE
        price[torn] = np.inf
        other = plan_at(self._network, self._cost, price)
        if other is not None and self._cost_of(other) < self._cost_of(plan):
            self._plan, self._in_vain = other, 0
        else:
            self._in_vain += 1

    def _cost_of(self, plan: set[int]) -> int:
        return cost_of(self._cost, plan)
