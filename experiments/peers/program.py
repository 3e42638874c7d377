"""The problem as an integer program over units and demanded tags, with landmarks added where units are not grounded."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field
from math import gcd

from cfgplan.errors import InputError
from experiments.peers.lead import Lead
from experiments.peers.selection import Selection


@dataclass
class Rows:
    """Linear constraints `low <= sum(value * column)`, in the compressed form that HiGHS takes all at once."""

    low: list[float] = field(default_factory=list)
    starts: list[int] = field(default_factory=list)
    columns: list[int] = field(default_factory=list)
    values: list[float] = field(default_factory=list)

    def at_least(self, low: float, columns: Sequence[int], values: Sequence[float]) -> None:
        self.low.append(low)
        self.starts.append(len(self.columns))
        self.columns += columns
        self.values += values

    def implies(self, column: int, others: Sequence[int]) -> None:
        """column <= sum of the others"""
        self.at_least(0, [*others, column], [1.0] * len(others) + [-1.0])

    def some(self, columns: Sequence[int]) -> None:
        self.at_least(1, columns, [1.0] * len(columns))

    def each(self) -> Iterable[tuple[float, list[int], list[float]]]:
        """Each row's least value, columns and coefficients."""
        ends = [*self.starts[1:], len(self.columns)]
        for low, start, end in zip(self.low, self.starts, ends, strict=True):
            yield low, self.columns[start:end], self.values[start:end]


class Program:
    """x for each candidate, y for each demanded tag, f for each feeder of a port in a distinct group.

    All are at most 1, the x are whole. Raises InputError if there are feedback inputs.
    """

    def __init__(self, selection: Selection, lead: Lead | None) -> None:
        if any(port.feedback for candidate in selection.candidates for port in candidate.transformation.inputs):
            raise InputError.of(f"{selection.who} does not know feedback inputs")
        self.selection, self.rows = selection, Rows()
        self.scale = gcd(*(candidate.cost_us for candidate in selection.candidates)) or 1
        self.needs = [sorted({port.tag for port in c.transformation.inputs}) for c in selection.candidates]
        self.is_picky = any(p.distinct is not None for c in selection.candidates for p in c.transformation.inputs)
        self.closure = Closure(selection, self.needs)
        self.costs = [float(candidate.cost_us // self.scale) for candidate in selection.candidates]
        self._y: dict[str, int] = {}
        rows = self.rows
        for i in selection.kept:
            rows.some([i])
        for tag in dict.fromkeys([*selection.wanted, *(tag for tags in self.needs for tag in tags)]):
            self._y[tag] = self._column()
            rows.implies(self._y[tag], [i for i in selection.feeders(tag) if tag not in self.needs[i]])
        for tag in selection.wanted:
            rows.some([self._y[tag]])
        for i, tags in enumerate(self.needs):
            for tag in tags:
                rows.implies(i, [self._y[tag]])
            self._feed_from_different_ones(i, rows)
        if lead is not None:
            for least, members in lead.landmarks:
                rows.at_least(least, list(members), [float(count) for count in members.values()])
            for i in lead.dropped:
                rows.at_least(0, [i], [-1.0])

    def missed(self, chosen: list[int]) -> Rows:
        """Landmarks that these chosen miss: one of the ways in must be taken; or one of those outside a grown set."""
        rows = Rows()
        if self.is_picky:
            rows.some(self.selection.ways_in(chosen))
        else:
            for outside in self.closure.missed(chosen):
                rows.some(outside)
        return rows

    def _column(self) -> int:
        self.costs.append(0.0)
        return len(self.costs) - 1

    def _feed_from_different_ones(self, i: int, rows: Rows) -> None:
        picky = [port for port in self.selection.candidates[i].transformation.inputs if port.distinct is not None]
        taken: dict[tuple[str | None, str], list[int]] = defaultdict(list)
        for port in picky:
            by_label: dict[str, list[int]] = defaultdict(list)
            for feeder in self.selection.feeders(port.tag):
                by_label[self.selection.candidates[feeder].transformation.label].append(feeder)
            feeds = {label: self._column() for label in by_label}
            for label, feed in feeds.items():
                rows.implies(feed, by_label[label])
                taken[port.distinct, label].append(feed)
            rows.implies(i, list(feeds.values()))
        for columns in taken.values():
            rows.at_least(-1, columns, [-1.0] * len(columns))


class Closure:
    """What a growing set of units feeds from sources."""

    def __init__(self, selection: Selection, needs: Sequence[Collection[str]]) -> None:
        self._selection = selection
        self._needs = needs
        self._waiting: dict[str, list[int]] = defaultdict(list)
        self._feeds: dict[int, list[str]] = defaultdict(list)
        for i, tags in enumerate(needs):
            for tag in tags:
                self._waiting[tag].append(i)
        for tag in {*self._waiting, *selection.wanted}:
            for i in selection.feeders(tag):
                self._feeds[i].append(tag)
        costs = [candidate.cost_us for candidate in selection.candidates]
        self._cheap_last = sorted(range(len(costs)), key=lambda i: (-costs[i], i))
        self._goals = dict.fromkeys([*selection.wanted, *(tag for i in sorted(selection.kept) for tag in needs[i])])

    def missed(self, chosen: Collection[int]) -> list[list[int]]:
        """For each goal that the chosen miss, who is left out of a largest set around them that misses it too."""
        self._begin(chosen)
        missed = [goal for goal in self._goals if goal not in self._fed]
        left_out = []
        for goal in missed:
            self._begin(chosen)
            left_out.append([i for i in self._cheap_last if i not in self._members and not self._add_unless(i, goal)])
        return left_out

    def _begin(self, chosen: Collection[int]) -> None:
        self._fed: set[str] = set()
        self._members: set[int] = set()
        self._missing = [len(tags) for tags in self._needs]
        for i in chosen:
            self._add(i)

    def _add(self, i: int) -> list[str]:
        """Add a unit; returns the tags that are fed since."""
        self._members.add(i)
        new: list[str] = []
        ahead = [i] if self._missing[i] == 0 else []
        for unit in ahead:
            for tag in self._feeds[unit]:
                if tag not in self._fed:
                    self._fed.add(tag)
                    new.append(tag)
                    for above in self._waiting[tag]:
                        self._missing[above] -= 1
                        if self._missing[above] == 0 and above in self._members:
                            ahead.append(above)
        return new

    def _add_unless(self, i: int, goal: str) -> bool:
        """Add a unit unless the goal would be fed by it; returns whether it was added."""
        new = self._add(i)
        if goal not in self._fed:
            return True
        self._members.discard(i)
        for tag in new:
            self._fed.discard(tag)
            for above in self._waiting[tag]:
                self._missing[above] += 1
        return False
