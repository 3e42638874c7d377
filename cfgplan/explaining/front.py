"""The price of better quality: the cheapest configuration for each quality that a target's stream can have."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

from cfgplan.domain import Target
from cfgplan.figures import qualities_of_targets
from cfgplan.planning import REFUSED, Plan, Planner, Problem, Status, refuse_order
from cfgplan.qualities import Better, QualityAttribute, Wish
from cfgplan.summary import Summary, counted, cpu, summarised, summary


@dataclass(frozen=True)
class FrontPoint:
    """A plan that no other beats in both cost and quality; `value` is in micro-units of the attribute."""

    plan: Plan
    cost_us: int
    value: int


def _front_summary(front: Front) -> Summary:
    name = front.attribute.name
    line = f"{counted(len(front.points), 'plan')} for {front.target} that no other beats in cost and {name}"
    rows = ((cpu(point.cost_us), front.attribute.shown(point.value)) for point in front.points)
    return summary(line if front.complete else f"{line}; there may be more", ("cost", name), rows)


@summarised(_front_summary)
@dataclass(frozen=True)
class Front:
    """The cost-quality front of one target and attribute, from the cheapest plan to the best.

    Costs don't include the price of this attribute. `complete` says that no more points exist; if not, the clock or the
    limit of points stopped the search, and points of better quality are missing.
    """

    target: str
    attribute: QualityAttribute
    points: tuple[FrontPoint, ...]
    complete: bool


def front(
    problem: Problem,
    planner: Planner,
    target: str,
    attribute: str,
    *,
    most: int = 50,
    time_limit_s: float | None = None,
) -> Front:
    """Return the points that are not dominated, each by a call of the planner with a stricter bound on quality.

    The target's own bound and price of the attribute are ignored, its other wishes are kept.
    """
    refuse_order(problem, "fronts")
    end_s = None if time_limit_s is None else time.monotonic() + time_limit_s
    measure = problem.environment.quality[attribute]
    found: list[FrontPoint] = []
    bound: int | None = None
    complete = False
    while len(found) < most:
        asked = _asking(problem, target, attribute, bound)
        left_s = None if end_s is None else end_s - time.monotonic()
        if left_s is not None and left_s <= 0:
            break
        plan = planner(asked, time_limit_s=left_s)
        if plan.status in REFUSED:
            complete = True
            break
        if plan.status is not Status.OPTIMAL or plan.change_set is None or plan.cost_us is None:
            break
        after = asked.after(plan)
        value = qualities_of_targets(after, after.units)[target][attribute]
        found = [point for point in found if point.cost_us < plan.cost_us]
        found.append(FrontPoint(plan, plan.cost_us, value))
        if value == measure.best:
            complete = True
            break
        bound = value - 1 if measure.better is Better.LOWER else value + 1
    return Front(target, measure, tuple(found), complete)


def _asking(problem: Problem, label: str, attribute: str, bound: int | None) -> Problem:
    """Return the problem in which a target has this bound on an attribute, and no price for it."""

    def asks(target: Target) -> Target:
        if target.label != label:
            return target
        others = tuple(wish for wish in target.quality if wish.attribute != attribute)
        return replace(target, quality=others if bound is None else (*others, Wish(attribute, bound)))

    return problem.with_parts(targets=tuple(map(asks, problem.environment.targets)))
