"""Transformations and facts as arrays: the needs and offers of each label.

See `network` for the meaning of labels and facts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from heapq import heappop, heappush
from itertools import chain, combinations
from typing import TYPE_CHECKING, Final, TypeAlias, TypeVar

from cfgplan.onward import derivations
from cfgplan.planners.solving.arrays import np

if TYPE_CHECKING:
    import numpy.typing as npt

Ints: TypeAlias = "npt.NDArray[np.int64]"
Floats: TypeAlias = "npt.NDArray[np.float64]"
Flags: TypeAlias = "npt.NDArray[np.bool_]"
Number = TypeVar("Number", "np.int64", "np.float64")
Value = TypeVar("Value", int, float)

NEVER: Final = 2**60
"""A cost that no sum of real costs reaches."""
MOST_DEMANDS = 4
"""A group with more different demands has multi-facts for single ones, pairs and all together only."""
MOST_LISTED = 50
"""Up to this number of labels and facts, lists are faster than arrays."""
MOST_PASSES = 60
"""A core that takes more passes than this is deep: its facts are better followed one by one."""


class Rows:
    """Lists of integers. As arrays they stand one after the other: row i is `items[starts[i]:starts[i + 1]]`.

    Rows are made of arrays or `of` lists; the other form is computed when it is asked for.
    """

    def __init__(self, arrays: tuple[Ints, Ints] | None = None, lists: Sequence[list[int]] = ()) -> None:
        """The `arrays` are `starts` and `items`; without them the rows are the lists."""
        self._arrays, self._rows = arrays, lists

    @classmethod
    def of(cls, rows: Iterable[Iterable[int]]) -> Rows:
        return cls(lists=[list(row) for row in rows])

    @cached_property
    def starts(self) -> Ints:
        return _starts([len(row) for row in self._rows]) if self._arrays is None else self._arrays[0]

    @cached_property
    def items(self) -> Ints:
        if self._arrays is not None:
            return self._arrays[1]
        return np.fromiter(chain.from_iterable(self._rows), np.int64)

    def __len__(self) -> int:
        return len(self._rows) if self._arrays is None else len(self.starts) - 1

    def __getitem__(self, row: int) -> Ints:
        return self.items[self.starts[row] : self.starts[row + 1]]

    @cached_property
    def lists(self) -> Mapping[int, list[int]]:
        """The rows as plain lists; those of arrays are made when they are asked for."""
        return dict(enumerate(self._rows)) if self._arrays is None else _Lists(self)

    @cached_property
    def row_of_item(self) -> Ints:
        return np.repeat(np.arange(len(self)), np.diff(self.starts))

    def transposed(self, columns: int) -> Rows:
        """Row j holds the i whose row held j."""
        if self._arrays is None and max(len(self), columns) <= MOST_LISTED:
            turned: list[list[int]] = [[] for _ in range(columns)]
            for i, row in enumerate(self._rows):
                for j in row:
                    turned[j].append(i)
            return Rows(lists=turned)
        order = np.argsort(self.items, kind="stable")
        return Rows((_starts(np.bincount(self.items, minlength=columns)), self.row_of_item[order]))

    def restricted(self, rows: Flags, number: Ints) -> Rows:
        """The rows flagged, with their items renumbered; items whose new number is negative are left out."""
        items = number[self.items]
        stays = rows[self.row_of_item] & (items >= 0)
        counts = np.bincount(self.row_of_item[stays], minlength=len(self))[rows]
        return Rows((_starts(counts), items[stays]))


class _Lists(dict[int, list[int]]):
    def __init__(self, rows: Rows) -> None:
        self._rows = rows

    def __missing__(self, row: int) -> list[int]:
        found: list[int] = self._rows[row].tolist()
        self[row] = found
        return found


def _starts(counts: npt.ArrayLike) -> Ints:
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)


class MultiFacts:
    """The facts that take more than one provider; their providers are numbers below `labels`."""

    def __init__(self, facts: npt.NDArray[np.int64], takes: Sequence[int], providers: Sequence[list[int]], labels: int):
        self.facts = facts
        most = max(*map(len, providers), *takes)
        self._providers = np.array([row + [labels] * (most - len(row)) for row in providers])
        self._is_padded = bool((self._providers == labels).any())
        self._places = np.arange(len(takes)), np.array(takes) - 1

    def least(self, of_label: npt.NDArray[Number]) -> npt.NDArray[Number]:
        """For each of the facts the n-th least value of its providers, n being how many it takes."""
        values: npt.NDArray[Number] = self._sorted(of_label)[self._places]
        return values

    def least_sums(self, of_label: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """For each of the facts the least sum over as many providers as it takes."""
        sums: npt.NDArray[np.float64] = self._sorted(of_label).cumsum(axis=1)[self._places]
        return sums

    def _sorted(self, of_label: npt.NDArray[Number]) -> npt.NDArray[Number]:
        if self._is_padded:
            never = np.inf if of_label.dtype == np.float64 else np.iinfo(np.int64).max
            of_label = np.append(of_label, np.array(never, of_label.dtype))
        values: npt.NDArray[Number] = of_label[self._providers]
        values.sort(axis=1)
        return values


def multi_facts_of_group(inputs: Mapping[tuple[int, ...], int]) -> Iterator[tuple[tuple[int, ...], int]]:
    """Yield the facts of a distinct group that take several providers: the providers, and how many of them it takes.

    A group can be fed by different transformations if and only if any n of its inputs have at least n providers
    together (Hall 1935). `inputs` says how many inputs of the group each set of providers feeds.
    """
    sizes: Iterable[int] = range(1, len(inputs) + 1) if len(inputs) <= MOST_DEMANDS else (1, 2, len(inputs))
    for size in sizes:
        for together in combinations(inputs, size):
            providers = sorted(set().union(*together))
            if size == 1 or len(providers) < sum(map(len, together)):
                yield together[0] if size == 1 else tuple(providers), sum(inputs[one] for one in together)


@dataclass(frozen=True)
class Core:
    """`needs[label]` are facts, `providers[fact]` labels. The last label is the goal, which needs every target.

    If it is a part of a network, `numbers` are those of its labels and of its facts in the whole. A fact holds when at
    least `takes` of its providers are chosen; if `takes` is None, one is enough for every fact.
    """

    needs: Rows
    providers: Rows
    numbers: tuple[Ints, Ints] | None = None
    takes: Ints | None = None

    @property
    def goal(self) -> int:
        return len(self.needs) - 1

    @cached_property
    def labels(self) -> Ints:
        """The numbers of the labels in the whole network."""
        return np.arange(self.goal) if self.numbers is None else self.numbers[0]

    @cached_property
    def facts(self) -> Ints:
        """The numbers of the facts in the whole network."""
        return np.arange(len(self.providers)) if self.numbers is None else self.numbers[1]

    @property
    def is_small(self) -> bool:
        """Whether lists serve it better than arrays."""
        return max(len(self.needs), len(self.providers)) <= MOST_LISTED

    def in_whole(self, labels: Iterable[int]) -> list[int]:
        """The numbers that these labels have in the whole network."""
        return list(labels) if self.numbers is None else self.numbers[0][list(labels)].tolist()

    @property
    def links(self) -> int:
        """How many offers and needs there are."""
        return len(self.providers.items) + len(self.needs.items)

    @property
    def choices(self) -> int:
        """The number of needed facts that have more providers than they take."""
        leaves_a_choice = np.diff(self.providers.starts) > (1 if self.takes is None else self.takes)
        is_needed = np.zeros(len(self.providers), bool)  # np.unique would import numpy.ma
        is_needed[self.needs.items] = True
        return int((leaves_a_choice & is_needed).sum())

    @cached_property
    def is_deep(self) -> bool:
        """Whether some fact that can be had is behind more than `MOST_PASSES` others."""
        facts = np.full(len(self.providers), NEVER)
        for _ in range(MOST_PASSES):
            better = self.least_of_givers(self.most_of_needs(facts)[:-1])
            if (better == facts).all():
                return False
            facts = better
        return True

    @property
    def deep_links(self) -> int:
        """How many links have to be followed one by one, since the core is deep."""
        return self.links if self.is_deep else 0

    @cached_property
    def multi_facts(self) -> MultiFacts | None:
        """The facts that take more than one provider; None if there are none."""
        if self.takes is None or not len(facts := np.flatnonzero(self.takes > 1)):
            return None
        providers = [self.providers[fact].tolist() for fact in facts.tolist()]
        return MultiFacts(facts, self.takes[facts].tolist(), providers, self.goal)

    @cached_property
    def multi_takes(self) -> dict[int, int]:
        """How many providers each fact of `multi_facts` takes, by fact."""
        if self.takes is None or self.multi_facts is None:
            return {}
        return {fact: int(self.takes[fact]) for fact in self.multi_facts.facts.tolist()}

    @cached_property
    def gives(self) -> Rows:
        return self.providers.transposed(self.goal + 1)

    @cached_property
    def needed_by(self) -> Rows:
        return self.needs.transposed(len(self.providers))

    @cached_property
    def _fed(self) -> Ints:
        """The labels that need something at all."""
        return np.flatnonzero(np.diff(self.needs.starts))

    @cached_property
    def _giving(self) -> Ints:
        """The labels that give something at all."""
        return np.flatnonzero(np.diff(self.gives.starts))

    def most_of_needs(self, of_fact: Ints) -> Ints:
        """For each label the greatest value of the facts it needs; 0 for sources."""
        return _joined(np.maximum, self.needs, self._fed, of_fact, 0)

    def most_of_offers(self, of_fact: Ints) -> Ints:
        """For each label the greatest value of the facts that it offers; 0 if it offers none."""
        return _joined(np.maximum, self.gives, self._giving, of_fact, 0)

    def needs_with(self, of_fact: npt.NDArray[Number], of_label: npt.NDArray[Number]) -> tuple[Ints, Ints]:
        """The labels that need something, and for each the first of its needs that has the label's value."""
        items = np.flatnonzero(of_fact[self.needs.items] == of_label[self.needs.row_of_item])
        first = items[np.diff(self.needs.row_of_item[items], prepend=-1) > 0]
        return self._fed, self.needs.items[first]

    def sum_of_needs(self, of_fact: Floats) -> Floats:
        """For each label the sum over the facts it needs."""
        return _joined(np.add, self.needs, self._fed, of_fact, 0)

    def least_of_needs(self, of_fact: Floats) -> Floats:
        """For each label the least value of the facts it needs; 1 for sources."""
        return _joined(np.minimum, self.needs, self._fed, of_fact, 1)

    def share_of_givers(self, of_label: Floats) -> Floats:
        """For each fact the sum over the labels that offer it, divided by how many it takes."""
        if not len(self.providers):
            return np.zeros(0)
        total: Floats = np.add.reduceat(of_label[self.providers.items], self.providers.starts[:-1])
        return total if self.takes is None else total / self.takes

    def least_sum_of_givers(self, of_label: Floats) -> Floats:
        """For each fact the least sum over as many of its providers as it takes. Every fact must have providers."""
        least = self.least_of_givers(of_label)
        if self.multi_facts is not None:
            least[self.multi_facts.facts] = self.multi_facts.least_sums(of_label)
        return least

    def least_of_givers(self, of_label: npt.NDArray[Number]) -> npt.NDArray[Number]:
        """For each fact the n-th least value of its providers, n being how many it takes.

        Every fact must have providers.
        """
        if not len(self.providers):
            return np.zeros(0, of_label.dtype)
        least: npt.NDArray[Number] = np.minimum.reduceat(of_label[self.providers.items], self.providers.starts[:-1])
        if self.multi_facts is not None:
            least[self.multi_facts.facts] = self.multi_facts.least(of_label)
        return least

    def facts_one_by_one(self, price: Sequence[Value], join: Callable[[list[Value]], Value]) -> dict[int, Value]:
        """The cost of each fact that can be reached; facts are settled cheapest first, each once (Knuth 1977).

        A label costs its price plus `join` of its needs; a fact that takes several providers costs `join` of theirs.
        """
        needs, gives, takes = self.needs.lists, self.gives.lists, self.multi_takes
        missing = [len(needs[label]) for label in range(self.goal)] + [0]  # the goal gives nothing
        facts: dict[int, Value] = {}
        offers: dict[int, list[Value]] = {fact: [] for fact in takes}
        ahead: list[tuple[Value, int, bool]] = []  # the flag: True if it is the fact's value, False for one offer

        def settled() -> Iterator[int]:
            while ahead:
                value, fact, is_whole = heappop(ahead)
                if is_whole:
                    if fact not in facts:
                        facts[fact] = value
                        yield fact
                elif len(offers[fact]) < takes[fact]:
                    offers[fact].append(value)
                    if len(offers[fact]) == takes[fact]:
                        heappush(ahead, (join(offers[fact]), fact, True))

        sources = [label for label in range(self.goal) if not missing[label]]
        for label in chain(sources, (label for label, _ in derivations(settled(), self.needed_by.lists, missing))):
            cost = join([facts[fact] for fact in needs[label]] or [price[label] * 0]) + price[label]
            for fact in gives[label]:
                heappush(ahead, (cost, fact, fact not in takes))
        return facts

    def restricted(self, keep: Flags) -> Core:
        """Return the part with the flagged labels and the facts they need; every need of a kept label must be kept."""
        stays = np.append(keep, True)
        needed = np.zeros(len(self.providers), np.bool_)
        needed[self.needs.items[stays[self.needs.row_of_item]]] = True
        label_number = np.where(keep, np.cumsum(keep) - 1, -1)
        fact_number = np.where(needed, np.cumsum(needed) - 1, -1)
        return Core(
            self.needs.restricted(stays, fact_number),
            self.providers.restricted(needed, label_number),
            (self.labels[keep], self.facts[needed]),
            None if self.takes is None else self.takes[needed],
        )


def _joined(by: np.ufunc, rows: Rows, filled: Ints, of_item: npt.NDArray[Number], empty: int) -> npt.NDArray[Number]:
    """For each row the values of its items, joined; `empty` for rows that are not `filled`."""
    value = np.full(len(rows), empty, of_item.dtype)
    if len(filled):
        value[filled] = by.reduceat(of_item[rows.items], rows.starts[filled])
    return value
