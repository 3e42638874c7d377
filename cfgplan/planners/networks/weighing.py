"""The weight of a label where plans are compared: its cost and, beyond that, the change that it means.

Of plans that cost the same the one with fewer rewired units is better, then the one with fewer started units. Cost and
changes are one sum, so that a bound on it may prove a plan best in all of them.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from cfgplan.planners.networks.core import NEVER, Ints
from cfgplan.planners.networks.keys import Key, may_stay
from cfgplan.planners.networks.network import Network, costs
from cfgplan.planning import Problem


@dataclass(frozen=True)
class Weighing:
    """The `weight` of each label of a network: `scale` for a microsecond of cost.

    If `scale` exceeds 1, a start adds 1 and a rewiring that can't be avoided adds `rewiring`. The fixed cost of pinned
    labels is left out: `fixed_us`.
    """

    weight: Ints
    scale: int
    rewiring: int
    fixed_us: int

    @classmethod
    def of(cls, problem: Problem, network: Network, pinned: Collection[str]) -> Weighing:
        """Weigh cost and, where nothing runs, starts. For `pinned` see `costs`."""
        fixed_us, cost = costs(problem, network, pinned)
        scale = len(cost) + 1
        if (
            any(unit.transformation in network.number for unit in problem.environment.units)
            or int(cost.sum()) * scale >= NEVER // 4
        ):
            return cls(cost, 1, 1, fixed_us)
        return cls(cost * scale + 1, scale, scale, fixed_us)

    @classmethod
    def with_changes(cls, problem: Problem, network: Network, pinned: Collection[str]) -> Weighing | None:
        """Weigh cost, rewirings and starts; None if the sum would be too large. No change of a pinned label counts."""
        fixed_us, cost = costs(problem, network, pinned)
        rewiring = len(cost) + 1
        scale = rewiring**2
        if int(cost.sum()) * scale >= NEVER // 4:
            return None
        library = problem.environment.transformation  # the network may be older than costs are
        change = np.ones(len(cost), np.int64)
        staying: dict[int, bool] = {}
        for unit in problem.environment.units:
            label = network.number.get(unit.transformation)
            if label is not None:
                staying[label] = staying.get(label, False) or may_stay(problem, network.number, unit)
        for label, may in staying.items():
            can_be_started = library[network.labels[label]].labor_us == 0
            change[label] = 0 if may else 1 if can_be_started else rewiring
        change[[network.number[label] for label in pinned if label in network.number]] = 0
        return cls(cost * scale + change, scale, rewiring, fixed_us)

    @property
    def counts_starts(self) -> bool:
        return self.scale > 1

    @cached_property
    def step(self) -> int:
        """Every plan's weight is a multiple of this."""
        return max(1, int(np.gcd.reduce(self.weight)))

    def of_plan(self, labels: Ints) -> int:
        return int(self.weight[labels].sum())

    def least(self, bound: int) -> int:
        """The least weight that a plan can have: the bound rounded up to a multiple of `step`."""
        return -(-bound // self.step) * self.step

    def cost_us(self, weight: int) -> int:
        """The cost in a weight, `fixed_us` included. A bound on the weight gives a bound on the cost."""
        return weight // self.scale + self.fixed_us

    def of_key(self, key: Key) -> int:
        """The weight of a plan with this key: its cost and what it really changes."""
        return (key.cost_us - self.fixed_us) * self.scale + key.rewired * self.rewiring + key.started

    def changes(self, weight: int) -> tuple[int, int] | None:
        """The rewired and the started units in a weight; None if they don't count."""
        return divmod(weight % self.scale, self.rewiring) if self.counts_starts else None
