"""Best effort: if not all targets can be met, an optimal set of the most important ones."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

from cfgplan.costs import seconds
from cfgplan.domain import Target
from cfgplan.explaining.what_if import only_targets
from cfgplan.planning import REFUSED, Feature, Pair, Plan, Planner, Problem, Status
from cfgplan.reasons import unmet_reasons, with_pinned_reasons
from cfgplan.summary import Summary, counted, summarised, summary
from cfgplan.unmet import Lack, Reason


def _best_effort_summary(found: BestEffort) -> Summary:
    given_up = counted(len(found.given_up), "target")
    proven = "" if found.exact else ", which is not proven"
    return summary(f"{given_up} given up{proven}; {found.plan!r}", ("given up", "why"), sorted(found.given_up.items()))


@summarised(_best_effort_summary)
@dataclass(frozen=True)
class BestEffort:
    """The best update that some of the targets allow.

    `problem` is the problem that was asked with only the targets that are met, and `plan` its plan. `given_up` says why
    each of the other targets is given up, by label; the plan's `reasons` have it too. `exact` tells whether
    it is proven that no better set of targets can be met; `undecided` are the open pairs of tags that this, or the
    bound of the plan, hangs on. The plan has no change set only if it was stopped too early, or if not even the pinned
    units can be kept at the largest cost.
    """

    plan: Plan
    problem: Problem
    given_up: Mapping[str, Reason] = field(hash=False)
    exact: bool = True
    undecided: tuple[Pair, ...] = ()

    @property
    def unmet(self) -> tuple[str, ...]:
        """The labels of the targets that are given up."""
        return tuple(sorted(self.given_up))


def best_effort(
    problem: Problem,
    planner: Planner,
    *,
    time_limit_s: float | None = None,
    impossible: Mapping[str, Reason] | None = None,
) -> BestEffort:
    """Meet as many targets of the highest priority as possible, then of the next ..., then at least cost.

    A set of targets can be met if `planner` finds a plan for the problem with these targets alone. Among equally good
    sets the one with the best plan in the usual order wins (required, cost, rewired, started), then the first one. If
    only missing matches prevent targets, this takes one call of the planner, on a problem that changes only with the
    targets that can be met: a `PlannerSession` stays warm. A largest cost that is too small takes a search over sets of
    targets, in the worst case all of them.

    `impossible` are the `reasons.unmet_reasons` of the problem, if they are known already; they depend on library,
    matching and targets alone.
    """
    impossible = dict(unmet_reasons(problem) if impossible is None else impossible)
    search = _Search(problem, [t for t in problem.environment.targets if t.label not in impossible], planner)
    if time_limit_s is not None:
        search.end_s = time.monotonic() + time_limit_s
    search.run()
    if search.is_over:
        search.consider_running_units()
    plan, given_up = search.best_plan(), impossible | search.why_given_up()
    reasons = given_up if plan.change_set is None else with_pinned_reasons(given_up, problem)
    met = only_targets(problem, {target.label for target in search.best})
    return BestEffort(replace(plan, reasons=reasons), met, given_up, search.is_exact, tuple(sorted(search.undecided)))


class _Search:
    """Depth-first search over sets of targets, the most important targets first.

    Without required transformations, adding targets never makes a problem possible or cheaper: a plan for more targets,
    stripped of the units that only these need, is a plan for fewer. A required transformation can reverse that (a
    further target may use it more cheaply), so subtrees are cut by the problem without required transformations.
    """

    def __init__(self, problem: Problem, targets: Sequence[Target], planner: Planner) -> None:
        self.end_s: float | None = None
        self.is_exact = True
        self.undecided: set[Pair] = set()
        self.best: frozenset[Target] = frozenset()
        self._problem = problem
        self._planner = planner
        self._targets = sorted(targets, key=lambda target: (-target.priority, target.label))
        self._levels = sorted({target.priority for target in targets}, reverse=True)
        self._plans: dict[frozenset[Target], Plan] = {}
        self._freely: dict[frozenset[Target], Plan] = {}
        self._refused: list[frozenset[Target]] = []
        self._is_free = not problem.environment.required

    @cached_property
    def _free(self) -> Problem:
        """The problem that requires nothing."""
        library = (replace(t, required=False) if t.required else t for t in self._problem.environment.library)
        return self._problem.with_parts(library=tuple(library))

    def run(self) -> None:
        everything = frozenset(self._targets)
        if self._is_met(everything):
            self.best = everything
        elif everything and self._is_met(frozenset()):
            self._descend(frozenset(), self._targets)

    @property
    def is_over(self) -> bool:
        """Whether the time is over."""
        return self._left_s() == 0.0

    def consider_running_units(self) -> None:
        """After the time limit: take the targets, the most important first, that the planner can still meet together
        without search.
        """
        chosen = self._also_met(frozenset(), self._targets)
        if self._is_better(chosen):
            self.best = chosen

    def _also_met(self, chosen: frozenset[Target], ahead: Sequence[Target]) -> frozenset[Target]:
        """Return `chosen`, which can be met, with each of `ahead` that can be met too; halves are tried, as
        most can.
        """
        everything = chosen.union(ahead)
        if not ahead or self._is_met(everything):
            return everything
        if len(ahead) == 1:
            return chosen
        half = len(ahead) // 2
        return self._also_met(self._also_met(chosen, ahead[:half]), ahead[half:])

    def best_plan(self) -> Plan:
        """The plan for the best set. Its status is UNKNOWN if time ran out before any target was met."""
        plan = self._plan(self.best)
        return Plan(plan.planner, Status.UNKNOWN) if self._targets and not (self.best or self.is_exact) else plan

    def why_given_up(self) -> dict[str, Reason]:
        """A reason for each target that could be met by itself as far as matching goes."""
        return {target.label: self._why(target) for target in self._targets if target not in self.best}

    def _descend(self, chosen: frozenset[Target], ahead: Sequence[Target]) -> None:
        """Search the sets that contain all of `chosen` and any of `ahead`; `chosen` itself is not known to be
        impossible.
        """
        if self.is_over:
            self.is_exact = False
            return
        everything = chosen.union(ahead)
        if not self._may_be_better(chosen, everything):
            return
        if self._is_met(everything):
            if self._is_better(everything):
                self.best = everything
            return
        if not ahead:
            return
        first, rest = ahead[0], ahead[1:]
        more = chosen | {first}
        if not self._is_refused(more) and self._free_plan(more).status not in REFUSED:
            self._descend(more, rest)
        self._descend(chosen, rest)

    def _may_be_better(self, chosen: frozenset[Target], everything: frozenset[Target]) -> bool:
        most, best = self._counts(everything), self._counts(self.best)
        if most != best or not self._is_free or Feature.ORDER in self._problem.features:
            return most >= best
        return self._free_plan(chosen).bound_us <= (self._plan(self.best).cost_us or 0)

    def _is_better(self, targets: frozenset[Target]) -> bool:
        most, best = self._counts(targets), self._counts(self.best)
        if most != best:
            return most > best
        return targets != self.best and self._plan(targets).rank < self._plan(self.best).rank

    def _counts(self, targets: frozenset[Target]) -> tuple[int, ...]:
        """Return the number of targets of each priority, the highest first."""
        count = Counter(target.priority for target in targets)
        return tuple(count[level] for level in self._levels)

    def _is_met(self, targets: frozenset[Target]) -> bool:
        return not self._is_refused(targets) and self._plan(targets).change_set is not None

    def _is_refused(self, targets: frozenset[Target]) -> bool:
        return any(refused <= targets for refused in self._refused)

    def _plan(self, targets: frozenset[Target]) -> Plan:
        if targets not in self._plans:
            self._plans[targets] = self._ask(self._problem, targets)
        return self._plans[targets]

    def _free_plan(self, targets: frozenset[Target]) -> Plan:
        """The plan that requires no transformation. Its cost bounds the plans for more targets from below."""
        if self._is_free:
            return self._plan(targets)
        if targets not in self._freely:
            self._freely[targets] = self._ask(self._free, targets)
        return self._freely[targets]

    def _ask(self, problem: Problem, targets: frozenset[Target]) -> Plan:
        plan = self._planner(only_targets(problem, {target.label for target in targets}), time_limit_s=self._left_s())
        if plan.status in REFUSED:
            if self._is_free or problem is self._free:
                self._refused.append(targets)
        else:
            self.undecided.update(plan.undecided)
            self.is_exact &= plan.status is Status.OPTIMAL
        return plan

    def _left_s(self) -> float | None:
        return None if self.end_s is None else max(0.0, self.end_s - time.monotonic())

    def _why(self, target: Target) -> Reason:
        alone = self._plan(frozenset({target}))
        known = Reason.of(alone.reasons.get(target.label, ""))
        if alone.status is Status.INFEASIBLE and known.name == target.label:  # its sentence says all
            return known
        return Reason(Lack(self._lack(target)), target.label, target.tag)

    def _lack(self, target: Target) -> str:
        for others, how in ((frozenset[Target](), "by itself"), (self.best, "with the targets that are met")):
            plan = self._plan(others | {target})
            if plan.status is Status.TOO_EXPENSIVE:
                dear_us = plan.bound_us if plan.cost_us is None else plan.cost_us
                allowed = f"{seconds(self._problem.max_cost_us or 0):f} s is allowed"
                least = "at least " if plan.cost_us is None else ""
                return f"{how} it would cost {least}{seconds(dear_us):f} s, and {allowed}"
            if plan.status is Status.INFEASIBLE:
                known = plan.reasons.get(target.label)
                return f"{how} it can't be met" + (f": {known}" if known else "")
            if plan.undecided:
                offered, demanded = plan.undecided[0]
                return f"it is not decided yet whether {offered} is {demanded}"
        return "time ran out"
