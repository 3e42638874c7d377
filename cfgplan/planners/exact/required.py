"""Required transformations: a first plan that uses all of them, and the labels that a cheaper one may have.

A plan that uses all of them runs all of them, so bounds may count them as wanted. If no plan uses all, the search finds
without bounds how many can be used.
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence

from cfgplan.planners.bounding.bounds import Bound, tightened
from cfgplan.planners.exact.remaining import Remaining
from cfgplan.planners.exact.solve_run import SolveRun
from cfgplan.planners.exact.solve_state import Incumbent, SolveState
from cfgplan.planners.networks.greedy import first_plan, support_of
from cfgplan.planners.networks.network import LexicographicWeights, Network, costs
from cfgplan.planners.solving.arrays import np
from cfgplan.planners.tuning import attempts_among


def take_with_all(work: SolveRun) -> None:
    """Go on with the labels that a plan with all required transformations can contain; offer such a plan if one is
    found.
    """
    clock, structure, state = work.clock, work.structure, work.state
    required = frozenset(t.label for t in structure.network.transformations if t.required)
    network = structure.network_with(work.problem, required, clock)
    fixed_us, cost = costs(work.problem, network)
    avoided: set[int] = set()
    for _ in range(clock.tuning.begin.ways):
        few = _few(work, required, avoided)
        found = None if few is None else _among(work, few)
        if few is not None and found is not None:
            state.offer(work.structure.candidates(work.problem, few), found.units)
        if few is None or found is not None or clock.is_over():
            break
    best = state.best
    is_with_all = best is not None and best.key.unused == structure.unusable_required
    limit = best.key.cost_us - fixed_us if best is not None and is_with_all else sum(cost)
    weights = LexicographicWeights(cost, 1, 1, fixed_us)
    part = Remaining.by(tightened(Bound(network.core, weights.weight), limit, limit, clock), limit)
    labels = np.union1d(part.labels, np.array(network.pinned, np.int64))
    left = Remaining(labels, part.value, part.bound, holds_for=structure.unusable_required)
    work.take(left, network, weights)


def _few(work: SolveRun, required: frozenset[str], avoided: set[int]) -> list[str] | None:
    """The labels of a greedy plan that has all required ones and, for each, a cheap way on to a target.

    None if no such plan is found. Ways avoid the `avoided` labels, and their own labels are added to these.
    """
    network, clock = work.structure.network, work.clock
    _, cost = costs(work.problem, network)
    numbers = {network.number[label] for label in required}
    ways = [_way_to_a_target(network, cost, label, avoided - numbers) for label in clock.each(sorted(numbers), 1)]
    avoided.update(label for way in ways for label in way)
    wanted = required.union(network.labels[i] for way in ways for i in way)
    wider = work.structure.network_with(work.problem, wanted, clock)
    plan = first_plan(wider, costs(work.problem, wider)[1], attempts_among(wider.labels, clock.tuning), clock)
    return None if plan is None else [wider.labels[i] for i in sorted(plan)]


def _way_to_a_target(network: Network, cost: Sequence[int], label: int, avoided: set[int]) -> list[int]:
    """The cheapest chain from a label to one that meets a target; each label feeds the next one.

    Labels that feed the first are avoided, as they could hardly be fed by it. The chain is empty if there is none.
    """
    core = network.core
    avoided = avoided | support_of(network, cost, label) | {core.goal}
    wanted = {network.fact_of_tag[tag] for tag in network.targets}
    ahead = [(0, label)]
    before = {label: label}
    done: set[int] = set()
    while ahead:
        so_far, here = heapq.heappop(ahead)
        if here in done:
            continue
        done.add(here)
        gives = core.gives.lists[here]
        if not wanted.isdisjoint(gives):
            way = [here]
            while before[way[-1]] != way[-1]:
                way.append(before[way[-1]])
            return way
        for consumer in {one for fact in gives for one in core.needed_by.lists[fact]} - done - avoided:
            heapq.heappush(ahead, (so_far + cost[consumer], consumer))
            before.setdefault(consumer, here)
    return []


def _among(work: SolveRun, few: list[str]) -> Incumbent | None:
    """The best plan among a few labels that uses all required ones; None if none is found."""
    from cfgplan.planners.exact.search import Search

    state = SolveState(work.problem, work.clock, None)
    Search(work.structure.candidates(work.problem, few), state).run_with_all_required()
    best = state.best
    return best if best is not None and best.key.unused == work.structure.unusable_required else None
