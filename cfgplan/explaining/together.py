"""Demands that can each be met, but not together: too dear, or they exclude each other."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

from cfgplan.domain import Environment
from cfgplan.planning import Plan, Planner, Problem, Status

REFUSED = (Status.INFEASIBLE, Status.TOO_EXPENSIVE)
"""The statuses by which a planner says: it is proven that there is no plan."""


@dataclass(frozen=True)
class DemandSet:
    """Some of what a problem demands: targets, required and pinned transformations, by their labels."""

    targets: frozenset[str] = frozenset()
    required: frozenset[str] = frozenset()
    pinned: frozenset[str] = frozenset()

    @classmethod
    def of(cls, environment: Environment) -> DemandSet:
        """All that an environment demands; of pinned transformations those that run."""
        running = {unit.transformation for unit in environment.units}
        return cls(
            frozenset(target.label for target in environment.targets),
            frozenset(environment.required),
            frozenset(t.label for t in environment.library if t.pinned and t.label in running),
        )

    def each(self, environment: Environment) -> tuple[DemandSet, ...]:
        """The single demands, those first that are easiest to let go: required, pinned, targets by priority."""
        targets = [target for target in environment.targets if target.label in self.targets]
        return (
            *(DemandSet(required=frozenset({label})) for label in sorted(self.required)),
            *(DemandSet(pinned=frozenset({label})) for label in sorted(self.pinned)),
            *(DemandSet(targets=frozenset({t.label})) for t in sorted(targets, key=lambda t: (t.priority, t.label))),
        )

    def without(self, other: DemandSet) -> DemandSet:
        return DemandSet(self.targets - other.targets, self.required - other.required, self.pinned - other.pinned)


@dataclass(frozen=True)
class Clash:
    """A minimal reason why there is no plan although each target can be reached: demands that can't be met together.

    They alone still fail: of the other targets, required and pinned transformations nothing is asked. Without any
    one of them there is a plan. If the cheapest plan for them is known, it costs `cost_us`, more than `max_cost_us`;
    otherwise no valid configuration meets them at any cost.
    """

    demands: DemandSet
    cost_us: int | None = None
    max_cost_us: int | None = None


def clash(problem: Problem, planner: Planner) -> Clash | None:
    """A minimal set of demands that can't be met together; None if the planner does not prove that there is one.

    The planner is called once for each demand. A demand that it can't decide stays in the set.
    """
    demands = DemandSet.of(problem.environment)
    plan = planner(problem)
    if plan.status not in REFUSED:
        return None
    for each in demands.each(problem.environment):
        less = demands.without(each)
        answer = planner(demanding(problem, less))
        if answer.status in REFUSED:
            demands, plan = less, answer
    return Clash(demands, _cheapest_us(plan), problem.max_cost_us if plan.status is Status.TOO_EXPENSIVE else None)


def demanding(problem: Problem, demands: DemandSet) -> Problem:
    """The problem with these of its demands alone."""
    environment = problem.environment
    library = tuple(
        replace(t, required=t.label in demands.required, pinned=t.label in demands.pinned)
        if t.required or t.pinned
        else t
        for t in environment.library
    )
    targets = tuple(target for target in environment.targets if target.label in demands.targets)
    return replace(problem, environment=replace(environment, library=library, targets=targets))


def _cheapest_us(plan: Plan) -> int | None:
    if plan.status is not Status.TOO_EXPENSIVE:
        return None
    return plan.bound_us if plan.cost_us is None else plan.cost_us


def only_targets(problem: Problem, labels: Collection[str]) -> Problem:
    """The problem with these of its targets; itself if these are all."""
    targets = tuple(target for target in problem.environment.targets if target.label in labels)
    if len(targets) == len(problem.environment.targets):
        return problem
    return replace(problem, environment=replace(problem.environment, targets=targets))
