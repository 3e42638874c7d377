"""What a proven plan says about the plans after a small change.

At rest nothing is to be changed: the plan runs, and no other is cheaper. Let some units die: their costs
rise by their labor, all others stay. A plan that has all the dead ones rises as much as the plan at rest,
so that none of these beats starting them again; any other lacks one of them, and landmarks, charged from
where they stood at rest, mostly show that to be dearer.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cfgplan.planners.cpsat.bounds import Bound
from cfgplan.planners.cpsat.clock import Clock
from cfgplan.planners.cpsat.network import Ints
from cfgplan.planners.cpsat.rivals import is_without_rival
from cfgplan.planners.cpsat.tightening import tightened

MOST_DEAD = 4
"""With more dead units than this, a plan is made from the start."""


@dataclass(frozen=True)
class Left:
    """What bounds leave of a network: labels, a bound on cost, and landmarks.

    Of the labels of a landmark, of which those count twice that are in it twice, a plan has so many or more.
    """

    labels: Ints
    value: int
    landmarks: list[tuple[Ints, int]]

    @classmethod
    def by(cls, bound: Bound, limit: int) -> Left:
        """What may be in a plan that costs at most `limit`."""
        keep = bound.may_be_used(limit)
        labels = bound.core.labels
        return cls(labels[keep], bound.value, [(labels[one.counted], one.least) for one in bound.landmarks])


@dataclass(frozen=True)
class Rest:
    """A plan proven cheapest at some costs, and a bound there for all plans that cost at most `limit`.

    The plan holds labels of the network, in order; `rivals` are labels that any other plan as cheap has one of.
    """

    plan: Ints
    cost: Ints
    limit: int
    bound: Bound
    rivals: Ints

    @classmethod
    def of(cls, plan: Ints, cost: Ints, limit: int, bound: Bound, clock: Clock) -> Rest:
        """Look at a proven plan, its bound unrestricted, so that replanning can begin from it."""
        value = int(cost[plan].sum())
        bound = tightened(bound.restricted(bound.may_be_used(limit)), value, limit, clock)
        bound = bound.restricted(bound.may_be_used(limit))
        close = tightened(bound.restricted(bound.may_be_used(value)), value, value, clock)
        close = close.restricted(close.may_be_used(value))
        rivals = np.setdiff1d(close.core.labels, plan)
        if len(rivals) and is_without_rival(close, plan, value, clock.left_s()):
            rivals = rivals[:0]
        return cls(plan, cost, limit, bound, rivals)

    def is_below(self, cost: Ints) -> bool:
        """Whether nothing costs less than at rest."""
        return bool((cost >= self.cost).all())

    def left(self, cost: Ints, plan: Ints, clock: Clock) -> Left | None:
        """What may be in a plan as good as this one at these costs; None if they differ too much."""
        change = cost - self.cost
        limit = int(cost[plan].sum())
        risen = self.plan[change[self.plan] > 0]
        if not self.is_below(cost) or limit > self.limit or len(risen) > MOST_DEAD:
            return None
        lefts = [self._without(label, cost, limit, clock) for label in risen.tolist()]
        with_all = int(self.cost[self.plan].sum() + change[risen].sum())
        if with_all <= limit:
            lefts.append(Left(np.union1d(self.plan, self.rivals), with_all, []))
        return Left(
            np.unique(np.concatenate([one.labels for one in lefts])),
            min(one.value for one in lefts),
            lefts[0].landmarks if len(lefts) == 1 else Left.by(self.bound, self.limit).landmarks,
        )

    def _without(self, label: int, cost: Ints, limit: int, clock: Clock) -> Left:
        """What may be in a plan that lacks a label of the plan at rest and costs at most `limit`."""
        labels = self.bound.core.labels
        bound = self.bound.at(np.where(labels == label, np.maximum(limit + 1, cost[labels]), cost[labels]))
        bound = tightened(bound, limit + 1, limit, clock)
        return Left.by(bound, limit)
