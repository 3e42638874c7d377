"""The problem as an integer program over units and demanded tags, with landmarks added for ungrounded units."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from math import gcd

from cfgplan.errors import InputError
from experiments.peers.counting import Counting, Where
from experiments.peers.lead import Lead
from experiments.peers.placing import Placing
from experiments.peers.selection import Selection


@dataclass
class Rows:
    """Linear constraints `low <= sum(value * column)`, in HiGHS's compressed form for adding many rows."""

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
        """Add the constraint `column <= sum(others)`."""
        self.at_least(0, [*others, column], [1.0] * len(others) + [-1.0])

    def some(self, columns: Sequence[int]) -> None:
        self.at_least(1, columns, [1.0] * len(columns))

    def each(self) -> Iterable[tuple[float, list[int], list[float]]]:
        """Yield the lower bound, columns and coefficients of each row."""
        ends = [*self.starts[1:], len(self.columns)]
        for low, start, end in zip(self.low, self.starts, ends, strict=True):
            yield low, self.columns[start:end], self.values[start:end]


class Program:
    """x for each candidate, y for each demanded tag, f for each feeder of a port in a distinct group.

    All are between 0 and 1; the x are integers. Raises InputError for feedback inputs.
    """

    def __init__(self, selection: Selection, lead: Lead | None) -> None:
        if any(port.feedback for candidate in selection.candidates for port in candidate.transformation.inputs):
            raise InputError.of(f"{selection.who} does not support feedback inputs")
        self.selection, self.rows = selection, Rows()
        self.scale = gcd(*(candidate.cost_us for candidate in selection.candidates)) or 1
        self.needs = _needs(selection)
        self.is_picky = any(p.distinct is not None for c in selection.candidates for p in c.transformation.inputs)
        self.closure = Closure(selection, self.needs)
        self.placing = selection if isinstance(selection, Placing) else None
        self.costs = [float(candidate.cost_us // self.scale) for candidate in selection.candidates]
        self.most = [1] * len(self.costs)
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
        for limit in (*selection.limits, *selection.implied):
            rows.at_least(-limit.most, list(limit.takes), [-float(each) for each in limit.takes.values()])
        if lead is not None:
            for least, members in lead.landmarks:
                rows.at_least(least, list(members), [float(count) for count in members.values()])
            for i in lead.dropped:
                rows.at_least(0, [i], [-1.0])

    def missed(self, chosen: list[int]) -> Rows:
        """Return the landmarks that the chosen units miss, as rows.

        A row requires a unit of `ways_in`, or a unit outside a largest set that still misses a goal. For a fleet,
        landmarks of the problem without hosts are added.
        """
        rows = Rows()
        if self.placing is not None:
            hostless = Closure(self.placing.hostless, _needs(self.placing.hostless))
            for outside in hostless.missed(self.placing.kinds(chosen)):
                rows.some(self.placing.places(outside))
        if self.is_picky:
            rows.some(self.selection.ways_in(chosen))
        else:
            for outside in self.closure.missed(chosen):
                rows.some(outside)
        return rows

    def one_of_alike(self) -> Rows:
        """Return rows that let at most one of several new units run that meet the same demands.

        `cpsat` has the same. They follow for optima, not for fractions. A fleet has none, since its units also differ
        by their hosts.
        """
        rows = Rows()
        candidates = self.selection.candidates
        apart = {port.tag for each in candidates for port in each.transformation.inputs if port.distinct is not None}
        different = {i for tag in apart for i in self.selection.feeders(tag)}
        alike: dict[tuple[str, ...], list[int]] = defaultdict(list)
        for i, demands in self.closure.feeds.items() if self.placing is None else ():
            if candidates[i].running is None and i not in different:
                alike[tuple(demands)].append(i)
        for units in alike.values():
            if len(units) > 1:
                rows.at_least(-1, units, [-1.0] * len(units))
                sharing: dict[str, list[int]] = defaultdict(list)
                for i in units:
                    for tag in self.needs[i]:
                        sharing[tag].append(i)
                for tag, shared in sharing.items():
                    rows.at_least(0, [self._y[tag], *shared], [1.0] + [-1.0] * len(shared))
        return rows

    def _column(self) -> int:
        self.costs.append(0.0)
        self.most.append(1)
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


def _needs(selection: Selection) -> list[list[str]]:
    """The tags that each candidate demands."""
    return [sorted({port.tag for port in c.transformation.inputs}) for c in selection.candidates]


class NumberProgram:
    """An integer program over the number of units of each transformation on each host.

    Binary variables say whether a number is positive, whether a host is used, and whether a transformation runs.

    Among identical hosts the first ones are used.
    """

    def __init__(self, counting: Counting) -> None:
        environment, self.rows = counting.problem.environment, Rows()
        self.costs: list[float] = []
        self.most: list[int] = []
        self.scale = gcd(*map(counting.cost_us, counting.most), *counting.rents_us.values()) or 1
        self.at = {w: self._column(most, counting.cost_us(w) // self.scale) for w, most in counting.most.items()}
        self._used = {host: self._column(1, us // self.scale) for host, us in counting.rents_us.items()}
        self._has = {w: self._column(1) if most > 1 else self.at[w] for w, most in counting.most.items()}
        self._of: dict[str, list[int]] = defaultdict(list)
        for (label, host), has in self._has.items():
            number, most = self.at[label, host], counting.most[label, host]
            self._of[label].append(number)
            self._at_most(0, {self._used[host]: -1}, {has: 1})
            if has != number:
                self._at_most(0, {number: -1}, {has: 1})
                self._at_most(0, {has: -most}, {number: 1})
        for resource, host in product(counting.resources, self._used):
            room = counting.room(host, resource)
            taken = {at: counting.takes(w).get(resource, 0) for w, at in self.at.items() if w[1] == host}
            if room is not None:
                self._at_most(0, {self._used[host]: -room}, taken)
        for one, other in counting.alike():
            self._at_most(0, {self._used[one]: -1}, {self._used[other]: 1})
        self._runs = {label: self._column(1) for label in counting.kinds}
        for label, units in counting.kinds.items():
            numbers, least = self._of[label], counting.kind(label).min_instances
            self._at_most(-least, dict.fromkeys(numbers, -1))
            self._at_most(0, {self._runs[label]: -len(units)}, dict.fromkeys(numbers, 1))
            self._keep_company(counting, label)
            for port in counting.kind(label).inputs:
                self._at_most(0, {self._runs[label]: port.count}, self._fewer(counting, port.tag))
        for target in environment.targets:
            self._at_most(-1, self._fewer(counting, target.tag))
        for (label, port), serves in counting.limited():
            taken: dict[int, int] = defaultdict(int, dict.fromkeys(self._of[label], -serves))
            targets = 0
            for taker, count in counting.takers((label, port)):
                targets += 0 if taker else count
                for number in self._of[taker] if taker else ():
                    taken[number] += count
            self._at_most(-targets, taken)

    def numbers(self, values: Sequence[float]) -> dict[Where, int]:
        """Return the number of units by transformation and host, from the values of the variables."""
        return {where: number for where, column in self.at.items() if (number := round(values[column]))}

    def _keep_company(self, counting: Counting, label: str) -> None:
        company = counting.company(label)
        for other in company["conflict"]:
            self._at_most(1, {self._runs[label]: 1, self._runs[other]: 1})
        for (_, host), has in [(where, has) for where, has in self._has.items() if where[0] == label]:
            for other in company["conflict_on_host"]:
                if (other, host) in self._has:
                    self._at_most(0, {has: 1, self._has[other, host]: 1, self._used[host]: -1})
            for other in company["beside"]:
                self._at_most(0, {has: 1}, {self._has[other, host]: -1} if (other, host) in self._has else {})

    def _fewer(self, counting: Counting, tag: str) -> dict[int, int]:
        """Return minus the number of units that give a demanded tag, as coefficients."""
        providers = {label for label, _ in counting.providers(tag)}
        return {number: -1 for label in providers for number in self._of[label]}

    def _at_most(self, most: int, *terms: Mapping[int, int]) -> None:
        columns = {column: value for each in terms for column, value in each.items()}
        self.rows.at_least(-most, list(columns), [-float(value) for value in columns.values()])

    def _column(self, most: int, cost: int = 0) -> int:
        self.costs.append(float(cost))
        self.most.append(most)
        return len(self.costs) - 1


class Closure:
    """The tags that a growing set of units feeds from sources."""

    def __init__(self, selection: Selection, needs: Sequence[Collection[str]]) -> None:
        self._selection = selection
        self._needs = needs
        self._waiting: dict[str, list[int]] = defaultdict(list)
        self.feeds: dict[int, list[str]] = defaultdict(list)
        """The demanded tags that each unit meets, in one order for all."""
        for i, tags in enumerate(needs):
            for tag in tags:
                self._waiting[tag].append(i)
        for tag in sorted({*self._waiting, *selection.wanted}):
            for i in selection.feeders(tag):
                self.feeds[i].append(tag)
        costs = [candidate.cost_us for candidate in selection.candidates]
        self._cheap_last = sorted(range(len(costs)), key=lambda i: (-costs[i], i))
        self._goals = dict.fromkeys([*selection.wanted, *(tag for i in sorted(selection.kept) for tag in needs[i])])

    def missed(self, chosen: Collection[int]) -> list[list[int]]:
        """Return, for each goal that the chosen units miss, the units outside a largest superset that misses it too."""
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
            for tag in self.feeds[unit]:
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
