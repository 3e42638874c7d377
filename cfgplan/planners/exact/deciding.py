"""The planner's own search decides small problems, and what bounds leave of others.

There, to build a model and call the solver takes longer than to search all that a better plan may have.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from cfgplan.planners.bounding.bounds import Bound, chained_bound
from cfgplan.planners.bounding.branching import Branching
from cfgplan.planners.exact.candidates import Candidates
from cfgplan.planners.exact.prepared import Prepared
from cfgplan.planners.exact.standing import Standing
from cfgplan.planners.exact.structure import Structure
from cfgplan.planners.networks.core import Core, Ints
from cfgplan.planners.networks.greedy import first_plan, without_redundant
from cfgplan.planners.networks.network import Network, Weighing


def decide(standing: Standing, structure: Structure, among: Collection[str] | None = None) -> Candidates | None:
    """Search for a better plan for some steps; with `among`, no other labels can be in one.

    If all is proven, returns the candidates of the plan; if only the cost is, all candidates that a better plan can
    have. Returns None if more is open. Nothing is done if the network is large, or if distinct or feedback inputs make
    a plan more than its labels.
    """
    network, tuning = structure.network, standing.clock.tuning.decide
    is_large = len(network.labels) > tuning.labels if among is None else len(among) > tuning.left
    if not tuning.steps or is_large or network.special:
        return None
    weighing = Weighing.with_changes(standing.problem, network, structure.pinned)
    if weighing is None:
        return None
    plans: list[set[int]] = []
    if standing.best is not None:
        plans.append({network.number[unit.transformation] for unit in standing.best.units}.union(network.pinned))
    if among is None:
        first = first_plan(network, weighing.weight, 0, standing.clock)
        plans += [] if first is None else [first]
    if not plans:
        return None
    plan = min(plans, key=lambda one: weighing.of_plan(_numbers(one)))
    return _Deciding(standing, structure, weighing, among).run(plan)


class _Deciding:
    """Searches for a plan that weighs less, and brings the standing forward by the answer."""

    def __init__(
        self, standing: Standing, structure: Structure, weighing: Weighing, among: Collection[str] | None
    ) -> None:
        self._standing, self._structure, self._weighing = standing, structure, weighing
        self._core, self._weight = structure.network.core, weighing.weight
        self._tuning = standing.clock.tuning.decide
        self._is_part = among is not None
        if among is not None:
            keep = np.zeros(self._core.goal, np.bool_)
            keep[[structure.network.number[label] for label in among]] = True
            self._core, self._weight = self._core.restricted(keep), self._weight[keep]

    def run(self, plan: set[int]) -> Candidates | None:
        network, weighing, standing, tuning = self._structure.network, self._weighing, self._standing, self._tuning
        limit, nodes = weighing.of_plan(_numbers(plan)), 0
        least, is_proven = limit, False
        if not self._is_part and self._core.goal > self._tuning.chained:
            chained = chained_bound(self._core, self._weight, network.pinned, standing.clock.is_over)
            is_proven = weighing.least(chained) >= limit
        if not is_proven:
            core, search = self._below(limit)
            first, more = min(tuning.steps, tuning.first), max(0, tuning.steps - tuning.first)
            is_proven = search.run(first) or (search.done >= tuning.soon and search.run(more))
            nodes, least = search.nodes, search.least
            if not self._structure.has_landmarks:
                self._structure.remember(search.bound, weighing.scale)
            if search.best is not None:
                plan = set(core.labels[sorted(search.best)].tolist()).union(network.pinned)
        plan = _lean(network, weighing.weight, plan)
        value = weighing.of_plan(_numbers(plan)) if is_proven else weighing.least(least)
        labels = [network.labels[i] for i in sorted(plan)]
        prepared = Prepared(
            labels,
            labels,
            bound_us=weighing.cost_us(value),
            counts={"nodes": nodes, "left by bounds": len(labels)},
            fewest_changes=weighing.changes(value),
            is_complete=False,
        )
        candidates = self._told(prepared)
        if not is_proven:
            return None
        return candidates if standing.is_over else self._all(prepared, plan)

    def _told(self, prepared: Prepared) -> Candidates:
        candidates = self._structure.candidates(self._standing.problem, prepared.labels)
        prepared.tell(self._standing, candidates)
        return candidates

    def _all(self, prepared: Prepared, plan: set[int]) -> Candidates | None:
        """The candidates of all plans that may change less than the incumbent, a cheapest plan; None if not known."""
        network, standing = self._structure.network, self._standing
        if standing.best is None:
            return None
        core, search = self._below(self._weighing.of_key(standing.best.key))
        others = search.others(np.flatnonzero(np.isin(core.labels, _numbers(plan))).tolist(), self._tuning.steps)
        if others is None:
            return None
        labels = [network.labels[i] for i in sorted(plan.union(core.labels[sorted(others)].tolist()))]
        counts = {**prepared.counts, "left by bounds": len(labels)}
        return self._told(replace(prepared, labels=labels, counts=counts, is_complete=True))

    def _below(self, limit: int) -> tuple[Core, Branching]:
        """The core to search, and a search in it for plans that weigh less than `limit`."""
        core, weight, step = self._core, self._weight, self._weighing.step
        if not self._is_part and core.goal > self._tuning.filtered:
            bound = Bound(core, weight)
            part = bound.restricted(bound.may_be_used(limit - step))
            core, weight = part.core, part.cost
        return core, Branching(core, weight, limit, step, self._standing.clock.is_over)


def _numbers(labels: set[int]) -> Ints:
    return np.array(sorted(labels), np.int64)


def _lean(network: Network, weight: Ints, plan: set[int]) -> set[int]:
    """Drop redundant members from a plan that has members of no weight."""
    while not weight[_numbers(plan)].all():
        lean = without_redundant(network, weight, plan)
        if lean == plan:
            break
        plan = lean
    return plan
