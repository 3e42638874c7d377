"""The search for small problems: its ways, its bounds and its answers against all sets of labels."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_against_the_oracle import fewer
from test_planners import make, world
from test_preprocessing import Stage
from worlds import problems

from cfgplan.planners.bounding.bounds import cheapest_way
from cfgplan.planners.bounding.branching import LEFT_OUT, Branching, Links, Ways
from cfgplan.planners.cpsat import PlannerSession
from cfgplan.planners.exact.memory import Memory, Structure
from cfgplan.planners.exact.solve_run import SolveRun
from cfgplan.planners.exact.solve_state import SolveState
from cfgplan.planners.exact.stages import decide
from cfgplan.planners.networks.greedy import is_plan
from cfgplan.planners.networks.keys import Key
from cfgplan.planners.networks.network import LexicographicWeights
from cfgplan.planners.solving.clock import Clock
from cfgplan.planners.tuning import USUAL, Decide, Tuning
from cfgplan.planning import Problem, Status
from experiments.families.random_library import random_library

LIMIT = 10**9


def all_plans(stage: Stage) -> list[set[int]]:
    """The sets of labels that are plans."""
    labels = range(len(stage.cost))
    sets = (set(chosen) for size in range(len(stage.cost) + 1) for chosen in combinations(labels, size))
    return [chosen for chosen in sets if is_plan(stage.network, chosen)]


@fewer
@given(problems(special=False))
def test_ways_on_lists_cost_what_they_cost_on_arrays_also_after_labels_became_cheaper(problem: Problem) -> None:
    stage = Stage(problem)
    core, price = stage.network.core, stage.cost.tolist()
    ways = Ways(Links(core), price)
    for _ in range(3):
        _, before = cheapest_way(core, np.array(price, np.int64))
        assert ways.to_goal == before[-1]
        assert set(ways.labels_from(5)) == set(np.flatnonzero(before[:-1] + np.array(price, np.int64) >= 5).tolist())
        assert is_plan(stage.network, ways.plan())
        cheaper = [label for label, cost in enumerate(price) if cost]
        for label in cheaper:
            price[label] -= 1
        ways.lower(cheaper)


@fewer
@given(problems(special=False), st.integers(1, 30))
def test_what_costs_less_than_the_most_that_is_asked_for_costs_the_same(problem: Problem, most: int) -> None:
    core = Stage(problem).network.core
    price = Stage(problem).cost.tolist()
    all_ways, near = Ways(Links(core), price), Ways(Links(core), price, most)
    assert near.to_goal == (all_ways.to_goal if all_ways.to_goal < most else LEFT_OUT)
    assert near.labels_from(most) == all_ways.labels_from(most)


@fewer
@given(problems(special=False), st.integers(1, 10))
def test_the_first_node_has_a_bound_on_every_plan(problem: Problem, steps: int) -> None:
    stage = Stage(problem)
    search = Branching(stage.network.core, stage.cost, LIMIT, 1, lambda: False)
    search.run(steps)
    bound = search.bound()
    assert bound.value <= min(int(stage.cost[list(plan)].sum()) for plan in all_plans(stage))
    for landmark in bound.landmarks:
        # The first node goes on without labels that others take: what is kept of its landmarks is made again.
        whole = set(landmark.made_again(stage.network.core).members.tolist())
        assert all(not plan.isdisjoint(whole) for plan in all_plans(stage))
        assert set(landmark.members.tolist()) <= whole


@fewer
@given(problems(special=False))
def test_every_plan_without_what_is_left_out_has_a_label_of_the_landmark(problem: Problem) -> None:
    stage = Stage(problem)
    price = stage.cost.tolist()
    plans = all_plans(stage)
    for left_out in range(len(price)):
        price[left_out] = LEFT_OUT
        ways = Ways(Links(stage.network.core), price)
        if 0 < ways.to_goal < LEFT_OUT:
            members = ways.landmark()
            assert all(price[label] for label in members)
            assert all(not plan.isdisjoint(members) for plan in plans if left_out not in plan)
        price[left_out] = int(stage.cost[left_out])


@fewer
@given(problems(special=False))
def test_branching_finds_a_cheapest_plan_and_no_better_one_than_there_is(problem: Problem) -> None:
    stage = Stage(problem)
    least = min(int(stage.cost[list(plan)].sum()) for plan in all_plans(stage))
    search = Branching(stage.network.core, stage.cost, LIMIT, 1, lambda: False)
    assert search.run(10_000)
    assert search.best is not None
    assert is_plan(stage.network, search.best)
    assert int(stage.cost[list(search.best)].sum()) == least
    strict = Branching(stage.network.core, stage.cost, least, 1, lambda: False)
    assert strict.run(10_000)
    assert strict.best is None


@fewer
@given(problems(special=False))
def test_a_search_step_by_step_ends_with_the_same_plan_and_its_bounds_hold(problem: Problem) -> None:
    stage = Stage(problem)
    whole, parts = (Branching(stage.network.core, stage.cost, LIMIT, 1, lambda: False) for _ in range(2))
    whole.run(10_000)
    shares, bounds = [parts.done], [parts.least]
    while not parts.run(1):
        shares.append(parts.done)
        bounds.append(parts.least)
    assert [*shares, 1.0] == sorted([*shares, parts.done])
    assert parts.best is not None
    assert whole.best is not None
    assert stage.cost[list(parts.best)].sum() == stage.cost[list(whole.best)].sum()
    assert max(bounds) <= stage.cost[list(whole.best)].sum() == whole.least


@pytest.mark.parametrize("seed", [2, 20])
def test_no_bound_of_an_interrupted_search_is_above_the_best_plan_though_some_nodes_ahead_are(seed: int) -> None:
    problem = random_library(seed, transformations=20, depth=3, targets=2)
    structure = Structure.of(problem, None, Clock())
    weight = LexicographicWeights.of(problem, structure.network).weight
    search = Branching(structure.network.core, weight, 2**50, 1, lambda: False)
    bounds = []
    while not search.run(1):
        bounds.append(search.least)
        assert search.best is None or search.least <= weight[list(search.best)].sum()
    assert bounds == sorted(bounds)
    assert bounds[-1] <= search.least


@fewer
@given(problems(special=False))
def test_others_are_all_labels_of_plans_below_the_limit_but_those_of_one(problem: Problem) -> None:
    stage = Stage(problem)
    plans = all_plans(stage)
    best = min(plans, key=lambda plan: (int(stage.cost[list(plan)].sum()), sorted(plan)))
    for more in (1, 3):
        limit = int(stage.cost[list(best)].sum()) + more
        search = Branching(stage.network.core, stage.cost, limit, 1, lambda: False)
        others = search.others(sorted(best), 10_000)
        lean = [p for p in plans if not any(q < p for q in plans)]
        below = [plan for plan in lean if int(stage.cost[list(plan)].sum()) < limit]
        assert others is not None
        assert others >= set().union(*below) - best


@fewer
@given(problems(special=False))
def test_the_weight_of_labels_is_never_more_than_what_a_plan_costs_and_changes(problem: Problem) -> None:
    stage = Stage(problem)
    weights = LexicographicWeights.with_changes(problem, stage.network)
    changes = stage.plan.change_set
    assert weights is not None
    assert changes is not None
    key = Key(0, (), stage.plan.cost_us or 0, len(changes.rewired), len(changes.started))
    weight = weights.of_plan(np.array(sorted(stage.numbers(stage.used)), np.int64))
    assert weight <= weights.of_key(key)
    assert weights.cost_us(weights.of_key(key)) == stage.plan.cost_us


def test_a_small_problem_is_decided_without_the_solver_and_with_too_few_steps_by_it() -> None:
    library = make("source", gives="A"), make("one", "A", "B", labor=2), make("two", gives="BC", labor=4)
    problem = world("BC", *library, make("three", "A", "C"))
    quick, thorough = PlannerSession().plan(problem), PlannerSession(USUAL.without_search()).plan(problem)
    assert quick.status is thorough.status is Status.OPTIMAL
    assert quick.cost_us == thorough.cost_us
    assert "nodes" in quick.counts
    assert "rounds" not in quick.counts
    structure = Structure.of(problem, None, Clock())
    hasty, patient = (SolveState(problem, Clock(tuning=Tuning(Decide(steps=steps))), None) for steps in (1, 100))
    assert not decide(SolveRun(hasty, Memory(structure)), structure.network.core)
    assert not hasty.is_over
    assert decide(SolveRun(patient, Memory(structure)), structure.network.core)
    assert patient.is_over
