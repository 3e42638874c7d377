"""The stages of a plan, in order. Each returns whether the plan is finished."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Final

from cfgplan.planners.bounding.branching import Branching
from cfgplan.planners.bounding.contraction import cheapest_choice
from cfgplan.planners.bounding.disjoint import disjoint_bound
from cfgplan.planners.exact.candidates import Candidates
from cfgplan.planners.exact.remaining import Remaining
from cfgplan.planners.exact.solve_run import SolveRun, numbers
from cfgplan.planners.networks.core import Core, Ints
from cfgplan.planners.networks.greedy import FREE, cost_of, first_plan, is_plan, plan_at, with_less
from cfgplan.planners.networks.network import LexicographicWeights, Network, costs
from cfgplan.planners.solving.arrays import np
from cfgplan.planners.tuning import attempts_among
from cfgplan.reasons import unmet_reasons

if TYPE_CHECKING:
    from cfgplan.planners.bounding.bounds import Bound

Stage = Callable[[SolveRun], bool]


def check_reachable_targets(work: SolveRun) -> bool:
    """Finish with reasons if some target can't be met, whatever runs."""
    state, structure = work.state, work.structure
    if len(structure.network.targets) == len(structure.environment.targets):
        state.counts = structure.counts()
        state.min_unused = structure.unusable_required
        return False
    state.is_infeasible = True
    state.reasons = unmet_reasons(work.problem, possible=structure.closure.possible)
    return True


def plan_fleet(work: SolveRun) -> bool:
    """Plan a problem with features beyond the paper, in stages of its own."""
    if work.problem.is_plain and not work.clock.tuning.is_solver_only:
        return False
    from cfgplan.planners.exact import deployment, fleet, groups

    candidates = Candidates(work.problem, work.structure.closure, clock=work.clock)
    if work.clock.tuning.counts and groups.is_countable(candidates):
        deployment.plan_by_counting(candidates, work.state)
        return True
    fleet.plan_fleet(candidates, work.state, work.memory.last)
    return True


def use_all_required(work: SolveRun) -> bool:
    """Look for the best plan that uses all required transformations; if there is none, for one that uses the most."""
    structure, network = work.structure, work.structure.network
    if not structure.has_required:
        return False
    from cfgplan.planners.exact.required import take_with_all

    fixed_us, cost = costs(work.problem, network)
    plan = first_plan(network, cost, 0, work.clock)
    if plan is not None:
        work.offer(plan)
    take_with_all(work)
    work.clock.end("bounds")
    if not work.search(work.landmarks()).run_with_all_required():
        work.take(Remaining(range(len(network.labels)), 0), network, LexicographicWeights(cost, 1, 1, fixed_us))
        work.clock.end("bounds")
        work.search().run()
    return True


def prove_by_answer_sets(work: SolveRun) -> bool:
    """Have answer sets raise the bound of a large network whose inputs are neither distinct nor feedback inputs."""
    network = work.structure.network
    is_small = len(network.labels) < work.clock.tuning.cycles.labels
    if is_small or network.special or work.memory.warm_start is not None:
        return False
    from cfgplan.planners.exact import answer_sets

    return answer_sets.prove(work)


def prove_by_parts(work: SolveRun) -> bool:
    """Choose the cheapest parts of a plan if inputs are distinct and no landmarks are known yet.

    Parts that share nothing are added up; among others the solver chooses. If many facts have more providers than they
    take, this is skipped: their parts mostly share labels.
    """
    network, core, tuning = work.structure.network, work.structure.network.core, work.clock.tuning.decide
    if work.memory.has_landmarks or core.takes is None or core.goal > tuning.disjoint or core.choices > tuning.choices:
        return False
    weights = LexicographicWeights.with_changes(work.problem, network)
    if weights is None:
        return False
    value, plan = disjoint_bound(core, weights.each, network.pinned, work.clock.each)
    if weights.of_plan(plan) > weights.least(value) or not is_plan(network, plan):
        is_asked = core.goal >= tuning.fewest
        chosen = cheapest_choice(core, weights.each, network.pinned, work.clock) if is_asked else None
        if chosen is None or not is_plan(network, chosen):
            return False
        value, plan = weights.of_plan(chosen), chosen
    labels = sorted(plan)
    work.take(Remaining(labels, value, is_complete=False), network, weights, labels)
    work.clock.end("bounds")
    return work.state.is_over


def decide_all(work: SolveRun) -> bool:
    """Search without the solver where no landmarks are known yet."""
    network, is_new = work.structure.network, not work.memory.has_landmarks
    if not is_new or len(network.labels) > work.clock.tuning.decide.labels:
        return False
    return decide(work, network.core) or (work.clock.is_over() and work.state.best is not None)


