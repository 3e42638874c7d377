"""Alternatives against the oracle asked for every set of transformations."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations

import pytest
from fleets import fleets
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from worlds import problems

from cfgplan.domain import ComputationUnit, Environment, OutputPort, Similarity, Target, Transformation
from cfgplan.errors import InputError
from cfgplan.explaining import alternatives
from cfgplan.planners import PLANNERS
from cfgplan.planning import Failures, Notion, Plan, Problem, Status
from cfgplan.reasons import Givers, startable
from cfgplan.validity import plan_violations

EXAMPLES = int(os.environ.get("CFGPLAN_EXAMPLES", "50"))
many = settings(
    max_examples=EXAMPLES,
    deadline=None,
    derandomize="CFGPLAN_EXAMPLES" not in os.environ,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.filter_too_much],
)
cpsat = PLANNERS["cpsat"]


def key(plan: Plan) -> tuple[int, int, int, int]:
    assert plan.change_set is not None and plan.cost_us is not None
    changes = plan.change_set
    return len(plan.unused_required), plan.cost_us, len(changes.rewired), len(changes.started)


def runs(problem: Problem, plan: Plan) -> frozenset[str]:
    assert plan.change_set is not None
    return frozenset(unit.transformation for unit in problem.environment.update(plan.change_set).units)


def subsets(labels: set[str]) -> Iterator[set[str]]:
    for size in range(len(labels) + 1):
        yield from map(set, combinations(sorted(labels), size))


def every_configuration(problem: Problem) -> dict[frozenset[str], tuple[int, int, int, int]]:
    """For each set of transformations of which all serve a target, or are pinned, the best that runs just these."""
    environment = problem.environment
    possible = startable(environment, Givers(environment.library, problem.similarity))
    running = {unit.transformation for unit in environment.units}
    pinned = {t.label for t in environment.library if t.pinned and t.label in running & possible}
    really = {t.label for t in environment.library if t.required}
    others = [t for t in environment.library if t.label not in pinned]
    found: dict[frozenset[str], tuple[int, int, int, int]] = {}
    for size in range(len(others) + 1):
        for chosen in combinations(others, size):
            labels = {t.label for t in chosen}
            for serving in subsets(really & pinned):
                library = [replace(t, required=True) for t in chosen]
                library += [replace(t, required=t.label in serving) for t in environment.library if t.label in pinned]
                alone = replace(problem, environment=replace(environment, library=tuple(library)), max_cost_us=None)
                plan = PLANNERS["exhaustive" if len(library) + len(environment.units) < 6 else "cpsat"](alone)
                if plan.change_set is None or plan.unused_required or not pinned <= runs(problem, plan):
                    continue
                best = (len(really - labels - serving), *key(plan)[1:])
                which = runs(problem, plan)
                found[which] = min(best, found.get(which, best))
    if problem.max_cost_us is not None:
        return {which: best for which, best in found.items() if best[1] <= problem.max_cost_us}
    return found


@many
@given(
    st.one_of(
        problems(most=4),
        fleets(frozenset({Notion.INSTANCES}), most=3),
        fleets(frozenset({Notion.INSTANCES, Notion.CONFLICTS, Notion.QUALITY}), most=3),
    ),
    st.integers(1, 6),
)
def test_they_are_the_best_of_all_that_run_something_else_in_order(problem: Problem, count: int) -> None:
    free = (replace(t, min_instances=0) for t in problem.environment.library)
    problem = replace(problem, environment=replace(problem.environment, library=tuple(free)))
    assume(cpsat(problem).change_set)
    found = alternatives(problem, cpsat, count)
    expected = every_configuration(problem)
    assert found.complete
    assert [key(plan) for plan in found.plans] == sorted(expected.values())[:count]
    assert found.has_more == (len(expected) > count)
    assert len({runs(problem, plan) for plan in found.plans}) == len(found.plans)
    for plan in found.plans:
        assert plan_violations(problem, plan) == []
        assert key(plan) == expected[runs(problem, plan)]
    assert found.plans[0] == cpsat(problem)
    assert {plan.status for plan in found.plans[1:]} <= {Status.FEASIBLE}


def test_a_pinned_one_that_is_required_takes_no_place_from_what_has_to_serve() -> None:
    output = (OutputPort("o", "A"),)
    library = (Transformation("a", (), output, labor_us=1), Transformation("b", (), output, pinned=True, required=True))
    environment = Environment((ComputationUnit("b.1", "b"),), library, (Target("t", "A", "/t"),))
    found = alternatives(Problem(environment, Similarity({"A": frozenset({"A"})}), 0), cpsat, 3)
    assert [(plan.cost_us, plan.unused_required) for plan in found.plans] == [(0, ()), (1, ("b",))]


def test_where_what_runs_may_serve_no_target_alternatives_are_refused_with_the_reason() -> None:
    camera = Transformation("a", (), (OutputPort("o", "A"),))
    problem = Problem(Environment((), (camera,), (Target("t", "A", "/t"),)), Similarity({"A": frozenset({"A"})}), 0)
    spare = replace(problem, survive=Failures.UNITS)
    twice = replace(problem, environment=replace(problem.environment, library=(replace(camera, min_instances=2),)))
    for refused, why in ((spare, "spares"), (twice, "min_instances")):
        with pytest.raises(InputError, match=why):
            alternatives(refused, cpsat, 3)


def test_where_nothing_can_be_met_there_is_no_alternative_either() -> None:
    environment = Environment((), (Transformation("x", (), (OutputPort("o", "A"),)),), (Target("t", "B", "/t"),))
    found = alternatives(Problem(environment, Similarity({"B": frozenset({"B"})}), 1), cpsat, 3)
    assert (found.plans, found.has_more) == ((), False)
