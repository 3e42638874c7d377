"""The labels of a core in CP-SAT: each one that is used is fed, and so is the goal; only landmarks forbid cycles."""

from __future__ import annotations

from collections.abc import Iterable

from ortools.sat.python.cp_model import LinearExpr

from cfgplan.planners.bounding.landmarks import Landmark
from cfgplan.planners.networks.core import Core, Ints
from cfgplan.planners.solving.engine import ExactModel, at_least


class FedModel(ExactModel):
    """`uses` holds a boolean for each label of the core, and `cost` is their sum. The landmarks are the core's.

    A fact counts as offered if one provider is used, however many it takes, so a solution may be no plan.
    """

    def __init__(self, core: Core, cost: Ints, landmarks: Iterable[Landmark]) -> None:
        super().__init__()
        self.uses = [self.new_bool_var("") for _ in range(core.goal)]
        offered = [self.new_bool_var("") for _ in range(len(core.providers))]
        for fact in range(len(core.providers)):
            late = core.needed_by.lists[fact]
            first = [label for label in core.providers.lists[fact] if label not in late]
            self.add_bool_or([offered[fact].negated(), *(self.uses[label] for label in first)])
        for label, uses in enumerate(self.uses):
            for fact in core.needs.lists[label]:
                self.add_implication(uses, offered[fact])
        for fact in core.needs.lists[core.goal]:
            self.add_bool_or([offered[fact]])
        for landmark in landmarks:
            at_least(self, landmark.least, [self.uses[label] for label in landmark.counted.tolist()])
        self.cost = LinearExpr.weighted_sum(self.uses, cost.tolist())
