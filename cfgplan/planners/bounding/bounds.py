"""Lower bounds from landmarks: every plan contains at least one transformation of a landmark, or several.

Each landmark is charged part of its members' costs, no member more than it costs in total. The sum of the charges is a
lower bound (LM-cut: Helmert and Domshlak 2009). A landmark that demands several members counts its charge several
times. Landmarks stay valid whatever costs become, so a session keeps them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from heapq import nsmallest

from cfgplan.planners.bounding.landmarks import Landmark, ways_into
from cfgplan.planners.networks.core import MOST_PASSES, NEVER, Core, Flags, Ints
from cfgplan.planners.solving.arrays import np
from cfgplan.planners.solving.clock import Clock


def cheapest_way(core: Core, cost: Ints, above: Ints | None = None) -> tuple[Ints, Ints]:
    """Return h_max of each fact, and of each label without its own cost: the most expensive chain that can't be
    avoided.

    `above` are upper bounds on the facts' values, such as h_max at higher costs.
    """
    facts = np.full(len(core.providers), NEVER) if above is None else above
    for _ in range(MOST_PASSES):
        labels = core.most_of_needs(facts)
        better = np.minimum(facts, core.least_of_givers(labels[:-1] + cost))
        if (better == facts).all():
            return facts, labels
        facts = better
    found = core.facts_one_by_one(cost.tolist(), max)
    facts = np.array([min(found.get(fact, NEVER), NEVER) for fact in range(len(core.providers))], np.int64)
    return facts, core.most_of_needs(facts)


@dataclass
class Bound:
    """A lower bound on cost: the landmarks of a core, their weights, and the residual cost of each label."""

    core: Core
    cost: Ints
    landmarks: list[Landmark] = field(default_factory=list)
    weights: list[int] = field(default_factory=list)
    value: int = 0

    def __post_init__(self) -> None:
        self.residual = self.cost.copy()

    def charge(self, landmark: Landmark, at_most: int = int(NEVER)) -> int:
        """Charge the members of a landmark as much as their residual costs allow, up to `at_most`.

        The bound's value rises accordingly. Returns the landmark's weight: the charge per count.
        """
        if not len(landmark.members):
            return 0
        members, multi_demand = landmark.members, landmark.multi_demand
        if multi_demand is None:
            weight = min(int(self.residual[members].min()), at_most)
            self.residual[members] -= weight
            self.value += weight
        else:
            weight = min(int((self.residual[members] // multi_demand.counts).min()), at_most)
            self.residual[members] -= weight * multi_demand.counts
            self.value += weight * multi_demand.least
        return weight

    def recharge(self, weights: Sequence[int]) -> None:
        """Charge all landmarks again: first each with its weight as far as costs allow, then each with the remaining
        costs.
        """
        self.residual, self.value = self.cost.copy(), 0
        charged = [self.charge(one, weight) for one, weight in zip(self.landmarks, weights, strict=False)]
        self.weights = charged + [0] * (len(self.landmarks) - len(charged))
        self.charge_residuals()

    def charge_residuals(self) -> None:
        """Charge each landmark as much more as residual costs allow. The value is NEVER if a landmark is impossible."""
        if any(landmark.is_impossible for landmark in self.landmarks):
            self.value = int(NEVER)
        elif self.landmarks:
            members = np.concatenate([landmark.members for landmark in self.landmarks])
            ends = np.cumsum([len(landmark.members) for landmark in self.landmarks])
            least = np.minimum.reduceat(self.residual[members], np.append(0, ends[:-1]))
            for i in np.flatnonzero(least).tolist():
                self.weights[i] += self.charge(self.landmarks[i])

    def improve(self, enough: int, most: int, is_over: Callable[[], bool]) -> None:
        """Charge up to `most` new landmarks, until the value is `enough` or the goal is free at residual costs."""
        facts, _ = cheapest_way(self.core, self.residual)
        wanted = self.core.needs[self.core.goal]
        for _ in range(most):
            if self.value >= enough or not len(wanted) or is_over():
                return
            goal = int(wanted[np.argmax(facts[wanted])])
            weight = 0
            if facts[goal]:
                landmark = ways_into(self.core, goal, facts.tolist(), self.residual.tolist())
                weight = self.charge(landmark)
            if not weight:
                return
            self.landmarks.append(landmark)
            self.weights.append(weight)
            facts, _ = cheapest_way(self.core, self.residual, facts)

    def may_be_used(self, limit: int) -> Flags:
        """Return which labels may be in a plan that costs at most `limit` (reduced-cost fixing); none if no
        plan does.
        """
        _, before = cheapest_way(self.core, self.residual)
        if self.value + before[-1] > limit:
            return np.zeros(self.core.goal, np.bool_)
        return np.asarray(self.value + before[:-1] + self.residual <= limit)

    def at(self, cost: Ints) -> Bound:
        """The bound at other costs, by the same landmarks."""
        other = Bound(self.core, cost, list(self.landmarks), list(self.weights), self.value)
        other.residual = self.residual + (cost - self.cost)
        if (other.residual < 0).any():
            other.recharge(self.weights)
        else:
            other.charge_residuals()
        return other

    def short(self) -> list[Landmark]:
        """The landmarks with the fewest members, with no more entries in total than the core has links.

        More and longer ones slow the linear program, or the solver, more than they help.
        """
        entries = np.cumsum(sorted(len(landmark.members) for landmark in self.landmarks))
        few = int(np.searchsorted(entries, self.core.links, side="right"))
        return nsmallest(few, self.landmarks, key=lambda landmark: len(landmark.members))

    def as_of(self, parts: int, more: int, cost: Ints) -> Bound:
        """Convert a bound on costs in parts, `parts` of which make a cost unit, to one on `cost` in whole units.

        `more` parts are added to its value, which is rounded up; weights and residual costs are rounded down.
        """
        whole = Bound(self.core, cost, self.landmarks, [weight // parts for weight in self.weights])
        whole.value = -(-(self.value + more) // parts)
        whole.residual = self.residual // parts
        return whole

    def restricted(self, keep: Flags) -> Bound:
        """The bound for plans that use flagged labels only; landmarks of weight 0 are dropped."""
        core = self.core.restricted(keep)
        fact = np.full(len(self.core.providers), -1)
        fact[np.searchsorted(self.core.facts, core.facts)] = np.arange(len(core.facts))
        label = np.where(keep, np.cumsum(keep) - 1, -1)
        counting = [i for i, weight in enumerate(self.weights) if weight]
        zones = _kept(fact, [self.landmarks[i].zone for i in counting])
        members = _kept(label, [self.landmarks[i].members for i in counting])
        multi_facts = [
            old.multi_demand
            and old.multi_demand.renumbered(old.multi_demand.counts[label[old.members] >= 0], label, fact)
            for old in (self.landmarks[i] for i in counting)
        ]
        landmarks = [Landmark(*one) for one in zip(zones, members, multi_facts, strict=True)]
        part = Bound(core, self.cost[keep], landmarks, [self.weights[i] for i in counting], self.value)
        part.residual = self.residual[keep]
        part.charge_residuals()
        return part


def _kept(number: Ints, rows: list[Ints]) -> list[Ints]:
    """Renumber the items row by row; items whose new number is negative are dropped."""
    if not rows:
        return []
    items = number[np.concatenate(rows)]
    stays = items >= 0
    ends = np.cumsum([len(row) for row in rows])
    return np.split(items[stays], np.cumsum(stays)[ends - 1][:-1])


def tightened(bound: Bound, enough: int, limit: int, clock: Clock, *, greedily: bool = False) -> Bound:
    """Add landmarks to a bound for plans within `limit`, until it is `enough` or more of them no longer pay.

    Where no plan is within `limit`, the value ends above it. With `greedily` it stops sooner, since `closing` follows:
    soon while all labels stay, since the linear program then gains more, later once reduced costs leave labels out,
    since each landmark takes less then.
    """
    rise, whole = clock.tuning.rise, bound.core.goal
    while bound.value < enough and not clock.is_over():
        before = bound.value
        keep = bound.may_be_used(limit)
        if not keep.any():
            bound.value = limit + 1
            break
        if keep.sum() < 0.8 * len(keep):
            bound = bound.restricted(keep)
        labels = bound.core.goal
        patience = rise.patience * labels if greedily else rise.last_patience * labels**1.5
        if greedily and labels < whole:
            patience = max(patience, rise.narrowed * labels**1.5)
        each = rise.landmark + rise.need * len(bound.core.needs.items) + rise.link * bound.core.deep_links
        bound.improve(enough, rise.landmarks, clock.is_over)
        if bound.value < enough and not _pays(bound.value - before, enough - before, rise.landmarks * each, patience):
            break
    return bound


def _pays(closed: int, gap: int, took: float, patience: float) -> bool:
    """Whether the whole gap would be closed within `patience` at the pace of the last step."""
    return closed * patience >= gap * took


def chained_bound(core: Core, cost: Ints, certain: Sequence[int], is_over: Callable[[], bool]) -> int:
    """Return a quick lower bound: the cost of the labels that are `certain` to run, plus the most expensive chains.

    h_max of a fact is a sum of landmarks, one for each level up to it. The zone of a level holds the facts at or above
    it from which the fact comes by the most expensive needs. All landmarks of a chain are charged at once; the next
    chain is charged from the remaining costs. It ends when the time is over. If few labels need more than one fact at a
    time, it meets the optimum after a few rounds.
    """
    residual, value = cost.copy(), int(cost[certain].sum())
    residual[certain] = 0
    wanted = core.needs[core.goal]
    facts, before = cheapest_way(core, residual)
    while len(wanted):
        end = int(wanted[np.argmax(facts[wanted])])
        level = int(facts[end])
        value = min(value + level, int(NEVER))
        if level == 0 or value == NEVER or is_over():
            break
        charges = _charges(core, facts, before, end)
        # With facts that take several, the cheaper providers of a fact would be charged more than they have left.
        residual -= charges if core.multi_facts is None else np.minimum(charges, residual)
        facts, before = cheapest_way(core, residual, facts)
    return value


def _charges(core: Core, facts: Ints, before: Ints, end: int) -> Ints:
    """The charge on each label by the landmarks of a chain: from the level of its needs to the level it enters."""
    labels, max_need = core.needs_with(facts, before)
    level = np.zeros_like(facts)
    level[end] = facts[end]
    while True:
        entered = core.most_of_offers(level)
        higher = level.copy()
        np.maximum.at(higher, max_need, np.minimum(entered, before)[labels])
        if (higher == level).all():
            charges: Ints = np.maximum(entered - before, 0)[:-1]
            return charges
        level = higher
