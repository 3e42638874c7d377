"""Words that do nothing cost nothing, and what is left of a problem has the whole problem's optimum."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import pytest
from kinds import differences
from worlds import oracle_of

from cfgplan.domain import (
    ComputationUnit,
    Environment,
    Host,
    InputPort,
    Objective,
    OutputPort,
    Publication,
    Similarity,
    Stream,
    Subscription,
    Target,
    Transformation,
)
from cfgplan.planners import PLANNERS
from cfgplan.planners.exact.session import PlannerSession
from cfgplan.planners.reducing.reduce import Numbered, Reduced, reduce
from cfgplan.planners.solving.clock import Clock
from cfgplan.planning import Plan, Problem, Progress, Status
from cfgplan.qualities import Better, QualityAttribute, Wish
from cfgplan.validity import plan_violations
from experiments.families.random_library import random_library


def give(
    label: str, *tags: str, takes: Mapping[str, str] | None = None, labor_us: int = 1, **said: object
) -> Transformation:
    inputs = tuple(InputPort(name, tag) for name, tag in (takes or {}).items())
    outputs = tuple(OutputPort(tag.lower(), tag) for tag in tags)
    return Transformation(label, inputs, outputs, labor_us, **said)  # type: ignore[arg-type]


def wanting(*tags: str, library: tuple[Transformation, ...], horizon_s: int = 1, **said: object) -> Problem:
    targets = tuple(Target(tag, tag, f"/{tag}") for tag in tags)
    known = {port.tag for t in library for port in (*t.inputs, *t.outputs)} | {*tags}
    similarity = Similarity({tag: frozenset({tag}) for tag in known})
    return Problem(Environment((), library, targets, **said), similarity, horizon_s)  # type: ignore[arg-type]


def left_of(problem: Problem) -> Reduced:
    return reduce(problem, Clock())


def planned(problem: Problem) -> Plan:
    """The plan, which is as good as the oracle's."""
    found = PLANNERS["cpsat"](problem)
    assert differences(problem, found, oracle_of(problem)) == []
    return found


def test_an_optional_input_without_worth_costs_nothing_where_the_plan_uses_it() -> None:
    plain = random_library(1, transformations=300, targets=3)
    before = PLANNERS["cpsat"](plain)
    assert before.change_set is not None
    used = min(unit.transformation for unit in before.change_set.started)
    tag = plain.environment.library[0].outputs[0].tag
    library = tuple(
        replace(t, inputs=(*t.inputs, InputPort("more", tag, optional=True))) if t.label == used else t
        for t in plain.environment.library
    )
    problem = plain.with_parts(library=library)
    found = PLANNERS["cpsat"](problem)
    assert plan_violations(problem, found) == []
    assert (found.status, found.cost_us, found.ties_proven) == (Status.OPTIMAL, before.cost_us, True)


def test_an_input_that_starts_nothing_is_fed_by_what_runs() -> None:
    view = replace(
        give("view", "V", takes={"a": "A"}), inputs=(InputPort("a", "A"), InputPort("b", "B", optional=True))
    )
    found = planned(wanting("V", "B", library=(give("a", "A"), give("b", "B"), view)))
    assert found.change_set is not None
    (unit,) = [unit for unit in found.change_set.started if unit.transformation == "view"]
    assert unit.feeds["b"] == (Stream("b.1", "b"),)


def test_of_plans_that_cost_the_same_the_one_is_taken_that_feeds_no_further_input_of_what_runs() -> None:
    """One of two that give C gives B too, which a running unit would have to take."""
    view = replace(give("view", "V"), inputs=(InputPort("b", "B", optional=True),))
    runs = ComputationUnit("view.1", "view", (), (Publication("v", "/V"),))
    library = (give("both", "B", "C"), give("other", "C"), view)
    problem = wanting("C", "V", library=library).with_parts(units=(runs,))
    found = planned(problem)
    assert found.change_set is not None
    assert [unit.id for unit in found.change_set.started] == ["other.1"]
    assert not found.change_set.rewired
    assert found.ties_proven


def test_a_unit_keeps_the_stream_of_an_input_that_starts_nothing() -> None:
    view = replace(give("view", "V"), inputs=(InputPort("b", "B", optional=True),))
    units = (
        ComputationUnit("one.1", "one", (), (Publication("b", "/B"),)),
        ComputationUnit("two.1", "two"),
        ComputationUnit("view.1", "view", (Subscription("b", Stream("two.1", "b")),), (Publication("v", "/V"),)),
    )
    library = (give("one", "B"), replace(give("two", "B"), pinned=True), view)
    found = planned(wanting("B", "V", library=library).with_parts(units=units))
    assert not found.change_set


def test_an_input_that_takes_all_streams_stays_in_the_model_as_it_may_forbid_a_plan() -> None:
    every = replace(give("every", "A", "V"), inputs=(InputPort("b", "B", optional=True, count=0),))
    back = give("back", "B", takes={"a": "A"})
    problem = wanting("V", "B", library=(every, back))
    assert not left_of(problem).problem.is_plain
    assert planned(problem).status is Status.INFEASIBLE


