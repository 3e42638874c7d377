"""A generated instance that is exported and loaded again has the same optimum."""

from __future__ import annotations

from pathlib import Path

import pytest

import cfgplan
from cfgplan.domain import Similarity
from cfgplan.errors import InputError
from cfgplan.planning import Problem
from experiments.export import export
from experiments.study.instances import Instance, generated
from experiments.study.suites import tiny


@pytest.mark.parametrize("instance", [*tiny(), generated("nao", robots=2, fusion=2)], ids=lambda each: each.name)
def test_an_exported_instance_solves_to_the_same_cost(instance: Instance, tmp_path: Path) -> None:
    expected = cfgplan.plan(instance.problem)
    problem, plan = cfgplan.solve(cfgplan.load(export(instance.problem, tmp_path)))
    assert (plan.status, plan.cost_us, plan.unused_required) == (
        expected.status,
        expected.cost_us,
        expected.unused_required,
    )
    assert len(problem.environment.units) == len(instance.problem.environment.units)


def test_what_matched_before_matches_after_and_nothing_else(tmp_path: Path) -> None:
    """In the paper's case a fusion's output is both offered and, by the same words, demanded."""
    problem = generated("nao", robots=2, fusion=2).problem
    again = cfgplan.match(cfgplan.load(export(problem, tmp_path)))

    def pairs(asked: Problem) -> set[tuple[str, str]]:
        environment, similarity = asked.environment, asked.similarity
        offers = [(f"{t.label}/{port.name}", port.tag) for t in environment.library for port in t.outputs]
        demands = [(f"{t.label}/{port.name}", port.tag) for t in environment.library for port in t.inputs]
        demands += [(target.label, target.tag) for target in environment.stream_targets]
        return {(one, other) for one, a in offers for other, b in demands if similarity.holds(a, b)}

    assert pairs(again) == pairs(problem)


def test_open_pairs_are_not_exported(tmp_path: Path) -> None:
    environment = generated("nao").problem.environment
    problem = Problem(environment, Similarity({}, {"A": frozenset({"B"})}), 60)
    with pytest.raises(InputError, match="open"):
        export(problem, tmp_path)
