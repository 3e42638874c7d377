"""Alternatives: the cheapest configurations that run different transformations, in exact order of cost."""

from __future__ import annotations

import heapq
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

from cfgplan.costs import keep_cost_us, start_cost_us
from cfgplan.errors import InputError
from cfgplan.explaining.kept import Kept, Labels
from cfgplan.explaining.what_if import requiring, without_transformations
from cfgplan.onward import reached
from cfgplan.planning import REFUSED, Feature, Plan, Planner, Problem, Rank, Status, refuse_order
from cfgplan.reasons import Providers, startable
from cfgplan.summary import Summary, counted, cpu, summarised, summary
from cfgplan.validity import unused_required

FIRST_LOOK_S = 1.0
"""Seconds for the planner's first look at a part; each later look, when the part's bound is the least, takes twice
as long.
"""


def _alternatives_summary(found: Alternatives) -> Summary:
    more = " and there are more" if found.has_more else "" if found.complete else " and there may be more"
    rows = [
        (
            number,
            "" if plan.cost_us is None else cpu(plan.cost_us),
            ", ".join(unit.id for unit in plan.change_set.started) or "nothing",
        )
        for number, plan in enumerate(found.plans, 1)
        if plan.change_set is not None
    ]
    return summary(f"{counted(len(found.plans), 'plan')}, the best first{more}", ("", "cost", "starts"), rows)


@summarised(_alternatives_summary)
@dataclass(frozen=True)
class Alternatives:
    """The best `plans` of a problem, each with a different set of running transformations, in the order of optimality.

    The first is the optimal one; each of the others is the best of all that run the same transformations. `complete` is
    False if the list was cut short by the clock, by an open pair of tags, or by a configuration for which it is
    undecided whether something required serves a target or only a unit that runs anyway. `has_more` if further
    configurations exist.
    """

    plans: tuple[Plan, ...]
    complete: bool = True
    has_more: bool = False


def alternatives(problem: Problem, planner: Planner, count: int, *, time_limit_s: float | None = None) -> Alternatives:
    """Return the `count` best valid configurations within the largest cost that differ in the transformations that run.

    A unit is started only if a target needs it, pinned or not. This is Lawler's procedure: a set of configurations
    without its best one is divided into parts by what must and must not run; the part that may hold the cheapest is
    searched next. The result is empty if no plan exists, and holds only the plan if that is not proven optimal, ties
    included.
    """
    refuse_order(problem, "alternatives")
    if Feature.SURVIVAL in problem.features:
        raise InputError.of(
            "alternatives differ in the units that serve targets, so they can't be listed for plans with spares",
            mend="solve with --survive 0, or with --without NAME to see another plan",
        )
    end_s = None if time_limit_s is None else time.monotonic() + time_limit_s
    best = planner(problem, time_limit_s=time_limit_s)
    if best.status is not Status.OPTIMAL or not best.ties_proven:
        return Alternatives((best,) if best.change_set is not None else (), complete=best.status in REFUSED)
    ranking = _Ranking(problem, planner, best)
    found: list[Plan] = []
    for plan in ranking.plans(end_s):
        if plan is None:
            return Alternatives(tuple(found) or (best,), complete=False, has_more=True)
        if len(found) == count:
            return Alternatives(tuple(found), has_more=True)
        found.append(plan)
    return Alternatives(tuple(found))


@dataclass(frozen=True)
class _Part:
    """The configurations that run all of `within` and none of `without`."""

    within: Labels
    without: Labels
    limit_s: float = FIRST_LOOK_S


