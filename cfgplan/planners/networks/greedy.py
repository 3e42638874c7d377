"""A good plan without search: cheapest support by h_add, redundant members dropped, improved by replanning.

A plan here is a set of labels with a grounded wiring that meets the goal.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from heapq import nsmallest
from typing import TypeAlias

from cfgplan.planners.networks.core import MOST_PASSES, Floats, Ints
from cfgplan.planners.networks.network import Choosable
from cfgplan.planners.networks.reach import Reach
from cfgplan.planners.solving.arrays import np
from cfgplan.planners.solving.clock import Clock
from cfgplan.reasons import Each

Costs: TypeAlias = "Sequence[int] | Ints"
"""The cost of each label: a list, or an array."""
COST_CAP = 1e200
"""The cost of a support is capped at this, so that sums stay finite."""
FREE = 1e-3
"""The price of a label that is there already: of two such supports the smaller one is better."""


def first_plan(network: Choosable, cost: Costs, attempts: int, clock: Clock) -> set[int] | None:
    """A plan, after up to `attempts` attempts to do without one of its members; None if none was found.

    Raises OutOfTimeError if the time ends before a first plan.
    """
    plan = plan_at(network, cost, _prices(network, cost), clock.each)
    return None if plan is None else with_less(network, cost, plan, attempts, clock)


def with_less(network: Choosable, cost: Costs, plan: set[int], attempts: int, clock: Clock) -> set[int]:
    """The plan, or a cheaper one after up to `attempts` attempts to do without one of its members."""
    tried: set[int] = set()
    while len(tried) < attempts and not clock.is_over():
        ahead = sorted(
            (label for label in plan.difference(tried, network.pinned) if cost[label]),
            key=lambda label: (-cost[label], label),
        )
        if not ahead:
            break
        tried.add(ahead[0])
        plan = _without(network, cost, plan, ahead[0])
    return plan


def _prices(network: Choosable, cost: Costs) -> list[float] | Floats:
    """Return the labels' costs as prices, as a list if the network is small; a label that costs nothing is not free."""
    return [float(one) + 1.0 for one in cost] if network.core.is_small else np.asarray(cost, np.float64) + 1.0


def _without(network: Choosable, cost: Costs, plan: set[int], label: int) -> set[int]:
    """The plan, or a cheaper one that avoids `label` and has the other members for nothing."""
    price = np.asarray(cost, np.float64) + 1.0
    price[list(plan)] = FREE
    price[label] = np.inf
    other = plan_at(network, cost, price)
    return other if other is not None and cost_of(cost, other) < cost_of(cost, plan) else plan


def cost_of(cost: Costs, labels: Iterable[int]) -> int:
    """The cost of labels together."""
    return sum(int(cost[label]) for label in labels)


def plan_at(network: Choosable, cost: Costs, price: list[float] | Floats, each: Each = iter) -> set[int] | None:
    """A cheapest support of the goal by h_add at these prices, without redundant labels; None if it is no plan."""
    total = _total_in_lists(network, price) if isinstance(price, list) else _total(network, price)
    if total is None:
        return None
    chosen = _below(network, [network.core.goal, *network.pinned], total, each)
    return without_redundant(network, cost, chosen) if is_plan(network, chosen, each) else None


def support_of(network: Choosable, cost: Costs, label: int) -> set[int]:
    """The labels by which the label is fed most cheaply, by h_add."""
    total = _total(network, np.asarray(cost, np.float64) + 1.0)
    return set() if total is None else _below(network, [label], total) - {label}


def _total(network: Choosable, price: Floats) -> list[float] | None:
    """h_add of each label with its own price; None if the goal is out of reach."""
    core = network.core
    facts = np.full(len(core.providers), np.inf)
    for _ in range(0 if core.is_deep else MOST_PASSES):
        better = core.least_sum_of_givers(core.sum_of_needs(facts)[:-1] + price)
        if (better == facts).all():
            break
        facts = better
    else:
        found = core.facts_one_by_one(price.tolist(), _added)
        facts = np.array([found.get(fact, np.inf) for fact in range(len(core.providers))])
    labels = core.sum_of_needs(facts)
    return (labels[:-1] + price).tolist() if np.isfinite(labels[core.goal]) else None


def _total_in_lists(network: Choosable, price: list[float]) -> list[float] | None:
    """The same as `_total`, without arrays."""
    core = network.core
    found = core.facts_one_by_one(price, _added)
    labels = [sum(found.get(fact, math.inf) for fact in core.needs.lists[label]) for label in range(len(core.needs))]
    if math.isinf(labels[core.goal]):
        return None
    return [needs + own for needs, own in zip(labels, price, strict=False)]


def _added(values: list[float]) -> float:
    """Return the sum, capped at COST_CAP if all are finite. A need that repeats in many layers would overflow."""
    return min(sum(values), COST_CAP) if max(values) < math.inf else math.inf


def _below(network: Choosable, labels: list[int], total: list[float], each: Each = iter) -> set[int]:
    """These labels but the goal, and the cheapest providers of all facts needed, directly or through others."""
    chosen = set(labels)
    fed: set[int] = set()
    ahead = list(labels)
    for label in each(ahead):
        for provider in _feeders(network, label, total, fed):
            if provider not in chosen:
                chosen.add(provider)
                ahead.append(provider)
    return chosen - {network.core.goal}


def _feeders(network: Choosable, label: int, total: list[float], fed: set[int]) -> list[int]:
    feeders = []
    for fact in network.core.needs.lists[label]:
        if fact not in fed:
            fed.add(fact)
            providers, takes = network.core.providers.lists[fact], network.core.multi_takes.get(fact)
            feeders += (
                nsmallest(takes, providers, total.__getitem__) if takes else [min(providers, key=total.__getitem__)]
            )
    return feeders + network.special_feeders(label, total) if label in network.special else feeders


def without_redundant(network: Choosable, cost: Costs, chosen: set[int]) -> set[int]:
    """Return the plan without redundant labels; the most expensive are dropped first."""
    gives_of, needs, takes = network.core.gives.lists, network.core.needs.lists, network.core.multi_takes
    givers_left: dict[int, int] = {}
    for label in chosen:
        for fact in gives_of[label]:
            givers_left[fact] = givers_left.get(fact, 0) + 1
    needed = set().union(*[needs[label] for label in (*chosen, network.core.goal)])
    pinned = set(network.pinned)
    for label in sorted(chosen, key=lambda label: (-cost[label], label)):
        gives = gives_of[label]
        if label in pinned or any(fact in needed and givers_left[fact] <= takes.get(fact, 1) for fact in gives):
            continue
        rest = chosen - {label}
        if is_plan(network, rest):
            chosen = rest
            for fact in gives:
                givers_left[fact] -= 1
    return chosen


def is_plan(network: Choosable, chosen: set[int], each: Each = iter) -> bool:
    """Whether the labels have a grounded wiring among themselves that meets the goal."""
    order = Reach(network.core, [*sorted(chosen), network.core.goal], each).order
    before: set[int] = set()
    for label in order if network.special else ():
        if label in network.special and not network.special_inputs_are_fed(label, before, chosen):
            return False
        before.add(label)
    return len(order) == len(chosen) + 1
