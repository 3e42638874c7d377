"""A rule of validity as the planner keeps it: in the model, in checks of plans, and while units are placed."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from cfgplan.domain import Environment, Host
from cfgplan.planners.exact.checked_units import CheckedUnits
from cfgplan.planners.exact.host_loads import Lacks
from cfgplan.planning import Feature, Problem

if TYPE_CHECKING:
    from cfgplan.planners.exact.model import Model  # the solver takes long to import


@dataclass(frozen=True)
class Rule:
    """A rule, which holds for problems with the `feature`, or for all if that is None.

    `add` adds it to the constraint model; None if the search cuts off what breaks it. It has to hold for groups of
    units and kinds of hosts (`Candidates.alike`). `flaws` yields, as text, where units break the rule. A rule about
    units on hosts says instead what a host `lacks` for one more unit, beside those that are placed already: first plans
    heed it, checks follow from it, and explanations quote it.

    Hosts are interchangeable only if they have the same `trait`. A rule that `is_placed` holds whatever the wiring. By
    one that `keeps_units`, units may run that feed nobody and meet no target.
    """

    add: Callable[[Model], None] | None
    feature: Feature | None = None
    flaws: Callable[[CheckedUnits], Iterator[str]] | None = None
    lacks: Lacks | None = None
    trait: Callable[[Environment, Host], Hashable] | None = None
    is_placed: bool = False
    keeps_units: bool = False

    def __call__(self, model: Model) -> None:
        """Add the rule to a model, if its problem asks for it."""
        if self.add is not None and self.is_asked(model.problem):
            self.add(model)

    def is_asked(self, problem: Problem) -> bool:
        """Whether a problem asks for it."""
        return self.feature is None or self.feature in problem.features
