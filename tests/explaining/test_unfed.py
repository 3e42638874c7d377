"""Minimal reasons why a target can't be reached: by example, and by property against planner and oracle."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

from hypothesis import assume, given
from worlds import examples, problems

from cfgplan.domain import Environment, InputPort, OutputPort, Similarity, Target, Transformation
from cfgplan.explaining.unfed import Unreachable, unreachable
from cfgplan.planners import PLANNERS
from cfgplan.planning import Problem, Status

many = examples(200)


def named_alone(problem: Problem, target: str, named: Collection[tuple[str, str]]) -> Problem:
    """The problem of one target in which the transformations have only the named inputs, as transformation and port."""
    environment = problem.environment
    library = tuple(
        replace(t, inputs=tuple(port for port in t.inputs if (t.label, port.name) in named))
        for t in environment.library
    )
    alone = replace(environment, units=(), library=library, targets=(environment.target[target],))
    return replace(problem, environment=alone, max_cost_us=None)


def status(problem: Problem) -> Status:
    """What planner and oracle agree on."""
    found = {PLANNERS[name](problem).status for name in ("cpsat", "exhaustive")}
    assert len(found) == 1
    return found.pop()


def is_minimal(problem: Problem, reason: Unreachable) -> None:
    """What the reason names alone still fails, and without any part of it there is a plan."""
    assert status(named_alone(problem, reason.target, reason.named)) is Status.INFEASIBLE
    for each in reason.named:
        assert status(named_alone(problem, reason.target, reason.named - {each})) is Status.OPTIMAL


@many
@given(problems(most=5))
def test_reasons_are_minimal_and_there_is_one_for_each_target_that_the_planner_can_not_meet(problem: Problem) -> None:
    plan = PLANNERS["cpsat"](problem)
    assume(plan.status is Status.INFEASIBLE)
    reasons = unreachable(problem)
    assert {reason.target for reason in reasons} == set(plan.reasons)
    for reason in reasons:
        is_minimal(problem, reason)


def make(label: str, needs: str, gives: str, distinct: str | None = None) -> Transformation:
    inputs = tuple(InputPort(f"{tag}{i}", tag, distinct=distinct) for i, tag in enumerate(needs))
    return Transformation(label, inputs, tuple(OutputPort(f"out{i}", tag) for i, tag in enumerate(gives)))


def reason(wanted: str, *library: Transformation) -> Unreachable:
    environment = Environment((), library, (Target("q", wanted, "/q"),))
    problem = Problem(environment, Similarity({tag: frozenset(tag) for tag in "ABCDEF"}), 1)
    (found,) = unreachable(problem)
    is_minimal(problem, found)
    return found


def test_a_target_that_nothing_matches_needs_no_input_to_be_named() -> None:
    assert reason("A", make("one", "", "B")).named == frozenset()


def test_an_input_without_a_producer_is_named_with_all_that_rest_on_it() -> None:
    found = reason("C", make("one", "A", "B"), make("two", "B", "C"))
    assert [blocked.transformation for blocked in found.blocked] == ["two", "one"]
    assert found.named == {("two", "B0"), ("one", "A0")}


def test_what_ends_at_something_missing_is_told_rather_than_a_ring() -> None:
    found = reason("A", make("left", "BF", "A"), make("right", "A", "B"))
    assert found.named == {("left", "F1")}


def test_a_ring_names_all_its_members() -> None:
    found = reason("A", make("left", "BE", "A"), make("right", "A", "B"), make("source", "", "E"))
    assert found.named == {("left", "B0"), ("right", "A0")}


def test_a_distinct_group_names_as_many_inputs_as_are_too_many_and_what_can_feed_them() -> None:
    found = reason("B", make("fusion", "AAA", "B", "g"), make("source", "", "A"), make("broken", "C", "A"))
    assert found.named == {("fusion", "A1"), ("fusion", "A2"), ("broken", "C0")}
    assert found.blocked[0].available == ("source",)


def test_a_chain_may_be_as_long_as_it_likes() -> None:
    library = [
        Transformation(f"t{i}", (InputPort("i", f"T{i}"),), (OutputPort("o", f"T{i + 1}"),)) for i in range(2000)
    ]
    tags = Similarity({f"T{i}": frozenset({f"T{i}"}) for i in range(2001)})
    environment = Environment((), tuple(library), (Target("q", "T2000", "/q"),))
    (found,) = unreachable(Problem(environment, tags, 1))
    assert len(found.named) == 2000