class _Ranking:
    def __init__(self, problem: Problem, planner: Planner, best: Plan) -> None:
        self._problem = problem
        self._planner = planner
        self._best = best
        environment = problem.environment
        running = {unit.transformation for unit in environment.units}
        self._keeping = Kept(problem)
        self._kept = self._keeping.labels
        self._required = frozenset(environment.required)
        self._cost_us = {
            t.label: min(((cost_us(t, problem.horizon_s, host)) for host in environment.places_for(t)), default=0)
            for t in environment.library
            for cost_us in [keep_cost_us if t.label in running else start_cost_us]
        }

    def plans(self, end_s: float | None) -> Iterator[Plan | None]:
        """Yield the plans in order; None when time is over, or when it is undecided which one is next."""
        whole = _Part(frozenset(), frozenset())
        heap: list[tuple[Rank, int, bool, list[str], list[str], _Part | Plan | None]] = [
            ((0,) * 4, 0, False, [], [], whole)
        ]
        while heap:
            if end_s is not None and time.monotonic() > end_s:
                yield None
                return
            least, kind, is_other, within, without, entry = heapq.heappop(heap)
            if not isinstance(entry, _Part):
                yield entry
                continue
            cheapest = self._cheapest(entry)
            if cheapest is None:
                continue
            if cheapest.status is not Status.OPTIMAL:
                bound = max(least, (least[0], cheapest.bound_us, 0, 0))
                later = None if cheapest.undecided else replace(entry, limit_s=2 * entry.limit_s)
                heapq.heappush(heap, (bound, kind, is_other, within, without, later))
                continue
            runs = self._runs(cheapest)
            plan = self._best_that_runs(runs)
            least_us = cheapest.cost_us or 0
            key = plan.rank if plan else (len(self._required - runs - self._kept), least_us, 0, 0)
            if self._is_allowed(key[1]):
                heapq.heappush(heap, (key, 1, plan != self._best, sorted(runs), [], plan))
            for part in self._rest(entry, runs):
                part_us = max(least_us, sum(self._cost_us[label] for label in part.within))
                if self._is_allowed(part_us):
                    bound = (len(self._required & part.without), part_us, 0, 0)
                    heapq.heappush(heap, (bound, 0, False, sorted(part.within), sorted(part.without), part))

    def _rest(self, part: _Part, runs: Labels) -> Iterator[_Part]:
        """Yield the rest of a part without the configurations that run exactly `runs`: each part lacks one of these or
        has another one.
        """
        within, without = part.within, part.without
        for label in sorted(runs - within):
            yield _Part(within, without | {label})
            within |= {label}
        others = self._relevant - runs - part.without
        for label in sorted(others, key=lambda label: (-self._cost_us[label], label)):
            yield _Part(runs | {label}, without)
            without |= {label}

    def _cheapest(self, part: _Part) -> Plan | None:
        """Return the cheapest plan of a part, ignoring requirements and the largest cost; None if the part is empty.

        If time ran out, its status is not optimal.
        """
        plan = self._plan(part.without, part.within, part.limit_s)
        if plan.status in (Status.FEASIBLE, Status.UNKNOWN):
            return replace(plan, bound_us=0) if plan.unused_required else plan
        if plan.change_set is None or plan.unused_required:
            return None
        after = self._problem.after(plan)
        kept = {unit.transformation for unit in after.units}
        return plan if self._kept <= kept else None

    def _best_that_runs(self, runs: Labels) -> Plan | None:
        """Return the best plan that runs just `runs` and the units of `Kept`; None if undecided, or if no such plan
        exists.
        """
        if runs == self._runs(self._best):
            return self._best
        plan = self._best_by_use(runs)
        if plan is None or plan.cost_us is None:
            return None
        unused = self._unused(plan)
        uses_as_many = len(unused) == len(self._best.unused_required)
        bound_us = self._best.bound_us if uses_as_many else 0
        is_required_proven = uses_as_many and self._best.required_proven
        return replace(
            plan,
            status=Status.of_plan(plan.cost_us, bound_us, is_required_proven=is_required_proven),
            bound_us=bound_us,
            unused_required=unused,
            required_proven=is_required_proven,
            ties_proven=False,
        )

    def _best_by_use(self, runs: Labels) -> Plan | None:
        """The best plan in which each of these serves a target or a unit that runs anyway; it uses as many required
        ones as possible.
        """
        others = self._problem.environment.transformation.keys() - runs - self._kept
        required = sorted(self._required & self._kept)
        for size in reversed(range(len(required) + 1)):
            found = []
            for used in map(frozenset, combinations(required, size)):
                plan = self._plan(others, runs | used, exempt=used)
                if plan.change_set is None or plan.unused_required:
                    continue
                if runs.intersection(self._required, self._unused(plan)):
                    strict = self._planner(_restricted(self._problem, others, runs | used))
                    if strict.unused_required or strict.rank != plan.rank:
                        return None
                    plan = strict
                found.append(plan)
            if found:
                return min(found, key=lambda plan: plan.rank)
        return None

    def _plan(
        self, without: Iterable[str], required: Labels, limit_s: float | None = None, *, exempt: Labels = frozenset()
    ) -> Plan:
        """The best plan without some transformations in which certain others serve a target or a unit that runs anyway.

        A unit that runs anyway but is `exempt` does not count as a target.
        """
        restricted = _restricted(self._keeping.with_own_targets(exempt), without, required)
        return self._keeping.without_artificial_targets(self._planner(restricted, time_limit_s=limit_s), restricted)

    def _unused(self, plan: Plan) -> tuple[str, ...]:
        return unused_required(self._problem.after(plan))

    def _runs(self, plan: Plan) -> Labels:
        after = self._problem.after(plan)
        return frozenset(unit.transformation for unit in after.units) - self._kept

    def _is_allowed(self, cost_us: int) -> bool:
        return self._problem.max_cost_us is None or cost_us <= self._problem.max_cost_us

    @cached_property
    def _relevant(self) -> Labels:
        """The transformations that a target or a pinned unit may need, directly or through others."""
        environment = self._problem.environment
        providers = Providers(environment.library, self._problem.similarity.optimistic)
        possible = startable(environment, providers)

        def feeding(label: str) -> Iterator[str]:
            for port in environment.transformation[label].inputs:
                yield from possible.intersection(providers.of(port.tag))

        wanted = (possible.intersection(providers.of(target.tag)) for target in environment.targets)
        return frozenset(reached(self._kept.union(*wanted), feeding)) - self._kept


def _restricted(problem: Problem, without: Iterable[str], required: Labels) -> Problem:
    """Return the problem without some transformations, with others required, and without a largest cost."""
    return requiring(without_transformations(problem, set(without)), required)
