"""The state of the planner: the incumbent, the proven bound, and other proofs.

Nothing here needs the constraint solver: where the first plan meets the bound it is never imported.
"""

from __future__ import annotations

from functools import cache, partial
from typing import TYPE_CHECKING, NamedTuple

from cfgplan.domain import ComputationUnit, Objective
from cfgplan.planners.exact.candidates import Candidates
from cfgplan.planners.exact.rules import flaws
from cfgplan.planners.exact.wiring import in_order
from cfgplan.planners.networks.keys import Key, key_of, unused_required
from cfgplan.planners.solving.clock import Clock, ContradictionError
from cfgplan.planning import Feature, Measured, OnProgress, Plan, Problem, Progress, Status

if TYPE_CHECKING:
    import logging
    from collections.abc import Mapping


@cache
def _log() -> logging.Logger:
    """Return the log, which stays silent unless a program configures it; most plans write nothing there."""
    import logging

    log = logging.getLogger("cfgplan")
    log.addHandler(logging.NullHandler())
    return log


class Incumbent(NamedTuple):
    """The best plan so far."""

    key: Key
    units: list[ComputationUnit]


class SolveState:
    """The incumbent, and the proofs about the optimum."""

    def __init__(self, problem: Problem, clock: Clock, report: OnProgress | None, whole: Problem | None = None) -> None:
        """Reasons are given for the `whole` problem, from which this one was reduced."""
        self.problem = problem
        self._whole = problem if whole is None else whole
        self.clock = clock
        self.report = report
        self.best: Incumbent | None = None
        self.bound_us = 0
        self.bounds: dict[Objective, int] = {}
        """What is proven of objectives other than the cost, each of the plans as good in those before it."""
        self.holds_for: int | None = None
        """If given, the bound holds only for plans that leave no more required transformations unused than this."""
        self.is_infeasible = False
        self.reasons: Mapping[str, str] = {}
        """Why targets can't be met, whatever runs."""
        self.min_unused = 0
        """No valid configuration leaves fewer required transformations unused."""
        self.is_cost_proven = False
        self.are_ties_proven = False
        self.counts: dict[str, int] = {}

    @property
    def is_over(self) -> bool:
        """Whether all is proven, or the time is over."""
        return self.are_ties_proven or self.is_infeasible or self.clock.is_over()

    @property
    def is_at_bound(self) -> bool:
        """Whether the bound has reached the incumbent."""
        return self.best is not None and self.best.key.cost_us == self.bound_us

    @property
    def largest_us(self) -> int | None:
        """The largest cost that an optimal plan may have: the incumbent's.

        None if unknown: a plan that uses more required transformations, or is better in an order, may cost more.
        """
        if Feature.ORDER in self.problem.features:
            return None
        is_as_useful = self.best is not None and self.best.key.unused <= self.min_unused
        return self.best.key.cost_us if self.best is not None and is_as_useful else None

    @property
    def valid_bound_us(self) -> int:
        """The bound, if it is one for all plans that may be optimal, else 0."""
        holds = self.holds_for is None or (self.best is not None and self.best.key.unused <= self.holds_for)
        return self.bound_us if holds else 0

    def offer(self, candidates: Candidates, units: list[ComputationUnit]) -> Key | None:
        """Replace the incumbent if this configuration is valid and better.

        Returns its key; None if it is not valid: then it is counted, and nothing else happens.
        """
        flaw = next(flaws(candidates, units), None)
        if flaw is not None:
            self.counts["refused configurations"] = self.counts.get("refused configurations", 0) + 1
            _log().info("a configuration is refused: %s", flaw)
            return None
        key = key_of(self.problem, units)
        if self.best is None or key < self.best.key:
            self.best = Incumbent(key, units)
            most_us = self.problem.max_cost_us
            self.clock.has_plan = most_us is None or key.cost_us <= most_us
            self.tell()
        return key

    def prove_cost(self) -> None:
        """Note the proof that no plan is cheaper than the incumbent."""
        assert self.best is not None
        self.is_cost_proven = True
        self.raise_bound(self.best.key.cost_us)

    def prove_all(self) -> None:
        """Note the proof that no plan is better than the incumbent, in cost or in changes."""
        self.prove_cost()
        self.are_ties_proven = True

    def prove_infeasible(self) -> None:
        """Note the proof that no plan exists. Raises ContradictionError if one is known."""
        if self.best is not None:
            raise ContradictionError("no plan is said to be possible, but one is known")
        self.is_infeasible = True

    def begin_again(self, why: str) -> None:
        """Note that a search failed, and drop all proofs; the incumbent stays, since it is valid."""
        self.note_failure(why)
        self.bound_us, self.bounds, self.holds_for, self.min_unused = 0, {}, None, 0
        self.is_infeasible = self.is_cost_proven = self.are_ties_proven = False

    def note_failure(self, why: str) -> None:
        """Count a search that failed, and tell why in the log."""
        self.counts["failed searches"] = self.counts.get("failed searches", 0) + 1
        _log().warning("a search failed and is made again in the whole library: %s", why)

    def raise_bound(self, bound_us: int) -> None:
        if bound_us > self.bound_us:
            self.bound_us = bound_us
            self.tell()

    def raise_least_unused(self, number: int) -> None:
        """Note that each plan leaves at least so many required transformations unused."""
        self.min_unused = max(self.min_unused, number)

    def raise_bound_of(self, objective: Objective, bound: int) -> None:
        """Note a lower bound of an objective for plans that are as good in the objectives before it."""
        if objective is Objective.COST:
            self.raise_bound(bound)
        else:
            self.bounds[objective] = max(bound, self.bounds.get(objective, 0))

    def measured(self) -> tuple[Measured, ...]:
        """The objectives in the incumbent; empty where the cost alone is minimised."""
        bounds = {**self.bounds, Objective.COST: self.bound_us}
        named = self.problem.environment.minimise
        values = () if self.best is None else self.best.key.first[1:]
        return tuple(Measured(each, value, bounds.get(each, 0)) for each, value in zip(named, values, strict=False))

    def tell(self) -> None:
        if self.report is not None:
            cost_us = self.best.key.cost_us if self.best else None
            self.report(Progress(self.clock.elapsed_s(), cost_us, self.valid_bound_us))

    def plan(self) -> Plan:
        """The answer so far."""
        problem, bound_us = self.problem, self.valid_bound_us
        plan = partial(Plan, "cpsat", seconds=self.clock.seconds, counts=self.counts)
        if self.is_infeasible:
            from cfgplan.planners.exact.reasons import joint_reasons

            return plan(Status.INFEASIBLE, reasons=self.reasons or joint_reasons(self._whole))
        largest = problem.max_cost_us
        if largest is not None and bound_us > largest:
            cost_us = self.best.key.cost_us if self.best is not None and self.is_cost_proven else None
            return plan(Status.TOO_EXPENSIVE, None, cost_us, bound_us)
        if self.best is None or (largest is not None and self.best.key.cost_us > largest):
            return plan(Status.UNKNOWN, bound_us=bound_us)
        key, units = self.best
        objectives, is_required_proven = self.measured(), key.unused <= self.min_unused
        return plan(
            Status.of_plan(key.cost_us, bound_us, objectives, is_required_proven=is_required_proven),
            problem.environment.change_to([in_order(problem.environment, unit) for unit in units]),
            key.cost_us,
            bound_us,
            unused_required=unused_required(problem, units),
            ties_proven=self.are_ties_proven,
            required_proven=is_required_proven,
            objectives=objectives,
        )
