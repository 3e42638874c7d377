"""Missed landmarks, repairs and the linear program bring bound and plan together, and say nothing untrue."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace
from itertools import combinations
from unittest import mock

import numpy as np
import pytest
from alone import network_of
from hypothesis import given
from test_against_the_oracle import fewer
from test_preprocessing import Stage
from worlds import problems

from cfgplan.costs import start_cost_us
from cfgplan.planners.bounding.bounds import Bound, tightened
from cfgplan.planners.bounding.landmarks import Landmark, landmark_of
from cfgplan.planners.closing.gap import GapClosing, Repairs
from cfgplan.planners.closing.neighbourhoods import Neighbourhoods
from cfgplan.planners.closing.program import LandmarkProgram
from cfgplan.planners.closing.separation import Separator
from cfgplan.planners.cpsat import PlannerSession
from cfgplan.planners.exact.memory import Structure
from cfgplan.planners.networks.core import Core, Rows
from cfgplan.planners.networks.greedy import first_plan, is_plan
from cfgplan.planners.networks.network import Network, costs
from cfgplan.planners.solving.clock import Clock
from cfgplan.planners.tuning import Close, Decide, Near, Rise, Tuning
from cfgplan.planning import Problem, Progress, Status
from cfgplan.reasons import Providers
from cfgplan.validity import plan_violations
from experiments.families.random_library import random_library

LONG = Tuning(close=Close(work=1e6))


def closing(stage: Stage, close: Close) -> GapClosing:
    plan = first_plan(stage.network, stage.cost, 0, Clock())
    assert plan is not None
    bound = Bound(stage.network.core, stage.cost)
    return GapClosing(stage.network, bound, stage.cost, np.array(sorted(plan), np.int64), 1, Tuning(close=close))


@pytest.mark.parametrize("close", [Close(work=1e3), Close(work=1e3, many=0, part=2.0)])
@fewer
@given(problem=problems(special=False))
def test_the_bound_stays_below_the_optimum_and_the_plan_above(close: Close, problem: Problem) -> None:
    stage = Stage(problem)
    both = closing(stage, close)
    both.go_on(Clock())
    assert both.bound.value <= (stage.plan.cost_us or 0) <= both.limit
    assert is_plan(stage.network, set(both.plan.tolist()))
    used = stage.numbers(stage.used)
    left = set(both.bound.core.labels[both.bound.may_be_used(both.limit)].tolist())
    if both.bound.value <= (stage.plan.cost_us or 0) < both.limit:
        assert used <= left


def test_bounds_that_are_cut_short_at_any_round_are_no_worse_than_before() -> None:
    problem = random_library(2, transformations=60)
    network = Structure.of(problem, None, Clock()).network
    cost = np.array([start_cost_us(t, problem.horizon_s) for t in network.transformations], np.int64)
    plan = np.array(sorted(first_plan(network, cost, 0, Clock()) or ()), np.int64)
    solve, values = LandmarkProgram.solve, []
    for rounds in range(12):
        left = iter(range(rounds))
        both = GapClosing(network, Bound(network.core, cost), cost, plan, 1, LONG)
        with mock.patch.object(
            LandmarkProgram, "solve", lambda *of, left=left: None if next(left, None) is None else solve(*of)
        ):
            both.go_on(Clock())
        values.append(both.bound.value)
    assert values == sorted(values)


@fewer
@given(problems(special=False))
def test_labels_miss_a_landmark_exactly_if_they_are_no_plan(problem: Problem) -> None:
    stage = Stage(problem)
    core = stage.network.core
    separator = Separator(core)
    used = stage.numbers(stage.used)
    for size in range(core.goal + 1):
        for chosen in combinations(range(core.goal), size):
            fractions = np.zeros(core.goal)
            fractions[list(chosen)] = 1.0
            missed = separator.missed(fractions, np.random.default_rng(0))
            assert all(set(chosen).isdisjoint(one.members.tolist()) for one in missed)
            assert all(used & set(one.members.tolist()) for one in missed)
            within = first_plan(stage.network, np.where(fractions > 0, 1, 10**6), 0, Clock())
            assert bool(missed) == (within is None or not within <= set(chosen))


@fewer
@given(problems(special=False))
def test_repairs_give_plans_that_are_never_dearer(problem: Problem) -> None:
    stage = Stage(problem)
    plan = first_plan(stage.network, stage.cost, 0, Clock())
    assert plan is not None
    repairs = Repairs(stage.network, stage.cost, plan)
    repairs.attempt(30, stage.cost + 1.0, lambda: False)
    assert is_plan(stage.network, repairs.best)
    assert stage.cost[sorted(repairs.best)].sum() <= stage.cost[sorted(plan)].sum()


def test_a_new_beginning_that_is_dearer_leaves_the_best_plan_as_it_was() -> None:
    problem = random_library(3, transformations=80, targets=4)
    structure = Structure.of(problem, None, Clock())
    cost = np.array(costs(problem, structure.network)[1], np.int64)
    plan = first_plan(structure.network, cost, 20, Clock())
    assert plan is not None
    repairs = Repairs(structure.network, cost, plan, Close(in_vain=0, noise=1.0))
    found = []
    for _ in range(20):
        repairs.attempt(1, cost + 1.0, lambda: False)
        found.append(int(cost[sorted(repairs.best)].sum()))
    assert found == sorted(found, reverse=True)


def test_the_linear_program_charges_a_landmark_of_each_pair_of_three_half_of_its_price() -> None:
    pairs = [Landmark(np.array([0]), np.array(pair)) for pair in combinations(range(3), 2)]
    core = Core(Rows.of([[], [], [], []]), Rows.of([]))
    program = LandmarkProgram(core, np.arange(3), np.array([11, 11, 11]))
    assert program.add(pairs[0])
    fractions = program.solve(None)
    assert fractions is not None
    assert program.value == pytest.approx(11)
    assert [program.add(pair) for pair in pairs] == [False, True, True]
    fractions = program.solve(None)
    assert fractions is not None
    assert fractions == pytest.approx([0.5, 0.5, 0.5])
    assert program.value == pytest.approx(16.5)
    assert program.bound(pairs).value == 17, "a plan costs a whole number"


def test_a_landmark_that_is_known_twice_is_charged_once() -> None:
    pairs = [list(pair) for pair in combinations(range(3), 2)]
    core = Core(Rows.of([[], [], [], [0, 1, 2]]), Rows.of(pairs))
    landmarks = [landmark_of(core, [fact]) for fact in (0, 0, 1, 2)]
    cost = np.array([10, 10, 10])
    both = GapClosing(network_of(core), Bound(core, cost, landmarks, [5, 5, 0, 0], 10), cost, np.array([0, 1]), 1, LONG)
    both.go_on(Clock())
    assert both.bound.value == 15


def test_a_plan_that_needs_the_solver_is_the_same_every_time() -> None:
    problem = random_library(3, transformations=120, targets=4, arity=3)
    plans = [PlannerSession().plan(problem) for _ in range(2)]
    assert plans[0].status is Status.OPTIMAL
    assert plans[0].change_set == plans[1].change_set
    assert plan_violations(problem, plans[0]) == []
    assert plans[0].counts["rounds"] > 0


EVERYWHERE = Near(targets=1, gap=0.0, hopeless=0.0, many=0, fewest=1, in_vain=200.0)


def test_closing_goes_on_if_the_time_left_is_too_short_for_the_solver_and_no_targets_are_replanned() -> None:
    problem = random_library(5, transformations=300, targets=12)
    values = []
    for patience, targets in ((0.0, 13), (1e9, 13), (1e9, 12)):
        tuning = Tuning(close=Close(pace=1.0), rise=Rise(last_patience=patience), near=Near(targets=targets))
        both = first_closing(problem, tuning=tuning)
        both.go_on(Clock(1000.0))
        values.append(both.bound.value)
    assert values[0] == values[2] < values[1]


@pytest.mark.parametrize(
    ("many", "hopeless", "goes_on", "times"), [(0, 0.0, False, 4), (10_000, 0.0, True, 16), (0, 1.1, True, 16)]
)
def test_more_repairs_and_cuts_are_left_out_where_targets_are_replanned_next_for_most_of_the_time(
    many: int, hopeless: float, goes_on: bool, times: int
) -> None:
    near = Near(targets=1, gap=0.0, many=many, hopeless=hopeless)
    tuning = Tuning(close=Close(many=0, part=0.0, rounds=1, fewest_rounds=1, pace=0.0, work=1e3), near=near)
    both = first_closing(random_library(5, transformations=300, targets=12), tuning=tuning)
    with (
        mock.patch.object(Repairs, "attempt", autospec=True, side_effect=Repairs.attempt) as attempt,
        mock.patch.object(Separator, "missed", autospec=True, side_effect=Separator.missed) as missed,
    ):
        both.go_on(Clock())
    assert (attempt.call_count > 1) == goes_on
    assert missed.call_count > 1
    assert {call.args[3] for call in missed.call_args_list} == {times}


@fewer
@given(problems(special=False))
def test_related_targets_planned_anew_make_a_plan_no_dearer_and_leave_it_a_plan(problem: Problem) -> None:
    stage = Stage(problem)
    plan = first_plan(stage.network, stage.cost, 0, Clock())
    assert plan is not None
    bound, before = Bound(stage.network.core, stage.cost), np.array(sorted(plan), np.int64)
    both = GapClosing(stage.network, bound, stage.cost, before, 1, Tuning(near=EVERYWHERE))
    both.look_near(Clock())
    assert both.bound.value <= (stage.plan.cost_us or 0) <= both.limit <= int(stage.cost[before].sum())
    assert is_plan(stage.network, set(both.plan.tolist()))


def first_closing(problem: Problem, near: Near = EVERYWHERE, tuning: Tuning | None = None) -> GapClosing:
    """The closing of a problem, from a greedy plan and without landmarks."""
    network = Structure.of(problem, None, Clock()).network
    cost = np.array([start_cost_us(t, problem.horizon_s) for t in network.transformations], np.int64)
    plan = np.array(sorted(first_plan(network, cost, 0, Clock()) or ()), np.int64)
    return GapClosing(network, Bound(network.core, cost), cost, plan, 1, tuning or Tuning(near=near))


def test_linear_programs_of_a_part_find_landmarks_that_the_one_of_all_labels_misses() -> None:
    problem = random_library(5, transformations=300, targets=12)
    both, best = first_closing(problem), PlannerSession().plan(problem)
    assert best.status is Status.OPTIMAL and best.change_set is not None
    network = Structure.of(problem, None, Clock()).network
    used = {network.number[unit.transformation] for unit in best.change_set.started}
    program, landmarks, _ = both._restricted()
    fractions = program.solve(None)
    assert fractions is not None
    both._charge(program, landmarks)
    _, found = both._likely_landmarks(both._promising(0.03), Clock())
    assert min(one.hit_by(fractions) for one in found) < 0.9
    assert not any(used.isdisjoint(both.bound.core.labels[one.members].tolist()) for one in found)


def test_neighbourhoods_grow_towards_all_targets_while_they_are_searched_soon() -> None:
    near = replace(EVERYWHERE, growth=2.0)
    both, sizes = first_closing(random_library(5, transformations=300, targets=30), near), list[int]()
    replan = Neighbourhoods._near

    def seen(self: Neighbourhoods, free: set[int], clock: Clock) -> None:
        sizes.append(len(free))
        replan(self, free, clock)

    search = both._neighbourhoods(1.0)
    with mock.patch.object(Neighbourhoods, "_near", seen):
        for _ in range(15):
            search.go_on(Clock())
    wanted = len(both.bound.core.needs[both.bound.core.goal])
    assert sizes[0] == 1 and min(sizes[-5:]) >= wanted / 2 and max(sizes) > 24


def test_a_kernel_has_the_labels_of_the_plan_and_those_used_more_than_a_fraction() -> None:
    near = replace(EVERYWHERE, kernels=(0.5, 0.0))
    both = first_closing(random_library(5, transformations=300, targets=12), near)
    both.go_on(Clock())
    plan, fractions = set(both.plan.tolist()), both._fractions
    search = both._neighbourhoods(1.0)
    with mock.patch.object(Neighbourhoods, "_cheapest", return_value=frozenset()) as cheapest:
        search.go_on(Clock())
    kernels = [call.args[0].core.labels.tolist() for call in cheapest.call_args_list]
    for kernel, least in zip(kernels, near.kernels, strict=True):
        assert set(kernel) <= plan.union(np.flatnonzero(fractions > least).tolist())
    assert len(kernels[0]) < len(kernels[1])


@pytest.mark.parametrize("seed", [3, 4])
def test_all_targets_planned_anew_together_reach_the_optimum_and_some_come_near_it(seed: int) -> None:
    problem = random_library(seed, transformations=100, targets=12)
    best = PlannerSession().plan(problem)
    assert best.status is Status.OPTIMAL and best.cost_us is not None
    all_targets = Near(targets=1, gap=0.0, many=0, fewest=12, work=100.0)
    whole, parts = first_closing(problem, all_targets), first_closing(problem)
    before = whole.limit
    assert before > best.cost_us
    whole.look_near(Clock())
    parts.look_near(Clock())
    assert whole.limit == best.cost_us <= parts.limit < before


def test_no_landmarks_are_looked_for_everywhere_while_few_labels_are_left() -> None:
    few = first_closing(random_library(5, transformations=300, targets=12), replace(EVERYWHERE, many=301))
    with mock.patch.object(GapClosing, "_search_landmarks", side_effect=AssertionError):
        few.look_near(Clock())


@pytest.mark.parametrize("many", [0, 301])
def test_targets_are_replanned_for_a_shorter_time_if_few_labels_are_left(many: int) -> None:
    near = replace(EVERYWHERE, many=many, soon=0.0)
    with mock.patch.object(Neighbourhoods, "go_on", side_effect=InterruptedError):
        both = first_closing(random_library(5, transformations=300, targets=12), near)
        with nullcontext() if many else pytest.raises(InterruptedError):
            both.look_near(Clock())


def test_no_target_is_planned_anew_where_a_plan_is_more_than_its_labels() -> None:
    both = first_closing(random_library(3, transformations=60, targets=10, distinct=0.5))
    before = both.plan.tolist()
    with mock.patch.object(Neighbourhoods, "go_on", side_effect=AssertionError):
        both.look_near(Clock())
    assert both.plan.tolist() == before


def test_landmarks_are_looked_for_until_none_is_missed_and_raise_the_bound() -> None:
    problem = random_library(5, transformations=300, targets=12)
    best = PlannerSession().plan(problem)
    assert best.status is Status.OPTIMAL and best.cost_us is not None
    both = first_closing(problem)
    both.go_on(Clock())
    before = both.bound.value
    with mock.patch.object(Neighbourhoods, "are_in_vain", return_value=True):
        both.look_near(Clock())
    assert before < both.bound.value <= best.cost_us
    program, _, separator = both._restricted()
    fractions = program.solve(None)
    assert fractions is not None
    assert both.is_closed or not separator.missed(fractions, np.random.default_rng(1), everywhere=True)


def first_bound(problem: Problem, rise: Rise) -> tuple[float, int]:
    """The share of a first plan's cost that the first landmarks prove, and the number of labels that are left."""
    library = problem.environment.library
    tags = [target.tag for target in problem.environment.targets]
    network = Network(library, tags, [], Providers(library, problem.similarity))
    cost = np.array([start_cost_us(one, problem.horizon_s) for one in library], np.int64)
    plan = first_plan(network, cost, 0, Clock())
    assert plan is not None
    limit = int(cost[sorted(plan)].sum())
    bound = tightened(Bound(network.core, cost), limit, limit, Clock(tuning=Tuning(rise=rise)), greedily=True)
    return bound.value / limit, bound.core.goal


