"""The cheapest ways to facts by h_max on plain lists, kept up to date while labels become cheaper.

The same as `bounds.cheapest_way` for small cores, where arrays cost more to call than to fill. A label that is
left out opens no way.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from heapq import heappop, heappush

from cfgplan.planners.networks.core import NEVER, Core

LEFT_OUT = int(NEVER)
"""The price of a label that is left out."""


class Links:
    """A core as plain lists."""

    def __init__(self, core: Core) -> None:
        needs = [core.needs.lists[label] for label in range(core.goal + 1)]
        givers = [core.givers.lists[fact] for fact in range(len(core.givers))]
        self.goal = len(needs) - 1
        self.needs = needs
        self.givers = givers
        self.gives = _transposed(givers, len(needs))
        self.needed_by = _transposed(needs, len(givers))
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
    """h_max of facts, and of labels without their own price; `price` is shared with the caller, not copied."""

    def __init__(self, links: Links, price: list[int], most: int = LEFT_OUT) -> None:
        """Facts that cost `most` or more at first count as out of reach."""
        self._links = links
        self._price = price
        self._facts = [most] * len(links.givers)
        self._before = [LEFT_OUT] * (links.goal + 1)
        self._dearest = [-1] * (links.goal + 1)
        self._giver = [-1] * len(links.givers)
        self.zones: list[list[int]] = []
        """The zones of the landmarks so far."""
        self._derive()

    @property
    def to_goal(self) -> int:
        return self._before[self._links.goal]

    def _derive(self) -> None:
        """Compute all values from the sources on, cheapest facts first (Dijkstra)."""
        before, dearest, needed_by = self._before, self._dearest, self._links.needed_by
        missing, ahead = self._links.missing[:], list[tuple[int, int]]()
        for label in self._links.sources:
            before[label] = 0
            self._offer(label, ahead)
        for value, fact in self._settled(ahead):
            for label in needed_by[fact]:
                missing[label] -= 1
                if not missing[label]:
                    before[label], dearest[label] = value, fact
                    self._offer(label, ahead)

    def lower(self, cheaper: Iterable[int]) -> None:
        """Update all values after some labels became cheaper."""
        facts, before, dearest = self._facts, self._before, self._dearest
        needs, needed_by, value_of = self._links.needs, self._links.needed_by, self._facts.__getitem__
        ahead = list[tuple[int, int]]()
        for label in cheaper:
            self._offer(label, ahead)
        for _, fact in self._settled(ahead):
            for label in needed_by[fact]:
                if dearest[label] == fact:
                    dearest[label] = need = max(needs[label], key=value_of)
                    if facts[need] < before[label]:
                        before[label] = facts[need]
                        self._offer(label, ahead)

    def _settled(self, ahead: list[tuple[int, int]]) -> Iterator[tuple[int, int]]:
        """Yield the facts ahead, cheapest first, without outdated entries. More may be put ahead meanwhile."""
        facts = self._facts
        while ahead:
            value, fact = heappop(ahead)
            if value == facts[fact]:
                yield value, fact

    def _offer(self, label: int, ahead: list[tuple[int, int]]) -> None:
        """Put ahead the facts that a label gives more cheaply than was known."""
        if label == self._links.goal:
            return
        facts = self._facts
        cost = self._before[label] + self._price[label]
        for given in self._links.gives[label]:
            if cost < facts[given]:
                facts[given], self._giver[given] = cost, label
                heappush(ahead, (cost, given))

    def landmark(self) -> tuple[int, ...]:
        """A landmark: the labels that may enter first the zone from which the goal comes free by the dearest needs."""
        links, price, before, dearest = self._links, self._price, self._before, self._dearest
        givers, needed_by = links.givers, links.needed_by
        zone = [dearest[links.goal]]
        seen = set(zone)
        members = set[int]()
        for fact in zone:
            members.update(givers[fact])
            for label in givers[fact]:
                if not price[label] and dearest[label] not in seen and before[label] < LEFT_OUT:
                    seen.add(dearest[label])
                    zone.append(dearest[label])
        members.difference_update(*[needed_by[fact] for fact in zone])
        self.zones.append(zone)
        return tuple([label for label in sorted(members) if price[label] < LEFT_OUT and before[label] < LEFT_OUT])

    def plan(self) -> set[int]:
        """A grounded plan: the labels of the cheapest ways to the goal."""
        needs, giver = self._links.needs, self._giver
        ahead = list(needs[self._links.goal])
        seen = set(ahead)
        chosen = set[int]()
        for fact in ahead:
            label = giver[fact]
            if label not in chosen:
                chosen.add(label)
                for need in needs[label]:
                    if need not in seen:
                        seen.add(need)
                        ahead.append(need)
        return chosen

    def labels_from(self, cost: int) -> list[int]:
        """The labels whose own price and dearest chain together cost at least `cost`."""
        pairs = zip(self._price, self._before, strict=False)
        return [label for label, (own, before) in enumerate(pairs) if own < LEFT_OUT and own + before >= cost]
