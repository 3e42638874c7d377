"""The planning problem, its answer, and what a planner is (Definition 10)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Protocol

from cfgplan.costs import LARGEST_COST_US, start_cost_us
from cfgplan.domain import ChangeSet, Environment, Similarity
from cfgplan.errors import InvalidValueError


@dataclass(frozen=True)
class Problem:
    """Find the optimal update of `environment` over `horizon_s` seconds, at most `max_cost_us` dear.

    Raises InvalidValueError if costs could add up to more than can be computed exactly.
    """

    environment: Environment
    similarity: Similarity
    horizon_s: int
    max_cost_us: int | None = None

    def __post_init__(self) -> None:
        if self.horizon_s < 0:
            raise InvalidValueError(f"the horizon is {self.horizon_s} seconds, but must be at least 0")
        if self.max_cost_us is not None and self.max_cost_us < 0:
            raise InvalidValueError("the largest cost allowed is negative")
        library = self.environment.transformation
        labels = [*library, *(u.transformation for u in self.environment.units if u.transformation in library)]
        if sum(start_cost_us(library[label], self.horizon_s) for label in labels) > LARGEST_COST_US:
            raise InvalidValueError(
                "the costs add up to more than can be computed exactly: shorten the horizon or lower the costs"
            )


class Status(StrEnum):
    """How a planner ended."""

    OPTIMAL = "optimal"
    """The plan is proven cheapest, ties broken by fewest rewired, then fewest started units."""
    FEASIBLE = "feasible"
    """There is a plan, not proven cheapest."""
    INFEASIBLE = "infeasible"
    """Proven: no update meets every target."""
    TOO_EXPENSIVE = "too expensive"
    """Proven: every update that meets every target costs more than the problem allows."""
    UNKNOWN = "unknown"
    """Stopped without a plan and without a proof that there is none."""


@dataclass(frozen=True)
class Plan:
    """A planner's answer.

    `change_set` is there exactly when the status is optimal or feasible. `cost_us` is the cost of
    the update (Definition 8) or, when too expensive, that of the cheapest update if it is known;
    `bound_us` is proven: no update is cheaper. `reasons` says for each target that can't be met why. `unused_required`
    names the required transformations that could not be used. `seconds` is the wall time of each
    phase; `counts` are the planner's own figures (nodes, conflicts, rounds).
    """

    planner: str
    status: Status
    change_set: ChangeSet | None = None
    cost_us: int | None = None
    bound_us: int = 0
    reasons: Mapping[str, str] = field(default_factory=dict, hash=False)
    unused_required: tuple[str, ...] = ()
    seconds: Mapping[str, float] = field(default_factory=dict, compare=False)
    counts: Mapping[str, int] = field(default_factory=dict, compare=False)

    @property
    def gap(self) -> float | None:
        """How far the cost may be above the optimum, as a share of the cost; None without a cost."""
        if self.cost_us is None:
            return None
        return (self.cost_us - self.bound_us) / self.cost_us if self.cost_us else 0.0


@dataclass(frozen=True, slots=True)
class Progress:
    """A planner's state while it works: the best cost so far, if any, and the proven bound."""

    elapsed_s: float
    cost_us: int | None
    bound_us: int


class Planner(Protocol):
    """A function of a problem. `report` is called whenever the best cost or the bound improves."""

    def __call__(
        self,
        problem: Problem,
        *,
        time_limit_s: float | None = None,
        report: Callable[[Progress], None] | None = None,
    ) -> Plan: ...


def fresh_unit_ids(environment: Environment, labels: list[str]) -> dict[str, str]:
    """An id for one new unit of each label: `label.N` with the least N that nothing runs or refers to."""
    taken = {unit.id for unit in environment.units}
    taken.update(s.stream.unit for unit in environment.units for s in unit.subscriptions)
    return {label: _free_id(label, taken) for label in labels}


def _free_id(label: str, taken: set[str]) -> str:
    number = 1
    while f"{label}.{number}" in taken:
        number += 1
    taken.add(f"{label}.{number}")
    return f"{label}.{number}"
