"""The planner's own search decides small problems, and what bounds leave of others.

There, to build a model and call the solver takes longer than to search all that a better plan may have.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from cfgplan.planners.bounding.bounds import chained_bound
from cfgplan.planners.bounding.branching import Branching
from cfgplan.planners.exact.work import Left, Work, numbers
from cfgplan.planners.networks.core import Ints
from cfgplan.planners.networks.greedy import first_plan, without_redundant
from cfgplan.planners.networks.network import Network, Weighing


def decide(work: Work, among: Collection[str] | None = None) -> bool:
    """Search for a better plan for some steps; with `among`, no other labels can be in one.

    True if that proves the cost; the solver has then broken ties if it had to. Nothing is done if the network is large,
    or if distinct or feedback inputs make a plan more than its labels.
    """
    standing, network, tuning = work.standing, work.structure.network, work.clock.tuning.decide
    is_large = len(network.labels) > tuning.labels if among is None else len(among) > tuning.left
    if not tuning.steps or is_large or network.special:
        return False
    weighing = Weighing.with_changes(work.problem, network, work.structure.pinned)
    if weighing is None:
        return False
    plans: list[set[int]] = []
    if standing.best is not None:
        plans.append({network.number[unit.transformation] for unit in standing.best.units}.union(network.pinned))
    if among is None:
        first = first_plan(network, weighing.weight, 0, work.clock)
        plans += [] if first is None else [first]
    if not plans:
        return False
    is_proven = _Deciding(work, weighing, among).proves(min(plans, key=lambda one: weighing.of_plan(numbers(one))))
    work.clock.end("bounds")
    if is_proven and not standing.is_over:
        work.search().run()
        work.clock.end("search")
    return is_proven


class _Deciding:
    """Searches for a plan that weighs less, and brings the standing forward by the answer."""

    def __init__(self, work: Work, weighing: Weighing, among: Collection[str] | None) -> None:
        self._work, self._weighing = work, weighing
        self._network = network = work.structure.network
        self._core, self._weight = network.core, weighing.weight
        self._tuning = work.clock.tuning.decide
        self._is_part = among is not None
        if among is not None:
            keep = np.zeros(self._core.goal, np.bool_)
            keep[[network.number[label] for label in among]] = True
            self._core, self._weight = self._core.restricted(keep), self._weight[keep]

    def proves(self, plan: set[int]) -> bool:
        """Search below the plan. True if the cost is proven; what is left may then differ in changes only."""
        work, network, weighing, tuning = self._work, self._network, self._weighing, self._tuning
        limit = least = weighing.of_plan(numbers(plan))
        is_proven = False
        if not self._is_part and self._core.goal > tuning.chained:
            chained = chained_bound(self._core, self._weight, network.pinned, work.clock.is_over)
            is_proven = weighing.least(chained) >= limit
        work.standing.counts["nodes"] = 0
        if not is_proven:
            search = self._below(limit)
            first, more = min(tuning.steps, tuning.first), max(0, tuning.steps - tuning.first)
            is_proven = search.run(first) or (search.done >= tuning.soon and search.run(more))
            work.standing.counts["nodes"], least = search.nodes, search.least
            if not work.memory.has_landmarks:
                work.memory.keep_landmarks(search.bound, weighing.scale)
            if search.best is not None:
                plan = set(self._core.labels[sorted(search.best)].tolist()).union(network.pinned)
        plan = _lean(network, weighing.weight, plan)
        labels = numbers(plan)
        value = weighing.of_plan(labels) if is_proven else weighing.least(least)
        left = Left(network, weighing, labels, value, labels, is_complete=False)
        work.take(left)
        return is_proven and (work.standing.is_over or self._takes_others(left, plan))

    def _takes_others(self, left: Left, plan: set[int]) -> bool:
        """Take the labels of all plans that may change less than the incumbent, which costs least. False if unknown."""
        work = self._work
        if work.standing.best is None:
            return False
        core, search = self._core, self._below(self._weighing.of_key(work.standing.best.key))
        others = search.others(np.flatnonzero(np.isin(core.labels, left.labels)).tolist(), self._tuning.steps)
        if others is not None:
            labels = plan.union(core.labels[sorted(others)].tolist())
            work.take(replace(left, labels=numbers(labels), is_complete=True))
        return others is not None

    def _below(self, limit: int) -> Branching:
        """A search for plans that weigh less than `limit`."""
        return Branching(self._core, self._weight, limit, self._weighing.step, self._work.clock.is_over)


def _lean(network: Network, weight: Ints, plan: set[int]) -> set[int]:
    """Drop redundant members from a plan that has members of no weight."""
    while not weight[numbers(plan)].all():
        lean = without_redundant(network, weight, plan)
        if lean == plan:
            break
        plan = lean
    return plan