def decide_remaining(work: SolveRun) -> bool:
    """Search what bounds leave without the solver, if a proven plan is known: a model takes longer than a replan."""
    before, core = (work.remaining, work.network, work.weights), work.structure.network.core
    labels = work.remaining.labels
    if work.memory.warm_start is None or work.state.is_over or len(labels) > work.clock.tuning.decide.left:
        return False
    is_decided = decide(work, core.restricted(np.isin(core.labels, labels)))
    if not is_decided:
        work.take(*before)
    return is_decided


def raise_bound(work: SolveRun) -> bool:
    """Find a plan and a bound, and leave out labels by reduced costs.

    The plan is the proven running one, or the last one. If that is no longer valid, or in a session's first call, where
    the last plan is the running configuration, a new one is made too, and the cheaper of both is tried without its most
    expensive members.
    """
    state, memory, clock, network = work.state, work.memory, work.clock, work.structure.network
    is_first = not memory.last
    memory.keep_plan(state)
    weights = LexicographicWeights.of(work.problem, network)
    plan = _known_plan(work, network)
    is_new = plan is None or is_first
    if is_new:
        found = (plan, first_plan(network, weights.weight, 0, clock))
        plan = min((one for one in found if one is not None), key=partial(cost_of, weights.weight), default=None)
    if plan is not None and state.best is None:
        work.offer(plan)
    if is_new and plan is not None:
        plan = with_less(network, weights.weight, plan, attempts_among(network.labels, clock.tuning), clock)
    labels, part = None if plan is None else numbers(plan), None
    if labels is not None and memory.warm_start is not None and not weights.counts_starts:
        part = memory.warm_start.remaining(weights.weight, weights.step, labels, clock)
    if part is None:
        labels, part = _bounded(work, weights, labels)
    work.take_bounded(part, network, weights, labels)
    work.clock.end("bounds")
    return False


def _known_plan(work: SolveRun, network: Network) -> set[int] | None:
    """Return the proven running plan or the last plan; None if it is not valid any more."""
    known, memory = set(network.pinned), work.memory
    if memory.warm_start is not None:
        known |= set(memory.warm_start.plan.tolist())
    else:
        known |= {network.number[label] for label in memory.last if label in network.number}
    return known if is_plan(network, known) else None


def _bounded(work: SolveRun, weights: LexicographicWeights, plan: Ints | None) -> tuple[Ints | None, Remaining]:
    """Raise the bound by landmarks. Returns the plan, or a cheaper one, and the labels that the bound leaves.

    If closing may follow and no label has distinct inputs, less work is spent. With distinct inputs the labels that a
    good bound charges in full often make a cheaper plan.
    """
    from cfgplan.planners.bounding.bounds import tightened
    from cfgplan.planners.closing.gap import GapClosing

    network, clock = work.structure.network, work.clock
    limit = sum(weights.each) if plan is None else weights.of_plan(plan)
    is_crowded = network.core.multi_facts is not None
    bound = work.memory.bound(weights.weight, weights.scale)
    bound = tightened(bound, limit - weights.step + 1, limit, clock, greedily=plan is not None and not is_crowded)
    if plan is not None and bound.value <= limit - weights.step and is_crowded and not clock.is_over():
        plan = _on_remaining_labels(network, weights, bound, plan)
        limit = weights.of_plan(plan)
    work.memory.keep_landmarks(lambda: bound, weights.scale)
    if plan is not None and weights.least(bound.value) < limit and not clock.is_over():
        work.closing = GapClosing(network, bound, weights.weight, plan, weights.step, clock.tuning)
    return plan, Remaining.by(bound, limit)


def _on_remaining_labels(network: Network, weights: LexicographicWeights, bound: Bound, plan: Ints) -> Ints:
    """The plan, or a cheaper one that is made at residual costs."""
    price = np.full(len(weights.weight), np.inf)
    price[bound.core.labels] = bound.residual + FREE
    found = plan_at(network, weights.weight, price)
    return plan if found is None else min(plan, numbers(found), key=weights.of_plan)


def close_gap(work: SolveRun) -> bool:
    """Bring bound and plan closer."""
    closing, clock = work.closing, work.clock
    if closing is not None and not closing.is_closed and not work.state.is_over:
        tell = partial(work.tell_of, closing)
        closing.go_on(clock, tell)
        closing.look_near(clock, tell)
        part = Remaining.by(closing.bound.restricted(closing.bound.may_be_used(closing.limit)), closing.limit)
        work.take_bounded(part, work.network, work.weights, closing.plan)
        clock.end("bounds")
    return False


