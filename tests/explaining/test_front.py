"""The cost-quality front: all that no other plan beats, and nothing else."""

from __future__ import annotations

from dataclasses import replace

from cfgplan.domain import Environment, OutputPort, Similarity, Target, Transformation
from cfgplan.explaining import front
from cfgplan.planners import PLANNERS
from cfgplan.planning import Problem
from cfgplan.qualities import Better, Contribution, QualityAttribute, QualityRule, Wish

ERROR = QualityAttribute("error", Better.LOWER, worst=10)
RATE = QualityAttribute("rate", Better.HIGHER, best=10)


def provider(label: str, cost_us: int, error: int, rate: int = 1) -> Transformation:
    stated = (Contribution("error", QualityRule.SET, error), Contribution("rate", QualityRule.SET, rate))
    return Transformation(label, (), (OutputPort("out", "T", stated),), labor_us=cost_us)


def problem(*library: Transformation, max_cost_us: int | None = None) -> Problem:
    target = Target("t", "T", "/t", quality=(Wish("error", 1, weight_us=5_000_000),))
    environment = Environment((), library, (target,), (), (ERROR, RATE))
    return Problem(environment, Similarity({"T": frozenset({"T"})}), 1, max_cost_us)


def points(asked: Problem, attribute: str = "error") -> list[tuple[int, int]]:
    found = front(asked, PLANNERS["cpsat"], "t", attribute)
    assert found.complete
    return [(point.cost_us, point.value) for point in found.points]


CHEAP, BETTER, BEST, BEATEN = provider("a", 1, 9), provider("b", 4, 5), provider("c", 7, 2), provider("d", 5, 6)


def test_the_front_holds_what_no_other_plan_beats() -> None:
    assert points(problem(CHEAP, BETTER, BEST, BEATEN)) == [(1, 9), (4, 5), (7, 2)]


def test_what_costs_the_same_and_is_worse_is_not_on_the_front() -> None:
    assert points(problem(CHEAP, replace(BETTER, labor_us=1))) == [(1, 5)]


def test_the_front_ends_at_the_largest_cost() -> None:
    assert points(problem(CHEAP, BETTER, BEST, max_cost_us=6)) == [(1, 9), (4, 5)]


def test_where_higher_is_better_the_front_rises() -> None:
    asked = problem(provider("a", 1, 0, 2), provider("b", 2, 0, 5), provider("c", 3, 0, 4))
    free = replace(asked, environment=replace(asked.environment, targets=(Target("t", "T", "/t"),)))
    assert points(free, "rate") == [(1, 2), (2, 5)]


def test_the_limit_of_points_leaves_the_best_quality_open() -> None:
    found = front(problem(CHEAP, BETTER, BEST), PLANNERS["cpsat"], "t", "error", most=2)
    assert not found.complete
    assert [point.value for point in found.points] == [9, 5]


def test_without_a_plan_the_front_is_empty_and_complete() -> None:
    assert points(problem()) == []
