"""The problem over transformations as arrays: what each needs and offers.

For least cost alone one unit of each transformation is enough, so the problem is one of *labels*:
choose a set of them, grounded, that meets the targets. A *fact* is a demand (merged with all demands
that the same transformations can meet): "somebody offers this", or "so many do" for the inputs of a distinct
group (`crowds`). Feedback inputs are left out: bounds stay valid.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from cfgplan.costs import keep_cost_us, start_cost_us
from cfgplan.domain import Transformation
from cfgplan.planners.cpsat.crowds import Crowds, crowds_of_group
from cfgplan.planning import Problem
from cfgplan.reasons import Givers, distinct_groups

Ints = npt.NDArray[np.int64]
Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
Number = TypeVar("Number", np.int64, np.float64)

NEVER = np.int64(2**60)
"""A cost that no sum of real costs reaches."""


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


@dataclass(frozen=True)
class Core:
    """`needs[label]` are facts, `givers[fact]` labels. The last label is the goal, which needs all that is wanted.

    `labels` and `facts` are the numbers that they have in the network of which this is a part. So many givers
    as a fact `takes` must be there for it to hold; None if one is enough everywhere.
    """

    needs: Rows
    givers: Rows
    labels: Ints
    facts: Ints
    takes: Ints | None = None

    @property
    def goal(self) -> int:
        return len(self.labels)

    @cached_property
    def crowds(self) -> Crowds | None:
        """The facts that take more than one giver, if there are any."""
        facts = np.flatnonzero(self.takes > 1) if self.takes is not None else np.zeros(0, np.int64)
        if self.takes is None or not len(facts):
            return None
        givers = [self.givers[fact].tolist() for fact in facts.tolist()]
        return Crowds(facts, self.takes[facts].tolist(), givers, self.goal)

    @cached_property
    def crowd_takes(self) -> dict[int, int]:
        """How many givers they take."""
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
        return _most(self.needs, self._fed, of_fact)

    def most_of_gifts(self, of_fact: Ints) -> Ints:
        """For each label the greatest value of the facts it gives; 0 if it gives none."""
        return _most(self.gives, self._giving, of_fact)

    def needs_with(self, of_fact: npt.NDArray[Number], of_label: npt.NDArray[Number]) -> tuple[Ints, Ints]:
        """The labels that need something, and for each the first of its needs that has the label's value."""
        items = np.flatnonzero(of_fact[self.needs.items] == of_label[self.needs.row_of_item])
        first = items[np.diff(self.needs.row_of_item[items], prepend=-1) > 0]
        return self._fed, self.needs.items[first]

    def sum_of_needs(self, of_fact: Floats) -> Floats:
        """For each label the sum over the facts it needs."""
        value = np.zeros(self.goal + 1)
        if len(self._fed):
            value[self._fed] = np.add.reduceat(of_fact[self.needs.items], self.needs.starts[self._fed])
        return value

    def least_of_needs(self, of_fact: Floats) -> Floats:
        """For each label the least value of the facts it needs; 1 for sources."""
        value = np.ones(self.goal + 1)
        if len(self._fed):
            value[self._fed] = np.minimum.reduceat(of_fact[self.needs.items], self.needs.starts[self._fed])
        return value

    def share_of_givers(self, of_label: Floats) -> Floats:
        """For each fact the sum over the labels that offer it, divided by how many it takes."""
        if not len(self.givers):
            return np.zeros(0)
        total: Floats = np.add.reduceat(of_label[self.givers.items], self.givers.starts[:-1])
        return total if self.takes is None else total / self.takes

    def least_sum_of_givers(self, of_label: Floats) -> Floats:
        """For each fact the least sum over as many labels that offer it as it takes; every fact has such labels."""
        least = self.least_of_givers(of_label)
        if self.crowds is not None:
            least[self.crowds.facts] = self.crowds.least_sums(of_label)
        return least

    def least_of_givers(self, of_label: npt.NDArray[Number]) -> npt.NDArray[Number]:
        """For each fact the least value that as many labels that offer it as it takes do not exceed.

        Every fact has labels that offer it.
        """
        if not len(self.givers):
            return np.zeros(0, of_label.dtype)
        least: npt.NDArray[Number] = np.minimum.reduceat(of_label[self.givers.items], self.givers.starts[:-1])
        if self.crowds is not None:
            least[self.crowds.facts] = self.crowds.least(of_label)
        return least

    def restricted(self, keep: Flags) -> Core:
        """The part with the labels flagged and the facts they need; what a kept label needs must be kept."""
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


