"""A small core decided by depth-first search, with landmarks as the bound at every node.

At a node some labels are taken (they cost nothing any more) and some are left out. LM-cut (`bounds`) raises the node's
bound, reduced costs leave labels out, and the search branches on a label of a landmark: first take it, then leave it
out. A child inherits the landmarks, but for those that a taken label hits: their charges are released. Plain lists are
faster than arrays up to some hundred labels. Effort is counted in steps, so a run is repeatable.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from heapq import heappop, heappush
from typing import TYPE_CHECKING

from cfgplan.onward import derivations
from cfgplan.planners.networks.core import NEVER, Core
from cfgplan.planners.solving.arrays import np

if TYPE_CHECKING:
    from cfgplan.planners.bounding.bounds import Bound

LEFT_OUT = int(NEVER)
"""The price of a label that is left out."""


class Links:
    """A core as plain lists."""

    def __init__(self, core: Core) -> None:
        needs = [core.needs.lists[label] for label in range(core.goal + 1)]
        providers = [core.providers.lists[fact] for fact in range(len(core.providers))]
        self.goal = len(needs) - 1
        self.needs = needs
        self.providers = providers
        self.gives = _transposed(providers, len(needs))
        self.needed_by = _transposed(needs, len(providers))
        self.missing = [len(row) for row in needs]
        self.sources = [label for label, row in enumerate(needs) if not row]


def _transposed(rows: list[list[int]], columns: int) -> list[list[int]]:
    """Row j holds the i whose row held j."""
    turned: list[list[int]] = [[] for _ in range(columns)]
    for i, row in enumerate(rows):
        for j in row:
            turned[j].append(i)
    return turned


class Ways:
    """h_max of facts, and of labels without their own price, kept up to date while labels become cheaper.

    The same as `bounds.cheapest_way` for small cores, where arrays cost more to call than to fill. A label that is left
    out opens no way. `price` is shared with the caller, not copied.
    """

    def __init__(self, links: Links, price: list[int], most: int = LEFT_OUT) -> None:
        """Facts that cost `most` or more at first count as out of reach."""
        self._links = links
        self._gives = links.gives
        self._price = price
        self._facts = [most] * len(links.providers)
        self._before = [LEFT_OUT] * (links.goal + 1)
        self._max_need = [-1] * (links.goal + 1)
        self._provider = [-1] * len(links.providers)
        self.zones: list[list[int]] = []
        """The zones of the landmarks so far."""
        self._derive()

    @property
    def to_goal(self) -> int:
        return self._before[self._links.goal]

    def _derive(self) -> None:
        """Compute all values from the sources on, cheapest facts first (Dijkstra)."""
        facts, before, max_need = self._facts, self._before, self._max_need
        ahead = list[tuple[int, int]]()
        for label in self._links.sources:
            before[label] = 0
            self._offer(label, ahead)
        for label, fact in derivations(self._settled(ahead), self._links.needed_by, self._links.missing[:]):
            before[label], max_need[label] = facts[fact], fact
            self._offer(label, ahead)

    def lower(self, cheaper: Iterable[int]) -> None:
        """Update all values after some labels became cheaper."""
        facts, before, max_need = self._facts, self._before, self._max_need
        needs, needed_by, value_of = self._links.needs, self._links.needed_by, self._facts.__getitem__
        ahead = list[tuple[int, int]]()
        for label in cheaper:
            self._offer(label, ahead)
        for fact in self._settled(ahead):
            for label in needed_by[fact]:
                if max_need[label] == fact:
                    max_need[label] = need = max(needs[label], key=value_of)
                    if facts[need] < before[label]:
                        before[label] = facts[need]
                        self._offer(label, ahead)

    def _settled(self, ahead: list[tuple[int, int]]) -> Iterator[int]:
        """Yield the facts ahead, cheapest first, without outdated entries. More may be put ahead meanwhile."""
        facts = self._facts
        while ahead:
            value, fact = heappop(ahead)
            if value == facts[fact]:
                yield fact

    def _offer(self, label: int, ahead: list[tuple[int, int]]) -> None:
        """Put ahead the facts that a label gives more cheaply than was known. The goal gives none."""
        if gives := self._gives[label]:
            facts, cost = self._facts, self._before[label] + self._price[label]
            for given in gives:
                if cost < facts[given]:
                    facts[given] = cost
                    self._provider[given] = label
                    heappush(ahead, (cost, given))

    def landmark(self) -> tuple[int, ...]:
        """Return a landmark: the labels that may be first to enter the zone from which the goal comes free of charge by
        its most expensive needs.
        """
        links, price, before, max_need = self._links, self._price, self._before, self._max_need
        providers, needed_by = links.providers, links.needed_by
        zone = [max_need[links.goal]]
        seen = set(zone)
        members = set[int]()
        for fact in zone:
            members.update(providers[fact])
            for label in providers[fact]:
                if not price[label] and max_need[label] not in seen and before[label] < LEFT_OUT:
                    seen.add(max_need[label])
                    zone.append(max_need[label])
        members.difference_update(*[needed_by[fact] for fact in zone])
        self.zones.append(zone)
        return tuple([label for label in sorted(members) if price[label] < LEFT_OUT and before[label] < LEFT_OUT])

    def plan(self) -> set[int]:
        """A grounded plan: the labels of the cheapest ways to the goal."""
        needs, provider = self._links.needs, self._provider
        ahead = list(needs[self._links.goal])
        seen = set(ahead)
        chosen = set[int]()
        for fact in ahead:
            label = provider[fact]
            if label not in chosen:
                chosen.add(label)
                for need in needs[label]:
                    if need not in seen:
                        seen.add(need)
                        ahead.append(need)
        return chosen

    def labels_from(self, cost: int) -> list[int]:
        """Return the labels whose own price and most expensive unavoidable chain together cost at least `cost`."""
        pairs = zip(self._price, self._before, strict=False)
        return [label for label, (own, before) in enumerate(pairs) if own < LEFT_OUT and own + before >= cost]


@dataclass(slots=True)
class _Node:
    """The residual cost of each label: 0 if it is taken, `LEFT_OUT` if it is left out."""

    residual: list[int]
    paid: int
    charged: int
    landmarks: list[tuple[int, tuple[int, ...]]]
    """The weight of each landmark, and its members that are not left out."""
    share: float
    """The estimated share of the whole search that is below this node."""

    @property
    def bound(self) -> int:
        return self.paid + self.charged

    def charge(self, members: tuple[int, ...], at_most: int = LEFT_OUT) -> int:
        """Charge a landmark with the least residual cost of its members, or with `at_most`. Returns that weight."""
        residual = self.residual
        weight = min(at_most, min([residual[member] for member in members], default=at_most))
        if weight:
            for member in members:
                residual[member] -= weight
            self.charged += weight
        return weight

    def take(self, labels: set[int], among: int = 1) -> _Node:
        """The child node that takes the labels. It gets one of `among` parts of this node's share."""
        residual, charged, landmarks = self.residual[:], self.charged, []
        for landmark in self.landmarks:
            weight, members = landmark
            if labels.isdisjoint(members):
                landmarks.append(landmark)
            else:
                charged -= weight
                for member in members:
                    residual[member] += weight
        paid = self.paid
        for label in labels:
            paid += residual[label]
            residual[label] = 0
        share = self.share / among
        self.share -= share
        return _Node(residual, paid, charged, landmarks, share)

    def leave_out(self, labels: Collection[int]) -> bool:
        """Leave the labels out. Returns False if a landmark has no other members."""
        if not labels:
            return True
        residual = self.residual
        for label in labels:
            residual[label] = LEFT_OUT
        for i, (weight, members) in enumerate(self.landmarks):
            left = tuple([member for member in members if residual[member] < LEFT_OUT])
            if not left:
                return False
            if len(left) < len(members):
                self.landmarks[i] = weight + self.charge(left), left
        return True


