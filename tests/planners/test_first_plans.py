"""Plans for fleets before any model is built: valid whatever is asked, and there where they are easy to see."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from unittest.mock import patch

import numpy as np
import pytest
from fixed import kind, unit
from fixed import world as fixed_world
from fleets import TOGETHER, fleets
from hypothesis import assume, given
from hypothesis import strategies as st
from test_fleets_against_the_oracle import some
from test_planners import make, world
from worlds import fusions, problems

from cfgplan.domain import ComputationUnit, Environment, Host, InputPort
from cfgplan.planners import PLANNERS
from cfgplan.planners.closing.program import label_kinds
from cfgplan.planners.exact.candidates import Candidates
from cfgplan.planners.exact.first_plans import FirstPlans
from cfgplan.planners.exact.grounded import Grounded
from cfgplan.planners.exact.memory import Structure
from cfgplan.planners.exact.session import offer_running_units
from cfgplan.planners.exact.solve_state import SolveState
from cfgplan.planners.exact.survivors import survive_without
from cfgplan.planners.networks.greedy import plan_at
from cfgplan.planners.networks.network import costs
from cfgplan.planners.networks.reach import Reach
from cfgplan.planners.solving.clock import Clock
from cfgplan.planners.tuning import USUAL
from cfgplan.planning import Failures, Feature, Plan, Problem, Status
from cfgplan.reasons import startable, unmet_reasons
from cfgplan.validity import plan_violations
from experiments.fleet import instances


def first(problem: Problem) -> Plan:
    state = SolveState(problem, Clock(), None)
    FirstPlans(Candidates(problem), state).look(USUAL.begin.attempts)
    return state.plan()


@some
@given(st.frozensets(st.sampled_from(sorted(TOGETHER)), min_size=1).flatmap(lambda features: fleets(features, most=3)))
def test_first_plans_are_valid_and_no_better_than_the_optimum(problem: Problem) -> None:
    assume(not unmet_reasons(problem))
    found = first(problem)
    assert plan_violations(problem, found) == []
    if found.cost_us is not None and not found.unused_required:
        best = PLANNERS["cpsat"](problem)
        assert best.cost_us is not None
        assert [one.value for one in best.measured] <= [one.value for one in found.measured]


@some
@given(fleets(frozenset({Feature.SURVIVAL, Feature.HOSTS, Feature.QUALITY}), most=9))
def test_first_plans_are_valid_beyond_the_oracles_reach(problem: Problem) -> None:
    assume(not unmet_reasons(problem))
    assert plan_violations(problem, first(problem)) == []


def what_runs(problem: Problem) -> Plan:
    state = SolveState(problem, Clock(), None)
    offer_running_units(state)
    return state.plan()


@some
@given(st.frozensets(st.sampled_from(sorted(TOGETHER))).flatmap(lambda features: fleets(features, most=9)))
def test_what_runs_is_a_valid_plan_or_none(problem: Problem) -> None:
    found = what_runs(problem)
    assert plan_violations(problem, found) == []
    if found.change_set is not None:
        assert not found.change_set.started


def test_what_runs_is_rewired_where_a_feeder_is_gone_and_keeps_its_hosts_and_spares() -> None:
    two, cold = (Host("h0"), Host("h1")), ComputationUnit("s.3", "s", host="h0", standby=True)
    library = (kind("s", gives="A", standby_us=1), kind("f", "A", "B", max_instances=2))
    there = (unit("s", host="h1", number=2), unit("f", "s.1/x0", topic="B", host="h0"), cold)
    other = unit("f", "s.2/x0", host="h1", number=2)
    problem = fixed_world("B", *library, units=(*there, other), hosts=two, survive=Failures.HOSTS)
    changes = what_runs(problem).change_set
    assert changes is not None
    assert [one.id for one in changes.rewired] == ["f.1"]
    assert (changes.started, changes.stopped) == ((), ())


def test_a_unit_runs_only_if_its_feedback_inputs_are_fed_too() -> None:
    loop = replace(make("loop", gives="A"), inputs=(InputPort("in", "B", feedback=True),))
    candidates = Candidates(world("A", make("source", gives="A"), make("back", gives="B"), loop))
    numbers = [candidates.index_of[unit_id] for unit_id in ("source.1", "loop.1", "back.1")]
    assert Grounded(candidates, numbers[:2], None).order == [numbers[0]]
    assert sorted(Grounded(candidates, numbers, None).order) == sorted(numbers)


@pytest.mark.parametrize("group", [None, "g"])
def test_a_feedback_input_that_may_stay_unfed_and_has_no_feeder_does_not_keep_a_unit_from_running(
    group: str | None,
) -> None:
    back = InputPort("back", "nothing", group, feedback=True, optional=True)
    problem = fixed_world("B", kind("s", gives="A"), replace(make("f", gives="B"), inputs=(InputPort("in", "A"), back)))
    network = Candidates(problem).network
    price = np.ones(len(network.labels))
    assert plan_at(network, [1, 1], price) == {0, 1}
    assert plan_at(network, [1, 1], price.tolist()) == {0, 1}
    assert len(set(label_kinds(network, np.ones(2, np.int64)))) == 2
    assert plan_violations(problem, PLANNERS["cpsat"](problem)) == []


def test_a_first_plan_pays_for_each_of_several_different_feeders() -> None:
    fuse = kind("fuse", "AA", "D", distinct=(0, 1))
    feeders = [kind(label, gives="A", labor_us=cost) for label, cost in (("a", 5), ("b", 6), ("c", 7))]
    network = Candidates(fixed_world("D", *feeders, fuse, kind("alone", gives="D", labor_us=10))).network
    cost = [one.labor_us for one in network.transformations]
    assert plan_at(network, cost, [float(one) for one in cost]) == {network.number["alone"]}


@pytest.mark.parametrize(
    "problem",
    [
        instances.weighted(0, 100),
        instances.bounded(0, 100),
        instances.hosted(0, 100),
        instances.surviving(0, 100),
        replace(instances.hosted(0, 60, hosts=4, tight=False), survive=Failures.HOSTS),
    ],
    ids=["weighed", "bounded", "hosts", "lost units", "lost hosts"],
)
def test_there_is_a_first_plan(problem: Problem) -> None:
    found = first(problem)
    assert found.status is Status.FEASIBLE
    assert plan_violations(problem, found) == []


@some
@given(st.one_of(problems(most=9), fusions()))
def test_a_small_network_has_the_same_first_plan_in_lists_as_in_arrays(problem: Problem) -> None:
    network = Structure.of(problem, None, Clock()).network
    cost = costs(problem, network)[1]
    prices = [float(one) + 1.0 for one in cost]
    assert network.core.is_small
    assert plan_at(network, cost, prices) == plan_at(network, np.array(cost), np.array(prices))


@some
@given(problems(most=9, special=False), st.data())
def test_what_is_reached_is_the_closure_of_what_was_added_and_not_taken_back(
    problem: Problem, data: st.DataObject
) -> None:
    assume(not unmet_reasons(problem))
    candidates = Candidates(problem)
    network, reach = candidates.network, Reach(candidates.network.core)
    there: set[str] = set()
    for number in data.draw(st.permutations(range(len(network.labels)))):
        reach.add(number)
        if data.draw(st.booleans()):
            there.add(network.labels[number])
        else:
            reach.take_back()
        library = tuple(t for t in problem.environment.library if t.label in there)
        possible = startable(Environment((), library), candidates.providers)
        assert {network.labels[n] for n in range(len(network.labels)) if reach.runs(n)} == possible
        for target in problem.environment.targets:
            assert reach.holds(network.fact_of_tag.get(target.tag)) == (
                not possible.isdisjoint(candidates.providers.of(target.tag))
            )


def test_spares_are_dropped_one_by_one_with_a_look_at_the_clock_before_each() -> None:
    seen: list[str] = []

    def look(_: Clock) -> None:
        seen.append("look")

    def drop(candidates: Candidates, units: list[ComputationUnit], one: ComputationUnit) -> bool:
        seen.append("drop")
        return survive_without(candidates, units, one)

    with patch.object(Clock, "_check", look), patch("cfgplan.planners.exact.pruning.survive_without", drop):
        first(instances.surviving(0, 40, 2))
    dropped = [before for before, after in pairwise(seen) if after == "drop"]
    assert dropped
    assert set(dropped) == {"look"}


@pytest.mark.parametrize(
    ("problem", "attempts"),
    [
        (instances.both(0, 30, 3), USUAL.begin.attempts),
        (instances.weighted(0, 30, 3), USUAL.begin.attempts),
        (instances.hosted(0, 30, 3), 0),
    ],
    ids=["quality", "weighed", "hosts alone"],
)
def test_members_of_a_small_first_plan_are_tried_to_be_left_out_where_quality_counts(
    problem: Problem, attempts: int
) -> None:
    with patch.object(FirstPlans, "look", autospec=True, side_effect=FirstPlans.look) as look:
        PLANNERS["cpsat"](problem)
    assert [call.args[1] for call in look.call_args_list][:1] == [attempts]
