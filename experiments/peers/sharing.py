"""Branch-and-bound over sets of units instead of trees, which counts shared units once.

This is the best version of the paper's search, for comparison. A state is a set of chosen units, each paid for once. It
branches over the feeders of a demand that no chosen unit feeds, the state with the best bound first. The bound adds the
cheapest feeders of open demands that have no feeder in common. A set without open demands that is not grounded (or not
distinct) branches over further units such that one of them must run (`Selection.ways_in`). From time to time it dives
for a plan. It does not break ties, so that it proves only the cost.
"""

from __future__ import annotations

import heapq
import time
from collections.abc import Callable

from cfgplan.planning import Plan, Problem, Progress, Status, refuse_features
from cfgplan.reasons import unmet_reasons
from experiments.peers.selection import Selection

DIVE_EVERY = 500
Set = frozenset[int]
SearchState = tuple[int, int, list[int]]
"""Bound in microseconds, minus the number of units, the units: the least comes first."""


def plan(
    problem: Problem,
    *,
    time_limit_s: float | None = None,
    report: Callable[[Progress], None] | None = None,
) -> Plan:
    """Return the cheapest update, proven optimal unless the time runs out; see `planning.Planner`."""
    began = time.monotonic()
    until = began + (float("inf") if time_limit_s is None else time_limit_s)
    refuse_features(problem, NAME)
    if reasons := unmet_reasons(problem):
        return Plan(NAME, Status.INFEASIBLE, reasons=reasons)
    selection = Selection(problem, NAME)
    queue = [_state(selection, selection.kept)]
    seen: set[Set] = {selection.kept}
    best: Set | None = None
    best_us, bound_us, nodes = float("inf"), queue[0][0], 0

    def offer(chosen: Set | None) -> None:
        nonlocal best, best_us
        chosen = None if chosen is None else selection.needed(chosen)
        if chosen is not None and selection.cost_us(chosen) < best_us:
            best, best_us = chosen, selection.cost_us(chosen)
            if report is not None:
                report(Progress(time.monotonic() - began, selection.cost_us(chosen), bound_us))

    while queue and queue[0][0] < best_us:
        if time.monotonic() > until:
            bound_us = queue[0][0]
            break
        bound, _, units = heapq.heappop(queue)
        if bound > bound_us:
            bound_us = bound
            if report is not None:
                report(Progress(time.monotonic() - began, selection.cost_us(best) if best else None, bound_us))
        nodes += 1
        if nodes % DIVE_EVERY == 1:
            offer(_dive(selection, frozenset(units), until))
        for child in _children(selection, frozenset(units)):
            if child not in seen:
                seen.add(child)
                state = _state(selection, child)
                if state[0] < best_us:
                    heapq.heappush(queue, state)
                    if state[0] == selection.cost_us(child) and selection.satisfied(child):
                        offer(child)
    else:
        bound_us = max(bound_us, int(best_us))
    return selection.answer(best, bound_us, seconds={"search": time.monotonic() - began}, counts={"nodes": nodes})


NAME = "branch-and-bound-shared"


def _state(selection: Selection, chosen: Set) -> SearchState:
    bound = selection.cost_us(chosen)
    counted: set[int] = set()
    cheapest = {f: min(selection.candidates[i].cost_us for i in f) for f in selection.open_demands(chosen).values()}
    for feeders, cost_us in sorted(cheapest.items(), key=lambda entry: (-entry[1], entry[0])):
        if counted.isdisjoint(feeders):
            counted.update(feeders)
            bound += cost_us
    return bound, -len(chosen), sorted(chosen)


def _children(selection: Selection, chosen: Set) -> list[Set]:
    """The chosen and one more unit each; every valid superset of the chosen is a superset of one of these."""
    demands = selection.open_demands(chosen).values()
    ways = min(demands, key=lambda feeders: (len(feeders), feeders)) if demands else selection.ways_in(chosen)
    return [chosen | {i} for i in ways]


def _dive(selection: Selection, chosen: Set, until: float) -> Set | None:
    """A valid set of units around the chosen, by the most promising child at each step; None if time runs out."""
    while not selection.satisfied(chosen):
        if time.monotonic() > until:
            return None
        chosen = frozenset(min(_state(selection, child) for child in _children(selection, chosen))[2])
    return chosen
