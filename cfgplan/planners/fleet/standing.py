"""How far the planner of fleets has come: the best plan, the proven bound."""

from __future__ import annotations

from collections.abc import Callable

from cfgplan.domain import ComputationUnit
from cfgplan.planners.fleet.keys import key_of
from cfgplan.planners.fleet.reasons import joint_reasons
from cfgplan.planners.networks.quality import Key, unused_required
from cfgplan.planners.solving.clock import Clock, ContradictionError
from cfgplan.planning import Plan, Problem, Progress, Status


class Standing:
    """The best plan so far, and what is proven about the optimum."""

    def __init__(self, problem: Problem, clock: Clock, report: Callable[[Progress], None] | None) -> None:
        self.problem = problem
        self.clock = clock
        self.report = report
        self.best: tuple[Key, list[ComputationUnit]] | None = None
        self.bound_us = 0
        self.is_infeasible = False
        self.reasons: dict[str, str] = {}
        """Why targets can't be met, whatever runs."""
        self.fewest_unused = 0
        """No valid configuration leaves fewer required transformations unused."""
        self.is_cost_proven = False
        self.are_ties_proven = False
        self.counts: dict[str, int] = {}

    @property
    def is_at_bound(self) -> bool:
        """Whether the bound has reached the best plan."""
        return self.best is not None and self.best[0][1] == self.bound_us

    def offer(self, units: list[ComputationUnit]) -> Key:
        """Take a configuration as the best plan if it is; returns its key."""
        key = key_of(self.problem, units)
        if self.best is None or key < self.best[0]:
            self.best = (key, units)
            self.clock.has_plan = True
            self.tell()
        return key

    def prove_cost(self) -> None:
        """No plan is cheaper than the best one."""
        assert self.best is not None
        self.is_cost_proven = True
        self.raise_bound(self.best[0][1])

    def prove_infeasible(self) -> None:
        """There is no plan. Raises ContradictionError if there is one."""
        if self.best is not None:
            raise ContradictionError("no plan is said to be possible, but one is known")
        self.is_infeasible = True

    def raise_bound(self, bound_us: int) -> None:
        if bound_us > self.bound_us:
            self.bound_us = bound_us
            self.tell()

    def tell(self) -> None:
        if self.report is not None:
            cost_us = self.best[0][1] if self.best else None
            self.report(Progress(self.clock.elapsed_s(), cost_us, self.bound_us))

    def plan(self) -> Plan:
        """The answer so far."""
        problem, counts, seconds = self.problem, self.counts, self.clock.seconds
        if self.is_infeasible:
            reasons = self.reasons or joint_reasons(problem)
            return Plan("cpsat", Status.INFEASIBLE, reasons=reasons, seconds=seconds, counts=counts)
        largest = problem.max_cost_us
        if largest is not None and self.bound_us > largest:
            cost_us = self.best[0][1] if self.best is not None and self.is_cost_proven else None
            return Plan("cpsat", Status.TOO_EXPENSIVE, None, cost_us, self.bound_us, seconds=seconds, counts=counts)
        if self.best is None or (largest is not None and self.best[0][1] > largest):
            return Plan("cpsat", Status.UNKNOWN, bound_us=self.bound_us, seconds=seconds, counts=counts)
        key, units = self.best
        return Plan(
            "cpsat",
            Status.of_plan(key[1], self.bound_us),
            problem.environment.change_to(units),
            key[1],
            self.bound_us,
            unused_required=unused_required(problem, units),
            ties_proven=self.are_ties_proven,
            required_proven=key[0] <= self.fewest_unused,
            seconds=seconds,
            counts=counts,
        )
