"""Parts of a plan that share nothing: their least costs add up to a bound, and their choice is often a plan."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from kinds import of_one
from test_against_the_oracle import agree, fewer, many
from test_multi_demands import plans
from test_preprocessing import Stage
from worlds import fusions, pipelines, problems

from cfgplan.domain import Environment, InputPort, OutputPort, Similarity, Target, Transformation
from cfgplan.planners.bounding.disjoint import disjoint_bound
from cfgplan.planners.cpsat import PlannerSession
from cfgplan.planners.networks.core import Core, Rows
from cfgplan.planners.networks.greedy import is_plan
from cfgplan.planning import Problem, Status
from experiments.families.nao import nao
from experiments.families.random_library import random_library

Drawn = tuple[Core, list[int]]
"""A core, and the cost of each label."""


def core_of(needs: list[list[int]], providers: list[list[int]], takes: list[int], cost: list[int]) -> Drawn:
    return Core(Rows.of(needs), Rows.of(providers), takes=np.array(takes)), cost


@st.composite
def cores(draw: st.DrawFn) -> Drawn:
    """Up to seven labels and six facts, which may need each other in cycles."""
    labels, facts = draw(st.integers(3, 7)), draw(st.integers(2, 6))
    one, fact = st.integers(0, labels - 1), st.integers(0, facts - 1)
    needs = [sorted(draw(st.sets(fact, max_size=2))) for _ in range(labels)]
    wanted = sorted(draw(st.sets(fact, min_size=1, max_size=3)))
    providers = [sorted(draw(st.sets(one, min_size=1, max_size=3))) for _ in range(facts)]
    takes = [draw(st.integers(1, min(2, len(row)))) for row in providers]
    return core_of([*needs, wanted], providers, takes, [draw(st.integers(1, 9)) for _ in needs])


def are_met(core: Core, chosen: set[int]) -> bool:
    """Whether the choice has enough providers of what the goal and each of its labels need; cycles count."""
    assert core.takes is not None
    needed = {fact for label in (*chosen, core.goal) for fact in core.needs.lists[label]}
    return all(len(chosen.intersection(core.providers.lists[fact])) >= core.takes[fact] for fact in needed)


def least_cost(core: Core, cost: list[int]) -> int:
    choices = [set(chosen) for size in range(core.goal + 1) for chosen in combinations(range(core.goal), size)]
    return min(sum(cost[label] for label in chosen) for chosen in choices if are_met(core, chosen))


@many
@given(cores())
def test_no_choice_that_meets_all_needs_costs_less_than_disjoint_parts(drawn: Drawn) -> None:
    assert disjoint_bound(*drawn, ())[0] <= least_cost(*drawn)


@pytest.mark.parametrize(
    ("drawn", "least"),
    [
        pytest.param(core_of([[], [], [], [0, 1]], [[0, 1], [0, 2]], [1, 1], [5, 5, 5]), 5, id="gives both facts"),
        pytest.param(core_of([[], [0], [], [0, 1]], [[0], [1, 2]], [1, 1], [7, 1, 9]), 8, id="needs what is forced"),
        pytest.param(
            core_of(
                [[4], [], [2], [3], [], [], [], [], [1, 0]],
                [[2, 3, 4], [0, 1], [0, 5], [0, 6], [7]],
                [2, 1, 1, 1, 1],
                [1, 1, 1, 1, 90, 90, 90, 50],
            ),
            53,
            id="shared behind an alternative that comes first",
        ),
    ],
)
def test_a_label_is_counted_once(drawn: Drawn, least: int) -> None:
    assert least_cost(*drawn) == least
    assert disjoint_bound(*drawn, ())[0] <= least


def bounded(stage: Stage) -> tuple[int, set[int]]:
    return disjoint_bound(stage.network.core, stage.cost.tolist(), stage.network.pinned)


@fewer
@given(st.one_of(fusions(), pipelines(), problems(most=5)))
def test_parts_that_share_nothing_never_cost_more_than_a_plan(problem: Problem) -> None:
    assume(not any(port.feedback for t in problem.environment.library for port in t.inputs))
    stage = Stage(replace(problem, environment=replace(problem.environment, units=())))
    value, _ = bounded(stage)
    for plan in plans(stage, problem):
        assert value <= int(stage.cost[sorted(plan)].sum())


@fewer
@given(pipelines())
def test_the_bound_is_met_by_its_choice_where_pipelines_share_nothing(problem: Problem) -> None:
    assume(not any(t.label == "shared" for t in problem.environment.library))
    stage = Stage(problem)
    value, chosen = bounded(stage)
    assert is_plan(stage.network, chosen)
    assert value == int(stage.cost[sorted(chosen)].sum())


@fewer
@given(pipelines())
def test_fused_pipelines_are_planned_as_well_as_by_the_oracle(problem: Problem) -> None:
    agree(problem)


def with_second_cameras(problem: Problem) -> Problem:
    """The problem with a second camera and a second segmenter for each robot, which cost a thousandth more."""
    others = [
        replace(t, label=f"second {t.label}", labor_us=t.labor_us + t.labor_us // 1000)
        for t in problem.environment.library
        if t.label.startswith(("bottom_cam", "segmenter"))
    ]
    environment = problem.environment
    return replace(problem, environment=replace(environment, library=(*environment.library, *others)))


@pytest.mark.parametrize("event", ["registered", "lost", "left"])
@pytest.mark.parametrize("has_alternatives", [False, True])
def test_fused_robots_need_neither_landmarks_nor_the_solver(event: str, has_alternatives: bool) -> None:
    problem = nao(8342, robots=20, fusion=10, event=event)
    found = PlannerSession().plan(with_second_cameras(problem) if has_alternatives else problem)
    assert (found.status, found.ties_proven) == (Status.OPTIMAL, True)
    assert found.counts.keys().isdisjoint({"landmarks", "rounds"})


def test_parts_are_not_looked_for_where_many_demands_leave_a_choice() -> None:
    problem = random_library(0, transformations=300, targets=1, distinct=0.5)
    with patch("cfgplan.planners.exact.stages.disjoint_bound", side_effect=AssertionError):
        assert PlannerSession().plan(problem).status is Status.OPTIMAL


def test_a_fusion_within_a_fusion_is_bounded_by_the_cheapest_of_both() -> None:
    def made(label: str, inputs: str, output: str, labor_us: int) -> Transformation:
        ports = tuple(InputPort(f"i{i}", tag, distinct="g") for i, tag in enumerate(inputs))
        return Transformation(label, ports, (OutputPort("x", output),), labor_us)

    library = [made(f"{tag}{i}", "", tag, 1 + i) for tag in "AB" for i in range(4)]
    library += [made("a", "AA", "C", 10), made("b", "BB", "C", 20), made("c", "AA", "C", 40), made("q", "CC", "Q", 0)]
    tags = {tag: frozenset({tag}) for tag in "ABCQ"}
    problem = Problem(Environment((), tuple(library), (Target("Q", "Q", "/Q"),)), Similarity(tags), 0)
    found = PlannerSession().plan(problem)
    assert of_one(problem) == []
    assert found.cost_us == 10 + 3 + 20 + 3


def test_alternatives_within_alternatives_are_bounded_however_deep_they_are() -> None:
    depth = 1200
    ends = [[label, depth + label] for label in range(depth)]
    needs = [*([label + 1] for label in range(depth - 1)), [], *([] for _ in range(depth)), [0]]
    core = Core(Rows.of(needs), Rows.of(ends))
    value, chosen = disjoint_bound(core, [1] * depth + [2 * depth] * depth, ())
    assert 0 < value <= depth
    assert 0 in chosen
