"""Transformations and facts as arrays: the needs and offers of each label.

See `network` for the meaning of labels and facts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from heapq import heappop, heappush
from itertools import chain, combinations
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from cfgplan.frozen import dataclass

Ints = npt.NDArray[np.int64]
Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
Number = TypeVar("Number", np.int64, np.float64)

NEVER = np.int64(2**60)
"""A cost that no sum of real costs reaches."""
MOST_CROWDS = 4
"""A group that asks for more different things has crowds for single ones, pairs and all together only."""
MOST_PASSES = 60
"""A core that takes more passes than this is deep: its facts are better followed one by one."""


@dataclass(frozen=True)
class Rows:
    """Lists of integers, one after the other: row i is `items[starts[i]:starts[i + 1]]`."""

    starts: Ints
    items: Ints

    @classmethod
    def of(cls, rows: Sequence[Iterable[int]]) -> Rows:
        lists = [list(row) for row in rows]
        items = np.fromiter(chain.from_iterable(lists), np.int64)
        return cls(_starts([len(row) for row in lists]), items)

    def __len__(self) -> int:
        return len(self.starts) - 1

    def __getitem__(self, row: int) -> Ints:
        return self.items[self.starts[row] : self.starts[row + 1]]

    @cached_property
    def lists(self) -> dict[int, list[int]]:
        """The rows as plain lists, each made when it is asked for."""
        return _Lists(self)

    @cached_property
    def row_of_item(self) -> Ints:
        return np.repeat(np.arange(len(self)), np.diff(self.starts))

    def transposed(self, columns: int) -> Rows:
        """Row j holds the i whose row held j."""
        order = np.argsort(self.items, kind="stable")
        return Rows(_starts(np.bincount(self.items, minlength=columns)), self.row_of_item[order])

    def restricted(self, rows: Flags, number: Ints) -> Rows:
        """The rows flagged, with their items renumbered; items whose new number is negative are left out."""
        items = number[self.items]
        stays = rows[self.row_of_item] & (items >= 0)
        counts = np.bincount(self.row_of_item[stays], minlength=len(self))[rows]
        return Rows(_starts(counts), items[stays])


class _Lists(dict[int, list[int]]):
    def __init__(self, rows: Rows) -> None:
        self._rows = rows

    def __missing__(self, row: int) -> list[int]:
        found: list[int] = self._rows[row].tolist()
        self[row] = found
        return found


def _starts(counts: npt.ArrayLike) -> Ints:
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)


class Crowds:
    """The facts that take more than one giver; their givers are numbers below `labels`."""

    def __init__(self, facts: npt.NDArray[np.int64], takes: Sequence[int], givers: Sequence[list[int]], labels: int):
        self.facts = facts
        most = max(*map(len, givers), *takes)
        self._givers = np.array([row + [labels] * (most - len(row)) for row in givers])
        self._is_padded = bool((self._givers == labels).any())
        self._places = np.arange(len(takes)), np.array(takes) - 1

    def least(self, of_label: npt.NDArray[Number]) -> npt.NDArray[Number]:
        """For each of the facts the n-th least value of its givers, n being how many it takes."""
        values: npt.NDArray[Number] = self._sorted(of_label)[self._places]
        return values

    def least_sums(self, of_label: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """For each of the facts the least sum over as many givers as it takes."""
        sums: npt.NDArray[np.float64] = self._sorted(of_label).cumsum(axis=1)[self._places]
        return sums

    def _sorted(self, of_label: npt.NDArray[Number]) -> npt.NDArray[Number]:
        if self._is_padded:
            never = np.inf if of_label.dtype == np.float64 else np.iinfo(np.int64).max
            of_label = np.append(of_label, np.array(never, of_label.dtype))
        values: npt.NDArray[Number] = of_label[self._givers]
        values.sort(axis=1)
        return values


def crowds_of_group(inputs: Mapping[tuple[int, ...], int]) -> Iterator[tuple[tuple[int, ...], int]]:
    """The crowds of a distinct group: givers, and how many of them it takes.

    A group can be fed by different transformations if and only if any n of its inputs have at least n givers together
    (Hall 1935). `inputs` says how many inputs of the group each set of givers feeds.
    """
    sizes: Iterable[int] = range(1, len(inputs) + 1) if len(inputs) <= MOST_CROWDS else (1, 2, len(inputs))
    for size in sizes:
        for together in combinations(inputs, size):
            givers = sorted(set().union(*together))
            if size == 1 or len(givers) < sum(map(len, together)):
                yield together[0] if size == 1 else tuple(givers), sum(inputs[one] for one in together)


@dataclass(frozen=True)
class Core:
    """`needs[label]` are facts, `givers[fact]` labels. The last label is the goal, which needs every target.

    `labels` and `facts` are the numbers that they have in the whole network. A fact holds when at least `takes` of its
    givers are chosen; if `takes` is None, one is enough for every fact.
    """

    needs: Rows
    givers: Rows
    labels: Ints
    facts: Ints
    takes: Ints | None = None

    @property
    def goal(self) -> int:
        return len(self.labels)

    @property
    def links(self) -> int:
        """How many offers and needs there are."""
        return len(self.givers.items) + len(self.needs.items)

    @cached_property
    def is_deep(self) -> bool:
        """Whether some fact that can be had is behind more than `MOST_PASSES` others."""
        facts = np.full(len(self.givers), NEVER)
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
    def crowds(self) -> Crowds | None:
        """The facts that take more than one giver; None if there are none."""
        facts = np.flatnonzero(self.takes > 1) if self.takes is not None else np.zeros(0, np.int64)
        if self.takes is None or not len(facts):
            return None
        givers = [self.givers[fact].tolist() for fact in facts.tolist()]
        return Crowds(facts, self.takes[facts].tolist(), givers, self.goal)

    @cached_property
    def crowd_takes(self) -> dict[int, int]:
        """How many givers each fact of `crowds` takes."""
        if self.takes is None or self.crowds is None:
            return {}
        return {fact: int(self.takes[fact]) for fact in self.crowds.facts.tolist()}

    @cached_property
    def gives(self) -> Rows:
        return self.givers.transposed(self.goal + 1)

    @cached_property
    def needed_by(self) -> Rows:
        return self.needs.transposed(len(self.givers))

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

    def most_of_gifts(self, of_fact: Ints) -> Ints:
        """For each label the greatest value of the facts it gives; 0 if it gives none."""
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
        if not len(self.givers):
            return np.zeros(0)
        total: Floats = np.add.reduceat(of_label[self.givers.items], self.givers.starts[:-1])
        return total if self.takes is None else total / self.takes

    def least_sum_of_givers(self, of_label: Floats) -> Floats:
        """For each fact the least sum over as many of its givers as it takes. Every fact must have givers."""
        least = self.least_of_givers(of_label)
        if self.crowds is not None:
            least[self.crowds.facts] = self.crowds.least_sums(of_label)
        return least

    def least_of_givers(self, of_label: npt.NDArray[Number]) -> npt.NDArray[Number]:
        """For each fact the n-th least value of its givers, n being how many it takes.

        Every fact must have givers.
        """
        if not len(self.givers):
            return np.zeros(0, of_label.dtype)
        least: npt.NDArray[Number] = np.minimum.reduceat(of_label[self.givers.items], self.givers.starts[:-1])
        if self.crowds is not None:
            least[self.crowds.facts] = self.crowds.least(of_label)
        return least

    def facts_one_by_one(self, price: Sequence[Number], join: Callable[[list[Number]], Number]) -> dict[int, Number]:
        """The cost of each fact that can be reached; facts are settled cheapest first, each once (Knuth 1977).

        A label costs its price plus `join` of its needs; a fact that takes several givers costs `join` of theirs.
        """
        needs, gives, needed_by, takes = self.needs.lists, self.gives.lists, self.needed_by.lists, self.crowd_takes
        missing = {label: len(needs[label]) for label in range(self.goal)}
        facts: dict[int, Number] = {}
        offers: dict[int, list[Number]] = {fact: [] for fact in takes}
        ahead: list[tuple[Number, int]] = []
        ready = [label for label, count in missing.items() if not count]
        while True:
            for label in ready:
                cost = join([facts[fact] for fact in needs[label]] or [price[label] * 0]) + price[label]
                for fact in gives[label]:
                    heappush(ahead, (cost, fact))
            ready = []
            if not ahead:
                return facts
            value, fact = heappop(ahead)
            if fact in offers:
                offers[fact].append(value)
                if len(offers[fact]) == takes[fact]:
                    heappush(ahead, (join(offers.pop(fact)), fact))
            elif fact not in facts:
                facts[fact] = value
                for label in needed_by[fact]:
                    missing[label] = missing.get(label, 0) - 1
                    if not missing[label]:
                        ready.append(label)

    def restricted(self, keep: Flags) -> Core:
        """Return the part with the flagged labels and the facts they need; every need of a kept label must be kept."""
        stays = np.append(keep, True)
        needed = np.zeros(len(self.givers), np.bool_)
        needed[self.needs.items[stays[self.needs.row_of_item]]] = True
        label_number = np.where(keep, np.cumsum(keep) - 1, -1)
        fact_number = np.where(needed, np.cumsum(needed) - 1, -1)
        return Core(
            self.needs.restricted(stays, fact_number),
            self.givers.restricted(needed, label_number),
            self.labels[keep],
            self.facts[needed],
            None if self.takes is None else self.takes[needed],
        )


def _joined(by: np.ufunc, rows: Rows, filled: Ints, of_item: npt.NDArray[Number], empty: int) -> npt.NDArray[Number]:
    """For each row the values of its items, joined; `empty` for rows that are not `filled`."""
    value = np.full(len(rows), empty, of_item.dtype)
    if len(filled):
        value[filled] = by.reduceat(of_item[rows.items], rows.starts[filled])
    return value
