"""How far the planner has come: the incumbent, the proven bound, what is being minimised.

Nothing here needs the constraint solver: where the first plan meets the bound it is never imported.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from cfgplan.domain import ComputationUnit
from cfgplan.planners.cpsat.prepared import Prepared
from cfgplan.planners.networks.quality import Key, key_of, unused_required
from cfgplan.planners.networks.site import Site
from cfgplan.planners.networks.wiring import forced_changes, wire
from cfgplan.planners.solving.clock import Clock
from cfgplan.planning import Plan, Progress, Status


class Stage(Enum):
    """What is being minimised."""

    REQUIRED = "unused required transformations"
    COST = "cost"
    CHANGES = "rewired and started units"
    COST_AND_CHANGES = "cost, then rewired and started units, in one sum"
    DONE = "nothing: all is proven"


@dataclass
class Incumbent:
    """The best plan so far."""

    key: Key
    units: list[ComputationUnit]


class Standing:
    """A site on its way to the optimum: the stage, the incumbent and the proven bound on the cost."""

    def __init__(self, site: Site, prepared: Prepared, clock: Clock, report: Callable[[Progress], None] | None) -> None:
        self.site = site
        self.clock = clock
        self.report = report
        self.stage = Stage.REQUIRED
        self.best: Incumbent | None = None
        self.bound_us = 0
        self.holds_for = prepared.holds_for
        self.fewest_changes = prepared.fewest_changes
        self.is_complete = prepared.is_complete
        self.fewest_unused = 0
        """No valid configuration leaves fewer required transformations unused."""
        self.reasons: dict[str, str] = {}
        """Why targets can't be met, whatever runs."""
        self.counts = {**prepared.counts}
        self.raise_bound(prepared.bound_us)
        if prepared.plan is not None:
            self.begin_with(prepared.plan)

    @property
    def is_over(self) -> bool:
        """Whether all is proven, or the time is over."""
        return self.stage is Stage.DONE or self.clock.is_over()

    def go_on_with(self, prepared: Prepared) -> None:
        """The same with what was found out in between: fewer candidates, a better plan, a higher bound."""
        self.site = self.site.among(prepared.labels)
        self.stage = Stage.REQUIRED
        self.fewest_changes = prepared.fewest_changes
        self.is_complete = prepared.is_complete
        self.counts |= prepared.counts
        if prepared.holds_for != self.holds_for:
            self.holds_for, self.bound_us = prepared.holds_for, 0
        self.raise_bound(prepared.bound_us)
        is_known = self.best is not None and self.best.key[1] == prepared.cost_us
        if prepared.plan is not None and not (is_known and self.clock.is_over()):
            self.begin_with(prepared.plan)

    def begin_with(self, labels: list[str]) -> None:
        """Take the first plan as the incumbent; where it meets the bound, all is done."""
        chosen = self.site.first_of_each(labels)
        units = wire(self.site, chosen)
        if units is not None:
            self.offer(units)
        if self.is_proven(chosen):
            self.stage = Stage.DONE

    def is_proven(self, chosen: set[int]) -> bool:
        """Whether the incumbent can't be beaten in changes, or is the only choice of units at its cost.

        No more must be rewired then than has to be. It is the only choice if it has all candidates and each costs
        something, or has to run: one that costs nothing might be done without.
        """
        if self.best is None:
            return False
        if self.fewest_changes is not None and self.best.key == (0, self.bound_us, *self.fewest_changes):
            return True
        return (
            self.is_complete
            and self.best.key[:2] == (0, self.bound_us)
            and len(chosen) == len(self.site.candidates) == len(self.best.units)
            and all(c.cost_us or self.site.is_kept_pinned(i) for i, c in enumerate(self.site.candidates))
            and self.best.key[2] == forced_changes(self.site, chosen)
        )

    def offer(self, units: list[ComputationUnit]) -> Key:
        """Take a plan as the incumbent if it is the best so far; returns its key."""
        key = key_of(self.site.problem, units)
        if self.best is None or key < self.best.key:
            self.best = Incumbent(key, units)
            self.clock.has_plan = True
            self.tell()
        return key

    def raise_bound(self, bound_us: int) -> None:
        if bound_us > self.bound_us:
            self.bound_us = bound_us
            self.tell()

    def tell(self) -> None:
        if self.report is not None:
            cost_us = self.best.key[1] if self.best else None
            self.report(Progress(self.clock.elapsed_s(), cost_us, self.bound_us if self.bound_holds() else 0))

    def bound_holds(self) -> bool:
        """Whether the bound is one for all plans that may be optimal."""
        return self.holds_for is None or (self.best is not None and self.best.key[0] <= self.holds_for)

    def plan(self) -> Plan:
        """The answer at the present stage."""
        problem, max_cost_us = self.site.problem, self.site.problem.max_cost_us
        bound_us = self.bound_us if self.bound_holds() else 0
        counts, seconds = self.counts, self.clock.seconds
        if self.reasons:
            return Plan("cpsat", Status.INFEASIBLE, reasons=self.reasons, seconds=seconds, counts=counts)
        proven = self.stage in (Stage.CHANGES, Stage.DONE)
        if max_cost_us is not None and bound_us > max_cost_us:
            cost_us = self.best.key[1] if self.best is not None and proven else None
            return Plan("cpsat", Status.TOO_EXPENSIVE, None, cost_us, bound_us, seconds=seconds, counts=counts)
        if self.best is None or (max_cost_us is not None and self.best.key[1] > max_cost_us):
            return Plan("cpsat", Status.UNKNOWN, bound_us=bound_us, seconds=seconds, counts=counts)
        return Plan(
            "cpsat",
            Status.of_plan(self.best.key[1], bound_us),
            problem.environment.change_to(self.best.units),
            self.best.key[1],
            bound_us,
            unused_required=unused_required(problem, self.best.units),
            ties_proven=self.stage is Stage.DONE,
            required_proven=self.best.key[0] <= self.fewest_unused,
            seconds=seconds,
            counts=counts,
        )
