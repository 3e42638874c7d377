"""The planner for fleets against the oracle and the judge, on small environments that use every feature.

`CFGPLAN_EXAMPLES=5000 pytest tests/planners` runs the long version.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import pytest
from alone import plan_alone, plan_apart, plan_as_fleet
from fleets import KNOWN_TO_BOUNDS, fleets, reordered
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from worlds import examples, oracle_of, problems

from cfgplan.errors import InputError
from cfgplan.planners import PLANNERS
from cfgplan.planners.exact.session import PlannerSession
from cfgplan.planners.tuning import USUAL, Tuning
from cfgplan.planning import Feature, Plan, Problem, Status
from cfgplan.qualities import Better, Wish
from cfgplan.reasons import unmet_reasons
from cfgplan.validity import plan_violations

some = examples(30)


def quality(plan: Plan) -> tuple[object, ...]:
    """What two optimal plans must have in common."""
    changes = plan.change_set
    counts = changes and (len(changes.rewired), len(changes.started))
    return plan.status, len(plan.unused_required), plan.cost_us, counts, plan.ties_proven


def agree(problem: Problem) -> None:
    """The planner and the solver alone, also with every subscription told apart, are as good as the oracle."""
    oracle = oracle_of(problem)
    assert plan_violations(problem, oracle) == []
    for exact in (PLANNERS["cpsat"](problem), plan_alone(problem)):
        assert plan_violations(problem, exact) == []
        assert quality(exact) == quality(oracle)
    if problem.features and not unmet_reasons(problem):
        assert quality(plan_apart(problem)) == quality(oracle)


def agree_with_the_explicit_model(problem: Problem, tuning: Tuning = USUAL) -> None:
    """The planner and the model in which every possible subscription has a boolean."""
    assume(not unmet_reasons(problem))
    fast = PlannerSession(tuning).plan(problem)
    assert plan_violations(problem, fast) == []
    assert quality(fast) == quality(plan_apart(problem))
    assert fast.status not in (Status.FEASIBLE, Status.UNKNOWN)


@st.composite
def asking_for_nothing(draw: st.DrawFn, features: frozenset[Feature], most: int) -> Problem:
    """A fleet whose bounds all lie at the worst of their scales or beyond."""
    problem = draw(fleets(features, most=most))
    environment = problem.environment

    def moved(wish: Wish) -> Wish:
        attribute = environment.quality[wish.attribute]
        beyond = draw(st.sampled_from([0, 1, 7, 30]))
        worse = attribute.worst + beyond if attribute.better is Better.LOWER else max(0, attribute.worst - beyond)
        return replace(wish, bound=worse)

    targets = tuple(replace(t, quality=tuple(moved(wish) for wish in t.quality)) for t in environment.targets)
    return replace(problem, environment=replace(environment, targets=targets))


@examples(80)
@given(asking_for_nothing(frozenset({Feature.QUALITY}), 3))
def test_bounds_at_the_worst_of_the_scale_and_beyond_equal_the_oracle(problem: Problem) -> None:
    agree(problem)


@examples(80)
@given(asking_for_nothing(frozenset({Feature.QUALITY}), 9))
def test_bounds_at_the_worst_of_the_scale_and_beyond_ask_for_nothing(problem: Problem) -> None:
    free = tuple(
        replace(t, quality=tuple(replace(wish, bound=None) for wish in t.quality if wish.weight_us))
        for t in problem.environment.targets
    )
    bounded = PLANNERS["cpsat"](problem)
    assert bounded.status not in (Status.FEASIBLE, Status.UNKNOWN)
    unbounded = PLANNERS["cpsat"](replace(problem, environment=replace(problem.environment, targets=free)))
    assert quality(bounded) == quality(unbounded)


@some
@given(fleets(frozenset({Feature.QUALITY})))
def test_quality_equals_the_oracle(problem: Problem) -> None:
    agree(problem)


@some
@given(fleets(frozenset({Feature.HOSTS})))
def test_hosts_equal_the_oracle(problem: Problem) -> None:
    agree(problem)


@examples(60)
@given(fleets(frozenset({Feature.QUALITY, Feature.HOSTS}), most=2))
def test_quality_learned_on_some_hosts_equals_the_oracle(problem: Problem) -> None:
    environment = problem.environment
    assume(any(one.host for some in environment.taught.values() for one in some))
    agree(problem)


@some
@given(fleets(frozenset({Feature.CONFLICTS, Feature.INSTANCES})))
def test_conflicts_and_instances_equal_the_oracle(problem: Problem) -> None:
    agree(problem)


@some
@given(fleets(frozenset({Feature.SURVIVAL}), most=4))
def test_survival_of_units_equals_the_oracle(problem: Problem) -> None:
    agree(problem)


@examples(30, part=2)
@given(fleets(frozenset({Feature.SURVIVAL, Feature.HOSTS}), most=2))
def test_survival_of_hosts_equals_the_oracle(problem: Problem) -> None:
    agree(problem)


@some
@given(
    st.frozensets(st.sampled_from(sorted(KNOWN_TO_BOUNDS)), min_size=2).flatmap(
        lambda features: fleets(features, most=2)
    )
)
def test_all_features_together_equal_the_oracle(problem: Problem) -> None:
    agree(problem)


@some
@given(problems(most=4, special=False))
def test_the_oracle_and_the_planner_for_fleets_agree_on_what_the_paper_asks(problem: Problem) -> None:
    plans = [PLANNERS["exhaustive"](problem), plan_as_fleet(problem)]
    assert len({quality(plan) for plan in plans}) == 1


@examples(30, part=2)
@given(fleets(KNOWN_TO_BOUNDS, most=3), st.data())
def test_the_plan_for_a_fleet_does_not_depend_on_the_run_or_the_order_of_lists(
    problem: Problem, data: st.DataObject
) -> None:
    plan = PLANNERS["cpsat"](problem)
    assert PLANNERS["cpsat"](problem) == plan
    assert PLANNERS["cpsat"](reordered(problem, data.draw)) == plan


def ever_easier(problem: Problem) -> Iterator[Problem]:
    """Yield a problem, then versions of it that demand ever less: most fleets that are drawn have no plan."""
    yield problem
    unmet = unmet_reasons(problem)
    if met := tuple(target for target in problem.environment.targets if target.label not in unmet):
        yield (problem := problem.with_parts(targets=met) if unmet else problem)
        yield (problem := replace(problem, max_cost_us=None, survive=None))
        yield (problem := problem.with_parts(targets=tuple(replace(target, quality=()) for target in met)))
        free = {"conflicts": (), "conflicts_on_host": (), "beside": (), "min_instances": 0, "max_instances": None}
        anywhere = {"host": None, "hosts": (), "on": None, "per_host": None, "at_most": {}}
        library = tuple(replace(t, **free, **anywhere) for t in problem.environment.library)
        yield problem.with_parts(library=library)


@examples(30)
@given(fleets(KNOWN_TO_BOUNDS, most=3))
def test_the_plan_for_a_fleet_leaves_nothing_to_do(problem: Problem) -> None:
    plans = ((each, PLANNERS["cpsat"](each)) for each in dict.fromkeys(ever_easier(problem)))
    problem, plan = next((one for one in plans if one[1].change_set is not None), (problem, None))
    assume(plan is not None)
    assert plan is not None and plan.change_set is not None
    after = problem.environment.update(plan.change_set)
    again = PLANNERS["cpsat"](replace(problem, environment=after))
    assert again.change_set is not None
    assert again.cost_us is not None and plan.cost_us is not None
    assert again.cost_us <= plan.cost_us


@settings(some, max_examples=5)
@given(problem=fleets(frozenset({Feature.HOSTS})))
def test_a_planner_that_does_not_know_the_features_refuses_them(problem: Problem) -> None:
    with pytest.raises(InputError, match="does not support hosts"):
        PLANNERS["branch-and-bound"](problem)


FLAT = frozenset({Feature.QUALITY, Feature.HOSTS, Feature.CONFLICTS, Feature.INSTANCES})


@some
@given(st.frozensets(st.sampled_from(sorted(FLAT)), min_size=1).flatmap(lambda features: fleets(features, most=9)))
def test_the_planner_equals_the_explicit_model_beyond_the_oracles_reach(problem: Problem) -> None:
    agree_with_the_explicit_model(problem)
