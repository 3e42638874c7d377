"""The search over sets of units against the oracle: what it proves is the least cost."""

from __future__ import annotations

import pytest
from hypothesis import assume, given
from worlds import examples, oracle_of, problems

from cfgplan.domain import Environment, OutputPort, Similarity, Target, Transformation
from cfgplan.errors import InputError
from cfgplan.planners import PLANNERS
from cfgplan.planning import Problem, Progress, Status
from cfgplan.validity import plan_violations
from experiments.peers import sharing

search = sharing.plan


@examples(250)
@given(problems(most=6))
def test_it_proves_the_cost_that_the_oracle_finds(problem: Problem) -> None:
    assume(not any(transformation.required for transformation in problem.environment.library))
    found, oracle = search(problem), oracle_of(problem)
    assert plan_violations(problem, found) == []
    if oracle.status is Status.OPTIMAL:
        assert (found.status, found.cost_us, found.ties_proven) == (Status.OPTIMAL, oracle.cost_us, False)
    else:
        assert found.status is oracle.status


def shared_by(count: int) -> Problem:
    """`count` targets with a transformation of 10 each, and one of 11 for all."""
    wanted = [f"q{i}" for i in range(count)]
    library = [Transformation(tag, (), (OutputPort("out", tag),), 10) for tag in wanted]
    library.append(Transformation("all", (), tuple(OutputPort(tag, tag) for tag in wanted), 11))
    targets = tuple(Target(tag, tag, f"/{tag}") for tag in wanted)
    return Problem(Environment((), tuple(library), targets), Similarity({tag: frozenset({tag}) for tag in wanted}), 1)


def test_what_is_shared_is_paid_for_once() -> None:
    assert search(shared_by(8)).cost_us == 11
    assert PLANNERS["branch-and-bound"](shared_by(8)).cost_us == 80


def test_a_required_transformation_is_refused() -> None:
    problem = shared_by(2)
    first, *others = problem.environment.library
    library = (Transformation(first.label, (), first.outputs, first.labor_us, required=True), *others)
    environment = Environment((), library, problem.environment.targets)
    with pytest.raises(InputError, match="required"):
        search(Problem(environment, problem.similarity, 1))


def test_the_bound_only_rises_and_the_cost_only_falls() -> None:
    seen: list[Progress] = []
    search(shared_by(5), report=seen.append)
    bounds = [progress.bound_us for progress in seen]
    costs = [progress.cost_us for progress in seen if progress.cost_us is not None]
    assert bounds == sorted(bounds)
    assert costs == sorted(costs, reverse=True)
    assert costs[-1] == 11