class Branching:
    """A search for a plan of a core that weighs less than `limit`. All weights and `limit` are multiples of `step`."""

    def __init__(
        self,
        core: Core,
        cost: Sequence[int],
        limit: int,
        step: int,
        is_over: Callable[[], bool],
        known: Sequence[tuple[int, tuple[int, ...]]] = (),
    ) -> None:
        """The search begins with `known` landmarks: a weight, at most, and the members."""
        self.best: set[int] | None = None
        self.nodes = 0
        self._core, self._cost = core, list(cost)
        self._links = Links(core)
        self.enough = limit - step + 1
        """A bound this high proves that no plan is better."""
        self._step = step
        self._steps = 0
        self._is_over = is_over
        self._known = known
        self._ahead = [self._root()]
        self._first: tuple[list[list[int]], list[tuple[int, tuple[int, ...]]]] | None = None

    def bound(self) -> Bound:
        """The root's bound for plans below the limit, with its landmarks in the core's numbering."""
        from cfgplan.planners.bounding.bounds import Bound
        from cfgplan.planners.bounding.landmarks import Landmark

        zones, landmarks = self._first or ([], [])
        new = landmarks[len(self._known) :]
        found = [Landmark(np.array(z), np.array(m)) for z, (_, m) in zip(zones, new, strict=False)]
        bound = Bound(self._core, np.array(self._cost, np.int64), found)
        bound.recharge([weight for weight, _ in new])
        return bound

    def run(self, steps: int) -> bool:
        """Search for `steps` steps, a landmark or a node each. True if no plan is better than `best`, or the limit."""
        self._steps = steps
        while self._ahead and not self._is_late():
            self._go_on()
        return not self._ahead

    @property
    def least(self) -> int:
        """A lower bound on every plan's weight, as far as the search has come; `enough` once it is over."""
        return min([self.enough, *(node.bound for node in self._ahead)])

    @property
    def done(self) -> float:
        """The estimated share of the search that is done."""
        return 1.0 - sum(node.share for node in self._ahead)

    def others(self, plan: Collection[int], steps: int) -> set[int] | None:
        """A superset of the labels that any plan cheaper than the limit uses beyond `plan`.

        None if steps or time run out first. Call this or `run`, not both.
        """
        self._steps = steps
        root, found = self._root(), set[int]()
        ways = self._tighten(root)
        if ways is None:
            return None
        root.leave_out(ways.labels_from(self.enough - root.bound))
        for label in range(len(self._cost)):
            if label in plan or label in found or root.residual[label] == LEFT_OUT:
                continue
            self.best, self._ahead, enough = None, [root.take({label}, 2)], self.enough
            while self._ahead and self.best is None:
                if self._is_late():
                    return None
                self._go_on()
            if self.best is None:
                root.leave_out([label])
            else:
                found |= {label} | (self.best - set(plan))
                self.enough = enough
        return found

    def _root(self) -> _Node:
        root = _Node(self._cost[:], 0, 0, [], 1.0)
        root.landmarks += [(root.charge(members, weight), members) for weight, members in self._known]
        return root

    def _is_late(self) -> bool:
        return self._steps <= 0 or self._is_over()

    def _go_on(self) -> None:
        """Expand the node ahead; it is put back if steps or time run out."""
        node = self._ahead.pop()
        self.nodes += 1
        ways = self._tighten(node)
        if ways is None:
            if self._is_late():
                self._ahead.append(node)
            return
        plan = ways.plan()
        weight = sum([self._cost[label] for label in plan])
        if weight < self.enough:
            self.enough, self.best = weight - self._step + 1, plan
        if not node.leave_out(ways.labels_from(self.enough - node.bound)) or node.bound >= self.enough:
            return
        near = self._nearest(node)
        if len(near) == 1:
            forced = [members[0] for _, members in node.landmarks if len(members) == 1]
            self._ahead.append(node.take({*near, *forced}))
        elif near:
            label = min(near, key=lambda member: (node.residual[member], member not in plan, member))
            taken = node.take({label}, len(near))
            if node.leave_out([label]):
                self._ahead.append(node)
            self._ahead.append(taken)

    def _tighten(self, node: _Node) -> Ways | None:
        """Charge landmarks until the goal is free; None if no plan is good enough, or steps or time are over."""
        ways = Ways(self._links, node.residual, self.enough - node.bound)
        self._first = self._first or (ways.zones, node.landmarks)
        while node.bound + ways.to_goal < self.enough:
            if self._is_late():
                return None
            self._steps -= 1
            if not ways.to_goal:
                return ways
            members = ways.landmark()
            node.landmarks.append((node.charge(members), members))
            ways.lower(members)
        return None

    def _nearest(self, node: _Node) -> list[int]:
        """The members that a better plan may use, of the landmark that has the fewest of them."""
        residual, gap = node.residual, self.enough - node.bound
        fewest, least, nearest = len(residual) + 1, int(NEVER), list[int]()
        for weight, members in node.landmarks:
            near = [member for member in members if residual[member] < gap]
            if (len(near), weight) < (fewest, least):
                fewest, least, nearest = len(near), weight, near
        return nearest
