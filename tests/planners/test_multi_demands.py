"""Distinct inputs: facts that take several providers, and landmarks that demand several members."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations

import numpy as np
from hypothesis import given
from test_against_the_oracle import agree, fewer
from test_closing import closing
from test_preprocessing import Stage
from worlds import fusions

from cfgplan.planners.bounding.bounds import Bound, chained_bound, cheapest_way
from cfgplan.planners.bounding.landmarks import Landmark
from cfgplan.planners.closing.program import LandmarkProgram, charged
from cfgplan.planners.closing.separation import Separator
from cfgplan.planners.cpsat import PlannerSession
from cfgplan.planners.networks.greedy import first_plan, is_plan
from cfgplan.planners.solving.clock import Clock
from cfgplan.planners.tuning import Close
from cfgplan.planning import Problem, Status
from cfgplan.reasons import startable
from experiments.families.nao import nao


def plans(stage: Stage, problem: Problem) -> Iterator[set[int]]:
    """All choices of labels that feed each other and meet the targets, whatever the network says."""
    environment = problem.environment
    for size in range(len(stage.network.labels) + 1):
        for chosen in combinations(stage.network.transformations, size):
            labels = {t.label for t in chosen}
            if startable(replace(environment, units=(), library=chosen), stage.providers) == labels and all(
                not labels.isdisjoint(stage.providers.of(target.tag)) for target in environment.targets
            ):
                yield stage.numbers(labels)


def is_hit(landmark: Landmark, plan: set[int]) -> bool:
    return sum(label in plan for label in landmark.counted.tolist()) >= landmark.least


@fewer
@given(fusions())
def test_facts_that_take_several_givers_say_exactly_what_is_a_plan(problem: Problem) -> None:
    stage = Stage(problem)
    core = stage.network.core
    known = [frozenset(plan) for plan in plans(stage, problem)]
    for size in range(core.goal + 1):
        for chosen in map(frozenset, combinations(range(core.goal), size)):
            assert is_plan(stage.network, set(chosen)) == (chosen in known)


@fewer
@given(fusions())
def test_every_plan_hits_each_landmark_however_it_was_made(problem: Problem) -> None:
    stage = Stage(problem)
    core = stage.network.core
    limit = stage.plan.cost_us or 0
    bound = Bound(core, stage.cost)
    bound.improve(2**50, 3, lambda: False)
    part = bound.restricted(bound.may_be_used(limit))
    part.improve(2**50, 100, lambda: False)
    again = [landmark.outside(part.core).made_again(core) for landmark in part.landmarks]
    bound.improve(2**50, 100, lambda: False)
    landmarks = [*bound.landmarks, *again]
    program = LandmarkProgram(core, np.arange(core.goal), stage.cost)
    for landmark in landmarks:
        program.add(landmark)
    fractions = program.solve(None)
    assert fractions is not None
    landmarks += Separator(core).missed(np.minimum(fractions, 1.0), np.random.default_rng(0))
    for plan in plans(stage, problem):
        assert all(is_hit(landmark, plan) for landmark in landmarks)
        if int(stage.cost[sorted(plan)].sum()) <= limit:
            inside = {int(i) for i in np.searchsorted(part.core.labels, sorted(plan))}
            assert all(is_hit(landmark, inside) for landmark in part.landmarks)


@fewer
@given(fusions())
def test_bounds_by_them_do_not_exceed_the_optimum_and_fixing_keeps_cheap_plans(problem: Problem) -> None:
    stage = Stage(problem)
    optimum = stage.plan.cost_us or 0
    bound = Bound(stage.network.core, stage.cost)
    bound.improve(2**50, 100, lambda: False)
    before = bound.value
    bound = charged(bound, Clock())
    assert before <= bound.value <= optimum
    assert (bound.residual >= 0).all()
    max_need = int(cheapest_way(stage.network.core, stage.cost)[1][-1])
    assert max_need <= chained_bound(stage.network.core, stage.cost, stage.network.pinned, lambda: False) <= optimum
    dearer = bound.at(stage.cost + 1)
    for plan in plans(stage, problem):
        cost = int(stage.cost[sorted(plan)].sum())
        assert bound.may_be_used(cost)[sorted(plan)].all()
        assert dearer.value <= cost + len(plan)


@fewer
@given(fusions())
def test_the_first_plan_feeds_distinct_inputs_and_closing_keeps_both_sides(problem: Problem) -> None:
    stage = Stage(problem)
    plan = first_plan(stage.network, stage.cost, 5, Clock())
    assert plan is not None
    assert plan in list(plans(stage, problem))
    both = closing(stage, Close(work=1e3))
    both.go_on(Clock())
    assert both.bound.value <= (stage.plan.cost_us or 0) <= both.limit


@fewer
@given(fusions())
def test_with_distinct_inputs_the_planner_agrees_with_the_oracle(problem: Problem) -> None:
    agree(problem)


def test_the_fusion_of_ten_robots_needs_no_solver() -> None:
    plan = PlannerSession().plan(nao(0, robots=10, fusion=2))
    assert plan.status is Status.OPTIMAL
    assert "rounds" not in plan.counts
