"""Every planner against the oracle and the judge, on small environments of every kind.

`CFGPLAN_EXAMPLES=20000 pytest tests/planners` runs the long version.
"""

from __future__ import annotations

from dataclasses import replace

import pytest
from alone import plan_alone
from hypothesis import given
from hypothesis import strategies as st
from worlds import examples, histories, oracle_of, problems, reordered

from cfgplan.planners import PLANNERS
from cfgplan.planners.cpsat import PlannerSession
from cfgplan.planners.tuning import USUAL
from cfgplan.planning import Plan, Problem, Status
from cfgplan.validity import plan_violations
from experiments.families.random_library import random_library

many = examples(240)
fewer = examples(240, part=4)


def quality(plan: Plan) -> tuple[object, ...]:
    """What two optimal plans must have in common."""
    changes = plan.change_set
    return (
        plan.status,
        sorted(plan.reasons),
        len(plan.unused_required),
        plan.cost_us,
        changes and len(changes.rewired),
        changes and len(changes.started),
        plan.ties_proven,
    )


CHOOSING = replace(USUAL, decide=replace(USUAL.decide, fewest=0))


def agree(problem: Problem) -> None:
    """The planner, without a search of its own, with the solver's choice among few parts, and the solver alone are as
    good as the oracle.
    """
    oracle = oracle_of(problem)
    assert plan_violations(problem, oracle) == []
    alone = plan_alone(problem)
    others = (PlannerSession(tuning).plan(problem) for tuning in (USUAL.without_search(), CHOOSING))
    for exact in (PLANNERS["cpsat"](problem), *others, alone):
        assert plan_violations(problem, exact) == []
        assert quality(exact) == quality(oracle)
    assert alone.change_set is None or alone.counts["rounds"] > 0


@many
@given(problems(special=False))
def test_cpsat_equals_the_oracle_on_plain_problems(problem: Problem) -> None:
    agree(problem)


@many
@given(problems(most=5))
def test_cpsat_equals_the_oracle_with_pinned_required_distinct_and_feedback(problem: Problem) -> None:
    agree(problem)


@fewer
@given(histories())
def test_cpsat_equals_the_oracle_after_something_happened_to_an_optimal_configuration(
    history: list[tuple[Problem, Plan]],
) -> None:
    agree(history[-1][0])


@pytest.mark.parametrize("seed", range(30))
def test_cpsat_equals_the_oracle_where_all_inputs_are_distinct(seed: int) -> None:
    agree(random_library(seed, transformations=9, depth=3, branching=3, targets=1, distinct=1.0))


@fewer
@given(problems(most=12))
def test_only_a_limit_leaves_something_unproven(problem: Problem) -> None:
    plan = PLANNERS["cpsat"](problem)
    assert plan.status not in (Status.FEASIBLE, Status.UNKNOWN)
    assert plan.ties_proven == (plan.status is Status.OPTIMAL)


@fewer
@given(problems(most=8), st.data())
def test_the_answer_does_not_depend_on_the_run_or_the_order_of_lists(problem: Problem, data: st.DataObject) -> None:
    plan = PLANNERS["cpsat"](problem)
    assert PLANNERS["cpsat"](problem) == plan
    again = PLANNERS["cpsat"](reordered(problem, data.draw))
    assert again == plan
    assert again.reasons == plan.reasons


@many
@given(problems(most=6))
def test_branch_and_bound_is_valid_and_never_beats_the_optimum(problem: Problem) -> None:
    found, exact = PLANNERS["branch-and-bound"](problem, time_limit_s=5), PLANNERS["cpsat"](problem)
    assert plan_violations(problem, found) == []
    assert (found.status is Status.INFEASIBLE) == (exact.status is Status.INFEASIBLE)
    if found.cost_us is not None and exact.cost_us is not None:
        assert (len(found.unused_required), found.cost_us) >= (len(exact.unused_required), exact.cost_us)
    if found.status is Status.FEASIBLE:
        assert exact.status is Status.OPTIMAL or exact.unused_required != found.unused_required