@pytest.mark.parametrize("room", [2, 3, 10])
def test_hosts_are_left_out_where_one_bears_all_and_else_they_count(room: int) -> None:
    library = tuple(give(label, label.upper(), memory_mb=2) for label in "abcd")
    problem = wanting("A", "B", library=library, hosts=(Host("h", memory_mb=room), Host("k", memory_mb=2)))
    left = left_of(problem)
    assert (left.problem.is_plain, left.is_roomy) == (True, room == 10)
    found = planned(problem)
    assert found.change_set is not None
    assert {unit.host for unit in found.change_set.started} == ({"h"} if room == 10 else {"h", "k"})


def test_rent_and_the_number_of_hosts_are_told_of_a_plan_that_was_made_without_hosts() -> None:
    hosts = (Host("dear", rent_us=5), Host("cheap", rent_us=3))
    problem = wanting("A", library=(give("a", "A"),), hosts=hosts, minimise=(Objective.HOSTS, Objective.RENT))
    assert left_of(problem).problem.is_plain
    found = planned(problem)
    assert [(one.objective, one.value, one.bound) for one in found.objectives] == [
        (Objective.HOSTS, 1, 1),
        (Objective.RENT, 3, 3),
        (Objective.COST, 4, 4),
    ]


def test_a_plan_starts_as_many_units_as_the_whole_problem_allows() -> None:
    """An input that nothing wants takes two streams of A: so two units may give it, as two targets need it."""
    a = give("a", "A")
    counting = replace(give("counting", "C"), inputs=(InputPort("a", "A", count=2),))
    problem = wanting("A", library=(replace(a, outputs=(replace(a.outputs[0], serves=1),)), counting))
    problem = problem.with_parts(targets=(*problem.environment.targets, Target("second", "A", "/second")))
    left = left_of(problem).problem
    assert isinstance(left, Numbered)
    assert [t.label for t in left.environment.library] == ["a"]
    found = planned(problem)
    assert found.change_set is not None
    assert len(found.change_set.started) == 2


def test_a_required_transformation_that_can_never_be_used_is_named() -> None:
    library = (give("a", "A", max_instances=2), replace(give("hopeless", "X", takes={"g": "G"}), required=True))
    found = planned(wanting("A", library=library))
    assert found.unused_required == ("hopeless",)
    assert found.required_proven


def test_a_quality_that_every_stream_has_asks_for_nothing() -> None:
    error = QualityAttribute("error", Better.LOWER, worst=9)
    problem = wanting("A", library=(give("a", "A"),), qualities=(error,))
    target = replace(problem.environment.targets[0], quality=(Wish("error", 9),))
    assert left_of(problem.with_parts(targets=(target,))).problem.is_plain


def test_a_session_replans_what_is_left_as_it_replans_a_plain_problem() -> None:
    plain = random_library(2, transformations=100, targets=3)
    unusable = replace(give("unusable", "X", takes={"g": "G"}), max_instances=3)
    problem = plain.with_parts(library=(*plain.environment.library, unusable))
    session = PlannerSession()
    first = session.plan(problem)
    running = replace(problem, environment=problem.after(first))
    assert not session.plan(running).change_set
    dead = running.environment.units[0]
    broken = replace(running, environment=running.environment.without_unit(dead.id))
    warm, cold = session.plan(broken), PLANNERS["cpsat"](broken)
    assert (warm.status, warm.cost_us, warm.ties_proven) == (cold.status, cold.cost_us, cold.ties_proven)
    assert plan_violations(broken, warm) == []


def test_why_a_target_can_t_be_met_is_told_of_the_whole_library() -> None:
    problem = wanting("A", library=(give("a", "A", takes={"g": "G"}, max_instances=1),))
    found = PLANNERS["cpsat"](problem)
    assert found.reasons == {"A": "target A wants A, but input g of a needs G, and no output matches"}


def test_progress_does_not_fall_back_where_a_problem_is_planned_again() -> None:
    """`home` lacks room for what is best without hosts; then an input that is fed afterwards rewires a unit."""
    library = tuple(give(label, label.upper(), memory_mb=2) for label in "abcd")
    tight = wanting("A", "B", library=library, hosts=(Host("h", memory_mb=3), Host("k", memory_mb=2)))
    view = replace(give("view", "V"), inputs=(InputPort("b", "B", optional=True),))
    runs = ComputationUnit("view.1", "view", (), (Publication("v", "/V"),))
    tied = wanting("C", "V", library=(give("both", "B", "C"), give("other", "C"), view)).with_parts(units=(runs,))
    for problem in (tight, tied):
        told: list[Progress] = []
        PLANNERS["cpsat"](problem, report=told.append)
        bounds = [one.bound_us for one in told]
        costs = [one.cost_us for one in told if one.cost_us is not None]
        assert bounds == sorted(bounds)
        assert costs == sorted(costs, reverse=True)
        assert told[-1].cost_us == told[-1].bound_us
