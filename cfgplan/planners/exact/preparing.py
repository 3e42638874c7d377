"""What is known about a problem's costs before the solver is called, and between its attempts."""

from __future__ import annotations

from collections.abc import Collection
from functools import cached_property

import numpy as np

from cfgplan.planners.bounding.bounds import Bound, tightened
from cfgplan.planners.closing.gap import Closing
from cfgplan.planners.closing.separation import Separator
from cfgplan.planners.exact.prepared import Prepared
from cfgplan.planners.exact.rest import Left
from cfgplan.planners.exact.structure import Structure
from cfgplan.planners.networks.core import Ints
from cfgplan.planners.networks.greedy import FREE, plan_at
from cfgplan.planners.networks.network import Weighing
from cfgplan.planners.solving.clock import Clock
from cfgplan.planners.tuning import Close


class Preparation:
    """What the search is given: labels that may be used, a plan, a bound, landmarks. `go_on` brings them closer.

    Without `left`, `begin` has to be called first.
    """

    def __init__(
        self,
        structure: Structure,
        weighing: Weighing,
        plan: Ints | None,
        left: Left | None,
        tuning: Close,
    ) -> None:
        self._structure = structure
        self._weighing = weighing
        self._plan = plan
        self._left = left
        self._tuning = tuning
        self._closing: Closing | None = None

    def begin(self, bound: Bound, clock: Clock) -> None:
        """Raise the bound by landmarks, less long if closing may follow and there are no crowds.

        With crowds (distinct inputs) the labels that a good bound charges in full often make a cheaper plan.
        """
        weighing, plan = self._weighing, self._plan
        limit = int(weighing.weight.sum()) if plan is None else weighing.of_plan(plan)
        is_crowded = bound.core.crowds is not None
        greedily = plan is not None and not is_crowded
        bound = tightened(bound, limit - weighing.step + 1, limit, clock, greedily=greedily)
        if plan is not None and bound.value <= limit - weighing.step and is_crowded and not clock.is_over():
            self._plan = plan = self._at_what_is_left(bound, plan)
            limit = weighing.of_plan(plan)
        self._structure.remember(lambda: bound, weighing.scale)
        self._left = Left.by(bound, limit)
        is_open = plan is not None and weighing.least(bound.value) < limit
        if plan is not None and is_open and not clock.is_over():
            self._closing = Closing(self._structure.network, bound, weighing.weight, plan, weighing.step, clock.tuning)

    def _at_what_is_left(self, bound: Bound, plan: Ints) -> Ints:
        """The plan, or a cheaper one that is made at residual costs."""
        network, weight = self._structure.network, self._weighing.weight
        price = np.full(len(weight), np.inf)
        price[bound.core.labels] = bound.residual + FREE
        found = plan_at(network, weight, price)
        other = plan if found is None else np.array(sorted(found), np.int64)
        return min(plan, other, key=self._weighing.of_plan)

    @property
    def may_go_on(self) -> bool:
        """True while the bound is below the plan's cost and closing may help."""
        return self._closing is not None and not self._closing.is_closed

    def go_on(self, clock: Clock) -> None:
        """Bring bound and plan closer (`Closing.go_on`)."""
        assert self._closing is not None
        self._closing.go_on(clock)
        self._plan = self._closing.plan
        bound, limit = self._closing.bound, self._closing.limit
        self._left = Left.by(bound.restricted(bound.may_be_used(limit)), limit)

    def prepared(self, clock: Clock) -> Prepared:
        """What the search is given; after the time limit no labels but the plan's."""
        assert self._left is not None, "begin was called"
        network, weighing, plan, left = self._structure.network, self._weighing, self._plan, self._left
        value = weighing.least(left.value)
        labels = left.labels
        if plan is not None and value < weighing.of_plan(plan) and clock.is_over():
            labels = plan
        return Prepared(
            [network.labels[i] for i in labels.tolist()],
            None if plan is None else [network.labels[i] for i in plan.tolist()],
            None if plan is None else weighing.cost_us(weighing.of_plan(plan)),
            weighing.cost_us(value),
            lambda: left.landmarks(labels, network.labels),
            {"landmarks": left.known, "left by bounds": len(labels)},
            fewest_changes=weighing.changes(value),
        )

    def missed(self, labels: Collection[str], clock: Clock) -> list[tuple[list[str], int]]:
        """Landmarks that these labels do not hit; none if the labels are grounded and meet what is wanted."""
        network = self._structure.network
        uses = np.zeros(len(network.labels))
        uses[[network.number[label] for label in labels]] = 1.0
        found = self._separator.missed(uses, np.random.default_rng(len(labels)), is_over=clock.is_over)
        return [([network.labels[i] for i in one.counted.tolist()], one.least) for one in found]

    @cached_property
    def _separator(self) -> Separator:
        return Separator(self._structure.network.core, self._tuning)