def solve(work: SolveRun) -> bool:
    """Search the remaining labels by the solver."""
    if not work.state.is_over:
        work.search(work.landmarks(), work.missed).run()
    return True


STAGES: Final[tuple[Stage, ...]] = (
    check_reachable_targets,
    plan_fleet,
    use_all_required,
    prove_by_answer_sets,
    prove_by_parts,
    decide_all,
    raise_bound,
    decide_remaining,
    close_gap,
    solve,
)
"""The stages that follow once what runs is offered and the closure of the library is known."""


def decide(work: SolveRun, core: Core) -> bool:
    """Have the planner's own search look among the labels of a core for the best plan, for some steps.

    For a small problem, to build a model and call the solver takes longer than to search. True if that proves the
    cost; the solver has then broken ties if it had to. No other label may be in a better plan. Nothing is done if
    distinct or feedback inputs make a plan more than its labels.
    """
    state, network = work.state, work.structure.network
    if not work.clock.tuning.decide.steps or network.special:
        return False
    weights = LexicographicWeights.with_changes(work.problem, network)
    if weights is None:
        return False
    plans: list[set[int]] = []
    if state.best is not None:
        plans.append({network.number[unit.transformation] for unit in state.best.units}.union(network.pinned))
    if core is network.core:
        first = first_plan(network, weights.each, 0, work.clock)
        plans += [] if first is None else [first]
    if not plans:
        return False
    bound = None if core is network.core else work.remaining.bound
    known = [] if bound is None else [*_known_landmarks(bound, core, weights.scale // work.weights.scale)]
    cost = [weights.each[label] for label in core.in_whole(range(core.goal))]
    below = partial(Branching, core, cost, step=weights.step, is_over=work.clock.is_over, known=known)
    is_proven = _proves(work, core, weights, min(plans, key=weights.of_plan), below)
    work.clock.end("bounds")
    if is_proven and not state.is_over:
        work.search().run()
        work.clock.end("search")
    return is_proven


def _proves(
    work: SolveRun, core: Core, weights: LexicographicWeights, plan: set[int], below: Callable[[int], Branching]
) -> bool:
    """Search for cheaper plans; `below` makes a search for those that weigh less than a limit.

    True if the cost is proven; other plans can then differ only in their changes.
    """
    network, tuning = work.structure.network, work.clock.tuning.decide
    limit = least = weights.of_plan(plan)
    is_proven = False
    if core is network.core and core.goal > tuning.chained:
        from cfgplan.planners.bounding.bounds import chained_bound

        chained = chained_bound(core, weights.weight, network.pinned, work.clock.is_over)
        is_proven = weights.least(chained) >= limit
    work.state.counts["nodes"] = 0
    if not is_proven:
        search = below(limit)
        first, more = min(tuning.steps, tuning.first), max(0, tuning.steps - tuning.first)
        is_proven = search.run(first) or (search.done >= tuning.soon and search.run(more))
        work.state.counts["nodes"], least = search.nodes, search.least
        if core is network.core:
            work.memory.keep_landmarks(search.bound, weights.scale)
        if search.best is not None:
            plan = set(core.in_whole(search.best)).union(network.pinned)
    labels = sorted(plan)
    value = weights.of_plan(labels) if is_proven else weights.least(least)
    work.take(Remaining(labels, value, is_complete=False), network, weights, labels)
    return is_proven and (work.state.is_over or _takes_others(work, core, plan, below))


def _known_landmarks(bound: Bound, core: Core, scale: int) -> Iterator[tuple[int, tuple[int, ...]]]:
    """Yield the landmarks of a bound that count once, with the charge times `scale`, among the labels of a core."""
    place = {label: at for at, label in enumerate(core.in_whole(range(core.goal)))}
    for landmark, charge in zip(bound.landmarks, bound.weights, strict=True):
        members = tuple([place[label] for label in bound.core.labels[landmark.members].tolist() if label in place])
        if charge and members and landmark.least == 1:
            yield charge * scale, members


def _takes_others(work: SolveRun, core: Core, plan: set[int], below: Callable[[int], Branching]) -> bool:
    """Go on with the labels of all plans that cost as little as the incumbent, the least, and may change less.

    False if the search for them takes too many steps.
    """
    best, weights = work.state.best, work.weights
    if best is None:
        return False
    search = below(weights.of_key(best.key))
    known = [label for label, number in enumerate(core.in_whole(range(core.goal))) if number in plan]
    others = search.others(known, work.clock.tuning.decide.steps)
    if others is not None:
        labels = sorted(plan.union(core.in_whole(others)))
        left = replace(work.remaining, labels=labels, is_complete=True)
        work.take(left, work.network, weights, sorted(plan))
    return others is not None