def test_landmarks_are_looked_for_longer_while_reduced_costs_leave_labels_out() -> None:
    one_target = random_library(2, transformations=10_000, targets=1, branching=20)
    value, labels = first_bound(one_target, Rise())
    assert value > 0.7
    assert labels < 6000
    assert first_bound(one_target, Rise(narrowed=0.0))[0] < 0.55
    many_targets = random_library(1, transformations=3000, targets=10)
    all_stay = first_bound(many_targets, Rise())
    assert all_stay[1] == 3000
    assert first_bound(many_targets, Rise(narrowed=0.0)) == all_stay


@pytest.mark.parametrize("stage", ["go_on", "look_near"])
def test_cheaper_plans_and_higher_bounds_are_told_while_the_gap_is_being_closed(stage: str) -> None:
    problem = random_library(5, transformations=300, targets=12)
    told, is_inside, real = list[Progress](), False, getattr(GapClosing, stage)

    def watched(self: GapClosing, *given: object) -> None:
        nonlocal is_inside
        is_inside = True
        real(self, *given)
        is_inside = False

    session = PlannerSession(Tuning(decide=Decide(labels=0), near=EVERYWHERE))
    with mock.patch.object(GapClosing, stage, watched):
        found = session.plan(problem, report=lambda progress: told.append(progress) if is_inside else None)
    assert found.cost_us is not None
    costs, bounds = [one.cost_us or 0 for one in told], [one.bound_us for one in told]
    assert costs == sorted(costs, reverse=True) and bounds == sorted(bounds)
    assert bounds[-1] <= found.cost_us <= costs[-1]
    assert len({*zip(costs, bounds, strict=True)}) == len(told) > 1
