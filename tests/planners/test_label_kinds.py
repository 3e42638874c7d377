"""Of transformations that meet the same demands a cheapest plan has one, unless somebody wants different ones."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from alone import network_of
from fixed import kind, world
from hypothesis import given
from test_against_the_oracle import fewer
from test_preprocessing import Stage
from worlds import problems

from cfgplan.planners.closing.program import LandmarkProgram, label_kinds
from cfgplan.planners.exact.memory import Structure
from cfgplan.planners.networks.core import Core, Rows
from cfgplan.planners.solving.clock import Clock
from cfgplan.planning import Problem

PAIRS = [list(pair) for pair in combinations(range(3), 2)]


def any_two_of_three() -> Core:
    """The goal needs fact 3, offered by labels 3 to 5, each fed by two of facts 0 to 2, which labels 0 to 2 offer."""
    return Core(
        Rows.of([[], [], [], *PAIRS, [3]]),
        Rows.of([[0], [1], [2], [3, 4, 5]]),
    )


def test_labels_alike_need_together_what_some_of_them_need() -> None:
    cost = np.array([10, 10, 10, 1, 1, 1])
    kinds = label_kinds(network_of(any_two_of_three()), cost)
    assert kinds.tolist() == [0, 1, 2, 3, 3, 3]
    together = LandmarkProgram(any_two_of_three(), kinds, cost)
    apart = LandmarkProgram(any_two_of_three(), np.arange(6), cost)
    assert together.solve(None) is not None
    assert apart.solve(None) is not None
    assert together.value == pytest.approx(21)
    assert together.bound([]).value == 21
    assert not together.bound([]).residual.any()
    assert apart.value == pytest.approx(11)


def test_labels_that_feed_distinct_inputs_are_alike_with_none() -> None:
    def kinds(distinct: tuple[int, ...]) -> list[int]:
        library = (kind("s", gives="A"), kind("t", gives="A"), kind("f", "AA", "B", distinct=distinct))
        network = Structure.of(world("B", *library), None, Clock()).network
        assert network.labels == ["f", "s", "t"]
        return label_kinds(network, np.ones(3, np.int64)).tolist()

    assert kinds(()) == [0, 1, 1]
    assert kinds((0, 1)) == [0, 1, 2]


def test_labels_that_cost_nothing_are_alike_with_none() -> None:
    assert label_kinds(network_of(any_two_of_three()), np.array([1, 1, 1, 0, 0, 1])).tolist() == [0, 1, 2, 3, 4, 5]


@fewer
@given(problems(special=False))
def test_an_optimal_plan_has_at_most_one_of_those_alike(problem: Problem) -> None:
    stage = Stage(problem)
    kinds = label_kinds(stage.network, stage.cost)
    used = [kinds[label] for label in stage.numbers(stage.used)]
    assert len(used) == len(set(used))


@fewer
@given(problems(special=False))
def test_what_is_fed_is_a_bound_at_any_cost(problem: Problem) -> None:
    stage = Stage(problem)
    program = LandmarkProgram(stage.network.core, label_kinds(stage.network, stage.cost), stage.cost)
    program.solve(None)
    bound = program.bound([])
    assert (bound.residual >= 0).all()
    used = sorted(stage.numbers(stage.used))
    assert bound.value + int(bound.residual[used].sum()) <= int(stage.cost[used].sum())
