"""Rows of the linear program that say how used labels are fed.

A fact is needed as much as labels that need it are used, and offered as much as its givers are used; labels that are
alike need it together. The prices of these rows are moved from facts to labels (Lagrangian relaxation: Geoffrion 1974).
Whatever the prices are, landmarks may be charged at the costs that are left.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cfgplan.planners.networks.core import Core, Ints

if TYPE_CHECKING:
    from ortools.linear_solver import pywraplp  # type: ignore[import-untyped]


class Feeding:
    """The feeding rows of a core in an engine; `uses` says how much of each label is used."""

    def __init__(self, core: Core, kinds: Ints, engine: pywraplp.Solver, uses: list[pywraplp.Variable]) -> None:
        self._core = core
        needers = np.flatnonzero(core.needs.row_of_item < core.goal)
        labels, facts = core.needs.row_of_item[needers], core.needs.items[needers]
        pairs, self._pair = np.unique(kinds[labels] * len(core.givers) + facts, return_inverse=True)
        self._labels, self._needed = labels, pairs % len(core.givers)
        loops = np.isin(
            core.givers.row_of_item * core.goal + core.givers.items,
            facts * core.goal + labels,
        )
        self._fact_of_offer, self._offering = core.givers.row_of_item[~loops], core.givers.items[~loops]
        self._takes = np.ones(len(core.givers), np.int64) if core.takes is None else core.takes
        infinity = engine.infinity()
        wanted = set(core.needs[core.goal].tolist())
        needed = [
            engine.NumVar(float(i in wanted), 1.0 if i in wanted else infinity, "") for i in range(len(core.givers))
        ]
        self._offered = [engine.RowConstraint(0.0, infinity, "") for _ in needed]
        for row, needs, takes in zip(self._offered, needed, self._takes.tolist(), strict=True):
            row.SetCoefficient(needs, -float(takes))
        for fact, label in zip(self._fact_of_offer.tolist(), self._offering.tolist(), strict=True):
            self._offered[fact].SetCoefficient(uses[label], 1.0)
        self._together = [engine.RowConstraint(0.0, infinity, "") for _ in pairs]
        for row, fact in zip(self._together, self._needed.tolist(), strict=True):
            row.SetCoefficient(needed[fact], 1.0)
        for pair, label in zip(self._pair.tolist(), labels.tolist(), strict=True):
            self._together[pair].SetCoefficient(uses[label], -1.0)

    def charged(self, cost: Ints, unit: float) -> tuple[int, Ints]:
        """The bound by these rows alone at their prices in the last solution, and what is left of each label's cost."""
        core = self._core
        price = np.array([max(0, int(row.dual_value() * unit)) for row in self._offered], np.int64)
        paid = np.array([max(0, int(row.dual_value() * unit)) for row in self._together], np.int64)
        left = cost.copy()
        np.subtract.at(left, self._offering, price[self._fact_of_offer])
        np.add.at(left, self._labels, paid[self._pair])
        price *= self._takes
        np.subtract.at(price, self._needed, paid)
        wanted = core.needs[core.goal]
        value = int(price[wanted].sum() + np.minimum(np.delete(price, wanted), 0).sum() + np.minimum(left, 0).sum())
        return value, np.maximum(left, 0)
