"""Why there is no plan, or why a required transformation is not used."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

from cfgplan.domain import OutputPort, Similarity, Target
from cfgplan.explaining.together import Clash, clash, only_targets
from cfgplan.explaining.unfed import NearestOffers, Unreachable, unreachable
from cfgplan.planning import Plan, Planner, Problem, Status

_USED = "\0used"


@dataclass(frozen=True)
class Unused:
    """A required transformation that a plan leaves unused.

    It is `blocked` if it can't run at all. Otherwise it can't be used together with the required transformations
    `excluded_by`; if there are none, no wiring leads from it to a target. If that is not `proven`, no plan was found
    that uses it.
    """

    transformation: str
    blocked: Unreachable | None = None
    excluded_by: tuple[str, ...] = ()
    proven: bool = True


@dataclass(frozen=True)
class WhyNot:
    """What keeps targets from being met and required transformations from being used.

    `unreachable` are the targets that nothing can give; `clash` is why the others can't be met together.
    """

    plan: Plan
    unreachable: tuple[Unreachable, ...] = ()
    clash: Clash | None = None
    unused: tuple[Unused, ...] = ()


def why_not(problem: Problem, planner: Planner, nearest: NearestOffers | None = None) -> WhyNot:
    """Why there is no plan; for a plan that there is, why it leaves required transformations unused."""
    plan = planner(problem)
    out_of_reach = unreachable(problem, nearest)
    lost = {reason.target for reason in out_of_reach}
    reachable = [target.label for target in problem.environment.targets if target.label not in lost]
    found = None
    if plan.status in (Status.INFEASIBLE, Status.TOO_EXPENSIVE) and reachable:
        found = clash(only_targets(problem, reachable), planner)
    unused = tuple(_unused(problem, planner, plan, label, nearest) for label in plan.unused_required)
    return WhyNot(plan, out_of_reach, found, unused)


def _unused(problem: Problem, planner: Planner, plan: Plan, label: str, nearest: NearestOffers | None) -> Unused:
    blocked = unreachable(running(problem, label), nearest)
    if blocked:
        return Unused(label, blocked[0])
    if not plan.required_proven:
        return Unused(label, proven=False)
    others = {*problem.environment.required} - {*plan.unused_required}
    for other in sorted(others):
        without = planner(requiring(problem, {label, *others} - {other}))
        if without.unused_required and without.required_proven:
            others.remove(other)
    return Unused(label, excluded_by=tuple(sorted(others)))


def running(problem: Problem, label: str) -> Problem:
    """The problem of a target that wants nothing but a unit of one transformation."""
    environment = problem.environment
    used = OutputPort(_USED, _USED)
    library = tuple(replace(t, outputs=(*t.outputs, used)) if t.label == label else t for t in environment.library)
    similarity = Similarity({**problem.similarity.offers, _USED: frozenset({_USED})}, problem.similarity.open)
    alone = replace(environment, units=(), library=library, targets=(Target(label, _USED, _USED),))
    return replace(problem, environment=alone, similarity=similarity)


def requiring(problem: Problem, labels: Collection[str]) -> Problem:
    """The problem in which just these transformations are required, whatever that costs."""
    environment = problem.environment
    library = tuple(
        replace(t, required=t.label in labels) if t.required != (t.label in labels) else t for t in environment.library
    )
    return replace(problem, environment=replace(environment, library=library), max_cost_us=None)
