"""Explains a missing plan, and a required transformation that no plan uses."""

from __future__ import annotations

from dataclasses import dataclass, replace

from cfgplan.domain import Environment
from cfgplan.explaining.limits import Limit, in_the_way
from cfgplan.explaining.unfed import NearestOffers, Unreachable, unreachable
from cfgplan.explaining.what_if import only_targets, requiring, running
from cfgplan.planning import REFUSED, Plan, Planner, Problem, Status
from cfgplan.summary import Summary, counted, summarised, summary


@dataclass(frozen=True)
class DemandSet:
    """A subset of a problem's demands: targets, required and pinned transformations, by their labels."""

    targets: frozenset[str] = frozenset()
    required: frozenset[str] = frozenset()
    pinned: frozenset[str] = frozenset()

    @classmethod
    def of(cls, environment: Environment) -> DemandSet:
        """Return all demands of an environment; a pinned transformation is one if it has running units."""
        running = {unit.transformation for unit in environment.units}
        return cls(
            frozenset(target.label for target in environment.targets),
            frozenset(environment.required),
            frozenset(t.label for t in environment.library if t.pinned and t.label in running),
        )

    def each(self, environment: Environment) -> tuple[DemandSet, ...]:
        """Return single demands, the least important first: required, pinned, targets by priority."""
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
    """A minimal set of demands that can't be met together, although each target alone can be reached.

    They fail alone, with no other target, required or pinned transformation demanded; without any one of them a plan
    exists. If `demands` is empty, no configuration is valid at all. If the cheapest plan for them is known, it costs
    `cost_us`, more than `max_cost_us`; otherwise no valid configuration meets them at any cost. The `limits` that
    prevent a plan are minimal in the same way: no plan exists with all others lifted, but one does if any one of them
    is lifted too. `limits` is empty if they are not the reason.
    """

    demands: DemandSet
    cost_us: int | None = None
    max_cost_us: int | None = None
    limits: tuple[Limit, ...] = ()


def clash(problem: Problem, planner: Planner) -> Clash | None:
    """A minimal set of demands that can't be met together; None if the planner does not prove that there is one.

    The planner is called once for each demand, and some times for each limit in the way. A demand or limit that it
    can't decide stays in the set.
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
    if plan.status is Status.TOO_EXPENSIVE:
        return Clash(demands, plan.bound_us if plan.cost_us is None else plan.cost_us, problem.max_cost_us)
    asked = demanding(problem, demands)

    return Clash(demands, limits=in_the_way(asked, lambda freer: planner(freer).status in REFUSED))


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
    return problem.with_parts(library=library, targets=targets)


@dataclass(frozen=True)
class Unused:
    """A required transformation that a plan leaves unused.

    It is `blocked` if it can't run at all. Otherwise it can't be used together with the required transformations
    `excluded_by`; if that is empty, no wiring leads from it to a target. If that is not `proven`, no plan was found
    that uses it.
    """

    transformation: str
    blocked: Unreachable | None = None
    excluded_by: tuple[str, ...] = ()
    proven: bool = True


def _why_not_summary(why: WhyNot) -> Summary:
    rows = [("out of reach", each.target, f"nothing gives {each.wanted.tag}") for each in why.unreachable]
    if why.clash is not None:
        demands = why.clash.demands
        asked = (*demands.targets, *demands.required, *demands.pinned)
        rows.append(("not together", ", ".join(asked), ", ".join(map(str, why.clash.limits))))
    rows += [("not used", each.transformation, ", ".join(each.excluded_by)) for each in why.unused]
    return summary(f"{why.plan.status}; {counted(len(rows), 'reason')}", ("", "what", "why"), rows)


@summarised(_why_not_summary)
@dataclass(frozen=True)
class WhyNot:
    """The causes of unmet targets and unused required transformations.

    `unreachable` are the targets that nothing can give; `clash` is why the others can't be met together.
    """

    plan: Plan
    unreachable: tuple[Unreachable, ...] = ()
    clash: Clash | None = None
    unused: tuple[Unused, ...] = ()


def why_not(problem: Problem, planner: Planner, nearest: NearestOffers | None = None) -> WhyNot:
    """Return why no plan exists; if one exists, why it leaves required transformations unused."""
    plan = planner(problem)
    out_of_reach = unreachable(problem, nearest)
    lost = {reason.target for reason in out_of_reach}
    reachable = [target.label for target in problem.environment.targets if target.label not in lost]
    found = None
    if plan.status in REFUSED and (reachable or not lost):
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
