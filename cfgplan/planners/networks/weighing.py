"""What a label weighs where plans are compared: its cost and, beyond that, the change that it means.

Of plans that cost the same the one with fewer rewired units is better, then that with fewer started ones. All is added
up, so that a bound on the sum may prove a plan the best in all of it.
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
    """`weight` of each label of a network: `scale` for a microsecond.

    If `scale` exceeds 1 there is 1 for a start beside it, and `rewiring` for a rewiring that can't be avoided. What
    pinned labels cost whatever is planned is left out: `fixed_us`.
    """

    weight: Ints
    scale: int
    rewiring: int
    fixed_us: int

    @classmethod
    def of(cls, problem: Problem, network: Network, pinned: Collection[str]) -> Weighing:
        """Cost and, where nothing runs, starts; see `costs`. Of labels in `pinned` all running units are kept."""
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
        """Cost, rewirings and starts; None if the sum would be too large. Of a pinned label no change is counted."""
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
        """What the weight of every plan is a multiple of."""
        return max(1, int(np.gcd.reduce(self.weight)))

    def of_plan(self, labels: Ints) -> int:
        return int(self.weight[labels].sum())

    def least(self, bound: int) -> int:
        """The least weight not below a bound that a plan can have."""
        return -(-bound // self.step) * self.step

    def cost_us(self, weight: int) -> int:
        """The cost in a weight, with what is fixed; of a bound on weight a bound on cost."""
        return weight // self.scale + self.fixed_us

    def of_key(self, key: Key) -> int:
        """The weight of a plan by its cost and what it really changes."""
        return (key.cost_us - self.fixed_us) * self.scale + key.rewired * self.rewiring + key.started

    def changes(self, weight: int) -> tuple[int, int] | None:
        """The rewired and the started units in a weight, if they count."""
        return divmod(weight % self.scale, self.rewiring) if self.counts_starts else None
