"""The planner's own search decides small problems.

There, to build a model and call the solver takes longer than to search all that a better plan may have.
"""

from __future__ import annotations

from dataclasses import replace

from cfgplan.planners.bounding.bounds import chained_bound
from cfgplan.planners.bounding.branching import Branching
from cfgplan.planners.exact.work import Left, Work, numbers
from cfgplan.planners.networks.greedy import first_plan
from cfgplan.planners.networks.network import Weighing


def decide(work: Work) -> bool:
    """Search for the best plan for some steps.

    True if that proves the cost; the solver has then broken ties if it had to. Nothing is done if the network is large,
    or if distinct or feedback inputs make a plan more than its labels.
    """
    standing, network, tuning = work.standing, work.structure.network, work.clock.tuning.decide
    if not tuning.steps or len(network.labels) > tuning.labels or network.special:
        return False
    weighing = Weighing.with_changes(work.problem, network, work.structure.pinned)
    if weighing is None:
        return False
    plans: list[set[int]] = []
    if standing.best is not None:
        plans.append({network.number[unit.transformation] for unit in standing.best.units}.union(network.pinned))
    first = first_plan(network, weighing.weight, 0, work.clock)
    plans += [] if first is None else [first]
    if not plans:
        return False
    is_proven = _proves(work, weighing, min(plans, key=lambda one: weighing.of_plan(numbers(one))))
    work.clock.end("bounds")
    if is_proven and not standing.is_over:
        work.search().run()
        work.clock.end("search")
    return is_proven


def _proves(work: Work, weighing: Weighing, plan: set[int]) -> bool:
    """Search below the plan. True if the cost is proven; what is left may then differ in changes only."""
    network, tuning = work.structure.network, work.clock.tuning.decide
    limit = least = weighing.of_plan(numbers(plan))
    is_proven = False
    if network.core.goal > tuning.chained:
        chained = chained_bound(network.core, weighing.weight, network.pinned, work.clock.is_over)
        is_proven = weighing.least(chained) >= limit
    work.standing.counts["nodes"] = 0
    if not is_proven:
        search = Branching(network.core, weighing.weight, limit, weighing.step, work.clock.is_over)
        first, more = min(tuning.steps, tuning.first), max(0, tuning.steps - tuning.first)
        is_proven = search.run(first) or (search.done >= tuning.soon and search.run(more))
        work.standing.counts["nodes"], least = search.nodes, search.least
        work.memory.keep_landmarks(search.bound, weighing.scale)
        if search.best is not None:
            plan = search.best.union(network.pinned)
    labels = numbers(plan)
    value = weighing.of_plan(labels) if is_proven else weighing.least(least)
    left = Left(network, weighing, labels, value, labels, is_complete=False)
    work.take(left)
    return is_proven and (work.standing.is_over or _takes_others(work, left, plan))


def _takes_others(work: Work, left: Left, plan: set[int]) -> bool:
    """Take the labels of all plans that may change less than the incumbent, which costs least. False if unknown."""
    best, clock, weighing = work.standing.best, work.clock, left.weighing
    if best is None:
        return False
    limit = weighing.of_key(best.key)
    search = Branching(left.network.core, weighing.weight, limit, weighing.step, clock.is_over)
    others = search.others(plan, clock.tuning.decide.steps)
    if others is not None:
        work.take(replace(left, labels=numbers(plan | others), is_complete=True))
    return others is not None
