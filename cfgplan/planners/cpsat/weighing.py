"""What a label weighs where plans are compared: its cost and, where nothing runs, the unit to be started.

Of plans that cost the same the one with fewer started units is better, if none can be rewired. Both are added
up, so that a bound on the sum may prove a plan the best in both.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from cfgplan.planners.cpsat.network import NEVER, Ints, Network, costs
from cfgplan.planning import Problem


@dataclass(frozen=True)
class Weighing:
    """`weight` of each label of a network: `scale` for a microsecond, and 1 for a start if that exceeds 1.

    What pinned labels cost whatever is planned is left out: `fixed_us`.
    """

    weight: Ints
    scale: int
    fixed_us: int

    @classmethod
    def of(cls, problem: Problem, network: Network, pinned: Collection[str]) -> Weighing:
        """See `costs`; `pinned` are labels of which all running units are kept."""
        fixed_us, cost = costs(problem, network, pinned)
        scale = len(cost) + 1
        if (
            any(unit.transformation in network.number for unit in problem.environment.units)
            or int(cost.sum()) * scale >= NEVER // 4
        ):
            return cls(cost, 1, fixed_us)
        return cls(cost * scale + 1, scale, fixed_us)

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

    def started(self, weight: int) -> int | None:
        """The started units in a weight, if they count."""
        return weight % self.scale if self.counts_starts else None
