"""The proven plan that runs, and the bounds that its proof gives for plans after a small change of costs.

The plan runs and no other is cheaper. Then costs change: a dead unit costs its labor again, estimates move. Another
plan is no better if it has all labels of the proven one whose cost rose, and no other labels whose cost fell. Any other
plan lacks one of the former or has one of the latter: landmarks, charged as before the change, mostly show that it
costs more.
"""

from __future__ import annotations

from dataclasses import dataclass

from cfgplan.planners.bounding.bounds import Bound, tightened
from cfgplan.planners.closing.program import charged
from cfgplan.planners.exact.remaining import Remaining
from cfgplan.planners.networks.core import Ints
from cfgplan.planners.solving.arrays import np
from cfgplan.planners.solving.clock import Clock


@dataclass(frozen=True)
class WarmStart:
    """A plan proven cheapest at some costs, and a bound there for all plans that cost at most `limit`.

    The plan's labels are numbers in the network, in order. Any other plan as cheap has one of the labels `ties`.
    """

    plan: Ints
    cost: Ints
    limit: int
    bound: Bound
    ties: Ints

    @classmethod
    def of(cls, plan: Ints, cost: Ints, limit: int, bound: Bound, clock: Clock) -> WarmStart:
        """Return the warm start for a proven plan: tighten its bound for plans within `limit`, and look for ties."""
        value = int(cost[plan].sum())
        bound = _charged(bound.restricted(bound.may_be_used(limit)), value, limit, clock)
        bound = bound.restricted(bound.may_be_used(limit))
        close = _charged(bound.restricted(bound.may_be_used(value)), value, value, clock)
        close = close.restricted(close.may_be_used(value))
        ties = np.setdiff1d(close.core.labels, plan)
        if len(ties) and _is_without_tie(close, plan, value, clock):
            ties = ties[:0]
        return cls(plan, cost, limit, bound, ties)

    def moved(self, plan: Ints, cost: Ints, limit: int, clock: Clock) -> WarmStart | None:
        """The warm start at other costs, for plans within `limit` or more; None if the bound does not reach as far."""
        known = self.limit_at(cost)
        return WarmStart.of(plan, cost, known, self._bound_at(cost), clock) if limit <= known else None

    def limit_at(self, cost: Ints) -> int:
        """Return the limit of the bound at other costs that admits each plan that cost `limit` or less when proven."""
        fallen = cost < self.cost
        less = int((self.cost - cost)[fallen].sum())
        share = float((cost[fallen] / self.cost[fallen]).min(initial=1.0))
        return max(self.limit - less, int(self.limit * share * (1 - 1e-9)) if share else -1)

    def remaining(self, cost: Ints, step: int, plan: Ints, clock: Clock) -> Remaining | None:
        """The labels that a plan as good as this one can contain at these costs; None if the costs differ too much.

        The costs of all plans are multiples of `step`.
        """
        limit = int(cost[plan].sum())
        if limit > self.limit_at(cost):
            return None
        bound = self._bound_at(cost)
        more_expensive = self.plan[cost[self.plan] > self.cost[self.plan]]
        others = np.setdiff1d(bound.core.labels, self.plan)
        cheaper = others[cost[others] < self.cost[others]]
        if len(more_expensive) + len(cheaper) > clock.tuning.replan.cases:
            return Remaining.by(_raised(bound, limit - step + 1, limit, clock), limit)
        lefts = [_without(label, bound, limit, clock) for label in more_expensive.tolist()]
        lefts += [_with(label, bound, limit, clock) for label in cheaper.tolist()]
        value = int(cost[self.plan].sum())
        if value <= limit:
            lefts.append(Remaining(np.union1d(self.plan, self.ties), value))
        return Remaining(
            np.unique(np.concatenate([one.labels for one in lefts])),
            min(one.value for one in lefts),
            lefts[0].bound if len(lefts) == 1 else bound,
        )

    def _bound_at(self, cost: Ints) -> Bound:
        return self.bound.at(cost[self.bound.core.labels])


def _charged(bound: Bound, enough: int, limit: int, clock: Clock) -> Bound:
    """The bound tightened, its landmarks then charged in the best way, and tightened again."""
    bound = tightened(bound, enough, limit, clock)
    return bound if bound.value >= enough else tightened(charged(bound, clock), enough, limit, clock)


def _raised(bound: Bound, enough: int, limit: int, clock: Clock) -> Bound:
    """Return the bound tightened. If it leaves many labels, a linear program then charges its landmarks.

    Searching so many labels would take longer than the linear program.
    """
    bound = tightened(bound, enough, limit, clock)
    keep = bound.may_be_used(limit)
    if bound.value >= enough or keep.sum() < clock.tuning.replan.many:
        return bound
    return tightened(charged(bound.restricted(keep), clock), enough, limit, clock)


def _without(label: int, bound: Bound, limit: int, clock: Clock) -> Remaining:
    """The labels that a plan of cost `limit` or less without one label can contain."""
    cost = np.where(bound.core.labels == label, np.maximum(limit + 1, bound.cost), bound.cost)
    return Remaining.by(_raised(bound.at(cost), limit + 1, limit, clock), limit)


def _with(label: int, bound: Bound, limit: int, clock: Clock) -> Remaining:
    """The labels that a plan of cost `limit` or less with one label can contain: this label is paid once, then free."""
    is_it = bound.core.labels == label
    own = int(bound.cost[is_it][0])
    if not bound.may_be_used(limit)[is_it][0]:
        return Remaining(bound.core.labels[:0], limit + 1)
    for_others = limit - own
    free = bound.at(np.where(is_it, 0, bound.cost))
    left = Remaining.by(_raised(free, for_others + 1, for_others, clock), for_others)
    return Remaining(np.union1d(left.labels, [label]), left.value + own, left.bound)


def _is_without_tie(bound: Bound, plan: Ints, limit: int, clock: Clock) -> bool:
    """True if it is proven that all plans of the bound's core within `limit` use labels of `plan` only.

    Only landmarks stand for groundedness, so False may be wrong.
    """
    from ortools.sat.python.cp_model import INFEASIBLE

    from cfgplan.planners.closing.fed_model import FedModel
    from cfgplan.planners.solving.engine import repeatable_solver, solve

    core, model = bound.core, FedModel(bound.core, bound.cost, bound.landmarks)
    model.add_bool_or([model.uses[i] for i in np.flatnonzero(~np.isin(core.labels, plan)).tolist()])
    model.add(model.cost <= limit)
    left_s, longest_s = clock.left_s(), clock.tuning.replan.ties
    longest_s = longest_s if left_s is None else min(longest_s, left_s)
    solver = repeatable_solver(small=core.goal < 1000, time_limit_s=longest_s)
    return solve(solver, model, clock) == INFEASIBLE
