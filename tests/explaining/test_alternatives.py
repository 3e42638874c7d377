"""Alternatives against the oracle asked for every set of transformations."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from fleets import fleets
from hypothesis import assume, given
from hypothesis import strategies as st
from worlds import examples, few_steps, problems

from cfgplan.domain import ComputationUnit, Environment, InputPort, OutputPort, Similarity, Target, Transformation
from cfgplan.errors import InputError
from cfgplan.explaining import alternatives
from cfgplan.planners import PLANNERS, exhaustive
from cfgplan.planners.exhaustive import OracleRank
from cfgplan.planning import Failures, Feature, Plan, Problem
from cfgplan.validity import plan_violations

many = examples(50)
cpsat = PLANNERS["cpsat"]


def key(plan: Plan) -> OracleRank:
    assert plan.change_set is not None and plan.cost_us is not None
    changes = plan.change_set
    return OracleRank(len(plan.unused_required), (), plan.cost_us, len(changes.rewired), len(changes.started))


def runs(problem: Problem, plan: Plan) -> frozenset[str]:
    assert plan.change_set is not None
    return frozenset(unit.transformation for unit in problem.environment.update(plan.change_set).units)


def pinned_where_it_runs(problem: Problem) -> Problem:
    """The judge lets a pinned unit run that no target needs; a plan that starts one would do so in vain."""
    environment = problem.environment
    running = {unit.transformation for unit in environment.units}
    library = tuple(replace(t, pinned=t.pinned and t.label in running) for t in environment.library)
    return replace(problem, environment=replace(environment, library=library))


def every_configuration(problem: Problem) -> dict[frozenset[str], OracleRank]:
    """For each set of transformations the best valid configuration that runs just these and starts nothing in vain."""
    found: dict[frozenset[str], OracleRank] = {}
    try:
        with few_steps():
            for rank, after in exhaustive.configurations(pinned_where_it_runs(problem)):
                if problem.max_cost_us is None or rank.cost_us <= problem.max_cost_us:
                    which = frozenset(unit.transformation for unit in after.units)
                    found[which] = min(rank, found.get(which, rank))
    except InputError:  # it takes the oracle more than its most steps
        assume(False)
    return found


@st.composite
def with_some_that_stay(draw: st.DrawFn) -> Problem:
    """A problem with a pinned unit that runs, or one that `min_instances` asks for, and inputs to feed."""
    problem = draw(problems(most=3))
    environment = problem.environment
    fed = [t.label for t in environment.library if t.inputs]
    assume(fed)
    label = draw(st.sampled_from(fed))
    least = draw(st.integers(0, 2))
    stays = {"min_instances": least} if least else {"pinned": True}
    library = tuple(replace(t, **stays) if t.label == label else t for t in environment.library)
    units = environment.units
    if not least and label not in {unit.transformation for unit in units}:
        units = (*units[:2], ComputationUnit(f"{label}.9", label))
    return replace(problem, environment=replace(environment, library=library, units=units), max_cost_us=None)


def may_feed_what_stays(problem: Problem) -> bool:
    """Whether something required may feed what runs whether a target needs it or not."""
    library = problem.environment.library
    stays = [t for t in library if t.pinned or t.min_instances]
    return any(t.inputs for t in stays) and any(t.required and not t.pinned for t in library)


@many
@given(
    st.one_of(
        with_some_that_stay(),
        problems(most=3),
        fleets(frozenset({Feature.INSTANCES}), most=3),
        fleets(frozenset({Feature.INSTANCES, Feature.CONFLICTS, Feature.QUALITY}), most=3),
    ),
    st.integers(1, 6),
)
def test_they_are_the_best_of_all_that_run_something_else_in_order(problem: Problem, count: int) -> None:
    assume(cpsat(problem).change_set)
    found = alternatives(problem, cpsat, count)
    expected = every_configuration(problem)
    assert found.complete or may_feed_what_stays(problem)
    assert [key(plan) for plan in found.plans] == sorted(expected.values())[
        : count if found.complete else len(found.plans)
    ]
    assert found.has_more == (len(expected) > count) or not found.complete
    assert len({runs(problem, plan) for plan in found.plans}) == len(found.plans)
    for plan in found.plans:
        assert plan_violations(problem, plan) == []
        assert key(plan) == expected[runs(problem, plan)]
    assert found.plans[0] == cpsat(problem)
    assert not any(plan.ties_proven for plan in found.plans[1:])


def test_no_pinned_one_is_started_that_no_target_needs() -> None:
    library = [Transformation(label, (), (OutputPort("o", "A"),), pinned=label == "b") for label in "ab"]
    environment = Environment((), tuple(library), (Target("t", "A", "/t"),))
    found = alternatives(Problem(environment, Similarity({"A": frozenset({"A"})}), 0), cpsat, 3)
    assert [[unit.transformation for unit in plan.change_set.started] for plan in found.plans if plan.change_set] == [
        ["a"],
        ["b"],
    ]
    assert not found.has_more


def test_a_pinned_one_that_is_required_takes_no_place_from_what_has_to_serve() -> None:
    output = (OutputPort("o", "A"),)
    library = (Transformation("a", (), output, labor_us=1), Transformation("b", (), output, pinned=True, required=True))
    environment = Environment((ComputationUnit("b.1", "b"),), library, (Target("t", "A", "/t"),))
    found = alternatives(Problem(environment, Similarity({"A": frozenset({"A"})}), 0), cpsat, 3)
    assert [(plan.cost_us, plan.unused_required) for plan in found.plans] == [(0, ()), (1, ("b",))]


def test_what_feeds_pinned_units_alone_hides_no_alternative() -> None:
    log = Transformation("log", (InputPort("i", "M"),), (OutputPort("o", "L"),), pinned=True)
    providers = [Transformation(label, (), (OutputPort("o", label[0]),), int(label[1])) for label in ("M1", "M2", "S1")]
    library = (log, *providers, Transformation("S2", (), (OutputPort("o", "S"),), 3))
    environment = Environment((ComputationUnit("log.1", "log"),), library, (Target("t", "S", "/t"),))
    problem = Problem(environment, Similarity({tag: frozenset({tag}) for tag in "MSL"}), 0)
    found = alternatives(problem, cpsat, 9)
    assert [(plan.cost_us, *sorted(runs(problem, plan) - {"log"})) for plan in found.plans] == [
        (2, "M1", "S1"),
        (3, "M2", "S1"),
        (4, "M1", "S2"),
        (5, "M2", "S2"),
    ]
    assert not found.has_more


def test_where_spares_serve_no_target_alternatives_are_refused_with_the_reason() -> None:
    camera = Transformation("a", (), (OutputPort("o", "A"),))
    problem = Problem(Environment((), (camera,), (Target("t", "A", "/t"),)), Similarity({"A": frozenset({"A"})}), 0)
    with pytest.raises(InputError, match="spares"):
        alternatives(replace(problem, survive=Failures.UNITS), cpsat, 3)


def test_where_nothing_can_be_met_there_is_no_alternative_either() -> None:
    environment = Environment((), (Transformation("x", (), (OutputPort("o", "A"),)),), (Target("t", "B", "/t"),))
    found = alternatives(Problem(environment, Similarity({"B": frozenset({"B"})}), 1), cpsat, 3)
    assert (found.plans, found.has_more) == ((), False)


def test_where_an_open_pair_decides_what_comes_next_the_list_ends_after_few_looks() -> None:
    """`free` is the optimum whatever matches; the second one is `dear`, or `open` if C is W."""
    library = tuple(
        Transformation(label, (), (OutputPort("o", tag),), labor_us=labor_us)
        for label, tag, labor_us in (("free", "W", 1), ("dear", "W", 9), ("open", "C", 5))
    )
    environment = Environment((), library, (Target("t", "W", "/t"),))
    problem = Problem(environment, Similarity({"W": frozenset("W")}, {"W": frozenset("C")}), 1)
    looks = 0

    def planner(problem: Problem, **options: Any) -> Plan:
        nonlocal looks
        looks += 1
        assert looks <= 20
        return cpsat(problem, **options)

    found = alternatives(problem, planner, 3)
    assert [runs(problem, plan) for plan in found.plans] == [{"free"}]
    assert (found.complete, found.has_more) == (False, True)
