"""Reasons why demands can't be met together: minimal, by property against the planner and the oracle."""

from __future__ import annotations

from dataclasses import replace

import pytest
from fleets import fleets
from hypothesis import assume, given
from hypothesis import strategies as st
from worlds import examples, oracle_of, problems

from cfgplan.domain import Environment, Host, InputPort, OutputPort, Similarity, Target, Transformation
from cfgplan.explaining.limits import Limit, limits_of, without_limits
from cfgplan.explaining.what_if import only_targets, requiring
from cfgplan.explaining.why_not import WhyNot, demanding, why_not
from cfgplan.planners import PLANNERS
from cfgplan.planning import REFUSED, Feature, Plan, Problem, Status

many = examples(80)
fewer = examples(80, part=2)
cpsat = PLANNERS["cpsat"]


def oracle(problem: Problem) -> Plan:
    """The exhaustive planner where it is quick; else the exact one, which is held against it elsewhere."""
    size = len(problem.environment.units) + len(problem.environment.library)
    return oracle_of(problem) if size < 5 else PLANNERS["cpsat"](problem)


@many
@given(problems(most=4), st.integers(0, 12))
def test_a_clash_is_minimal_and_there_is_one_for_each_plan_that_fails_though_all_is_in_reach(
    problem: Problem, max_cost_us: int
) -> None:
    problem = replace(problem, max_cost_us=max_cost_us)
    found = why_not(problem, cpsat)
    assume(found.plan.change_set is None)
    reachable = {t.label for t in problem.environment.targets} - {reason.target for reason in found.unreachable}
    problem = only_targets(problem, reachable)
    assert (found.clash is None) == (oracle(problem).change_set is not None or not reachable)
    assume(found.clash)
    assert found.clash is not None
    alone = oracle(demanding(problem, found.clash.demands))
    assert alone.status in REFUSED
    assert alone.cost_us == found.clash.cost_us
    for each in found.clash.demands.each(problem.environment):
        assert oracle(demanding(problem, found.clash.demands.without(each))).status is Status.OPTIMAL


@examples(80, part=8)
@given(fleets(frozenset({Feature.HOSTS, Feature.INSTANCES, Feature.CONFLICTS, Feature.BESIDE, Feature.COUNTS}), most=2))
def test_of_the_limits_those_in_the_way_are_minimal(problem: Problem) -> None:
    found = why_not(problem, cpsat)
    if found.clash is None:
        return
    asked, everything = demanding(problem, found.clash.demands), limits_of(problem)

    def without(*named: Limit) -> Status:
        lifted = {*everything}.difference(found.clash.limits if found.clash else ()).union(named)
        return oracle(without_limits(asked, lifted)).status

    assert without() in REFUSED or not found.clash.limits
    assert not {without(limit) for limit in found.clash.limits} & {*REFUSED}


@pytest.mark.parametrize(
    ("changes", "hosts", "named"),
    [
        ({"on": "gpu"}, (Host("h"),), ["`on` of transformation user"]),
        ({"needs": {"gpu": 1}}, (Host("h"),), ["`needs` of transformation user"]),
        ({"needs": {"power": 3}}, (Host("h", energy=5),), ["`energy` of host h", "`needs` of transformation user"]),
        ({"memory_mb": 9}, (Host("h", memory_mb=5),), ["`memory` of host h"]),
        ({"beside": ("gone",)}, (Host("h"),), ["`with` of transformation user"]),
        ({"conflicts_on_host": ("giver",)}, (Host("h"),), ["`conflicts: host` of transformation user"]),
        (
            {"inputs": (InputPort("i", "Raw", count=3),)},
            (Host("h"), Host("g")),
            ["`count` of input user/i", "`per_host` of transformation giver"],
        ),
    ],
)
def test_a_limit_that_forbids_a_plan_is_named(
    changes: dict[str, object], hosts: tuple[Host, ...], named: list[str]
) -> None:
    provider = Transformation("giver", (), (OutputPort("o", "Raw", serves=1),), per_host=1)
    user = replace(
        Transformation("user", (InputPort("i", "Raw"),), (OutputPort("o", "Wanted"),)),
        **changes,  # type: ignore[arg-type]
    )
    environment = Environment((), (provider, user), (Target("t", "Wanted", "/t"),), hosts)
    found = why_not(Problem(environment, Similarity({t: frozenset({t}) for t in ("Raw", "Wanted")}), 2), cpsat)
    assert found.clash is not None
    assert [str(limit) for limit in found.clash.limits] == named


@fewer
@given(problems(most=4))
def test_what_excludes_a_required_transformation_is_minimal(problem: Problem) -> None:
    found = why_not(problem, cpsat)
    assume(found.unused)
    for unused in found.unused:
        label, others = unused.transformation, set(unused.excluded_by)
        assert oracle(requiring(problem, {label, *others})).unused_required
        for other in others:
            assert not oracle(requiring(problem, {label, *others} - {other})).unused_required


def world(library: list[Transformation], *targets: str, max_cost_us: int | None = None) -> Problem:
    relation = Similarity({tag: frozenset({tag}) for tag in "ABCD"})
    wanted = tuple(Target(tag.lower(), tag, f"/{tag}") for tag in targets)
    return Problem(Environment((), tuple(library), wanted), relation, 1, max_cost_us)


def make(label: str, needs: str, gives: str, cost_us: int = 0, *, required: bool = False) -> Transformation:
    inputs = tuple(InputPort(f"in{i}", tag) for i, tag in enumerate(needs))
    outputs = tuple(OutputPort(f"out{i}", tag) for i, tag in enumerate(gives))
    return Transformation(label, inputs, outputs, labor_us=cost_us, required=required)


def explained(*library: Transformation, targets: str = "A", max_cost_us: int | None = None) -> WhyNot:
    return why_not(world(list(library), *targets, max_cost_us=max_cost_us), cpsat)


def test_targets_that_are_too_dear_together_are_named_without_the_others() -> None:
    found = explained(make("x", "", "A", 4), make("y", "", "B", 5), make("z", "", "C", 1), targets="ABC", max_cost_us=8)
    assert found.clash is not None
    assert found.clash.demands.targets == {"a", "b"}
    assert (found.clash.cost_us, found.clash.max_cost_us) == (9, 8)


def test_a_requirement_that_makes_it_too_dear_is_named() -> None:
    library = make("x", "", "A", 4), make("y", "", "A", 50, required=True)
    found = explained(*library, max_cost_us=8)
    assert found.clash is not None
    assert (found.clash.demands.targets, found.clash.demands.required) == ({"a"}, {"y"})


def test_a_required_transformation_that_can_not_run_says_why() -> None:
    (unused,) = explained(make("x", "", "A"), make("y", "C", "A", required=True)).unused
    assert unused.blocked is not None
    assert unused.blocked.named == {("y", "in0")}


def test_a_required_transformation_that_leads_nowhere_is_excluded_by_none() -> None:
    (unused,) = explained(make("x", "", "A"), make("y", "", "C", required=True)).unused
    assert (unused.blocked, unused.excluded_by) == (None, ())


def test_required_transformations_that_exclude_each_other_are_named() -> None:
    library = make("x", "", "A", 1, required=True), make("y", "", "A", 2, required=True)
    (unused,) = explained(*library).unused
    assert (unused.transformation, unused.excluded_by) == ("y", ("x",))


def test_where_there_is_a_plan_there_is_nothing_to_explain() -> None:
    assert explained(make("x", "", "A")) == WhyNot(cpsat(world([make("x", "", "A")], "A")))