def _most(rows: Rows, filled: Ints, of_item: Ints) -> Ints:
    """For each row the greatest value of its items; 0 for those that are not filled."""
    value = np.zeros(len(rows), np.int64)
    if len(filled):
        value[filled] = np.maximum.reduceat(of_item[rows.items], rows.starts[filled])
    return value


class Graph:
    """A core by itself: labels without names, of which none has to run, and no distinct or feedback inputs.

    `special` are the labels with distinct or feedback inputs, `pinned` those that have to run.
    """

    def __init__(self, core: Core) -> None:
        self.core = core
        self.transformations: Sequence[Transformation] = ()
        self.labels: list[str] = []
        self.number: dict[str, int] = {}
        self.fact_of_tag: dict[str, int] = {}
        self.pinned: list[int] = []
        self.special: frozenset[int] = frozenset()


class Network(Graph):
    """The core of a problem with the names of its labels and the facts of its tags."""

    def __init__(
        self,
        library: Sequence[Transformation],
        targets: Iterable[str],
        pinned: Iterable[str],
        rows: Givers,
    ) -> None:
        self.transformations = library
        self.targets = list(targets)
        self.labels = [transformation.label for transformation in library]
        self.number = {label: i for i, label in enumerate(self.labels)}
        self.fact_of_tag: dict[str, int] = {}
        facts: dict[tuple[tuple[int, ...], int], int] = {}
        givers_of_tag: dict[str, tuple[int, ...]] = {}

        def fact(tag: str) -> int:
            if tag not in self.fact_of_tag:
                rows.watch()
                givers = givers_of_tag[tag] = tuple([self.number[i] for i in rows.of(tag) if i in self.number])
                self.fact_of_tag[tag] = facts.setdefault((givers, 1), len(facts))
            return self.fact_of_tag[tag]

        needs = [{fact(port.tag) for port in t.inputs if not port.feedback} for t in library]
        self.special = frozenset(
            i for i, t in enumerate(library) if any(port.feedback or port.distinct is not None for port in t.inputs)
        )
        for label, group in ((i, group) for i in sorted(self.special) for group in distinct_groups(library[i])):
            alike = Counter(givers_of_tag[port.tag] for port in group if not port.feedback)
            for givers, takes in crowds_of_group(alike):
                if takes > 1:
                    needs[label] -= {facts.get((givers, 1), -1)}
                    needs[label].add(facts.setdefault((givers, takes), len(facts)))
        for port in (port for t in library for port in t.inputs if port.feedback):
            fact(port.tag)
        self.pinned = sorted(self.number[label] for label in pinned)
        wanted = {fact(tag) for tag in self.targets}.union(*(needs[label] for label in self.pinned))
        taking = np.array([takes for _, takes in facts], np.int64)
        self.core = Core(
            Rows.of([sorted(row) for row in (*needs, wanted)]),
            Rows.of([givers for givers, _ in facts]),
            np.arange(len(library)),
            np.arange(len(facts)),
            taking if (taking > 1).any() else None,
        )


def costs(problem: Problem, network: Network, pinned: Collection[str]) -> tuple[int, Ints]:
    """What units of the network's pinned labels cost whatever is planned, and what each label costs beyond that.

    Of those in `pinned` all running units are kept, of others one is enough.
    """
    running: dict[str, int] = {}
    for unit in problem.environment.units:
        running[unit.transformation] = running.get(unit.transformation, 0) + 1
    library = problem.environment.transformation
    cost = np.fromiter(
        (
            (keep_cost_us if label in running else start_cost_us)(library[label], problem.horizon_s)
            for label in network.labels
        ),
        np.int64,
        len(network.labels),
    )
    times = {i: running[network.labels[i]] if network.labels[i] in pinned else 1 for i in network.pinned}
    fixed_us = sum(times[i] * int(cost[i]) for i in network.pinned)
    cost[network.pinned] = 0
    return fixed_us, cost
