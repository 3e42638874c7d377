"""Planning by counting: what it takes on, and that it says what the planner of named units says."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product
from operator import mul

import pytest
from fixed import kind, world
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from kinds import ALIKE, COUNTABLE, as_good, differences
from worlds import oracle_of

from cfgplan.domain import ComputationUnit, Host, InputPort, Objective, OutputPort, Transformation
from cfgplan.planners.cpsat import PlannerSession
from cfgplan.planners.exact.candidates import Candidates
from cfgplan.planners.exact.groups import groups_of, host_kinds, is_countable
from cfgplan.planners.exact.patterns import Patterns
from cfgplan.planners.solving.clock import Clock
from cfgplan.planners.tuning import Tuning
from cfgplan.planning import Failures, Plan, Problem, Status
from cfgplan.validity import plan_violations
from experiments.families.deployments import deployment, with_a_ring, with_one_word

THREE = tuple(Host(f"h{n}", memory_mb=4) for n in range(3))


def counted(problem: Problem) -> Plan:
    """The plan, which is made by counting."""
    assert is_countable(Candidates(problem))
    found = PlannerSession().plan(problem)
    assert not plan_violations(problem, found)
    assert "groups" in found.counts
    return found


def named(problem: Problem) -> Plan:
    """The plan of the solver that names each unit and host."""
    return PlannerSession(Tuning.solver_only()).plan(problem)


def replicas(number: int, **more: object) -> Transformation:
    return replace(kind("s", gives="A"), min_instances=number, max_instances=number, memory_mb=2, **more)  # type: ignore[arg-type]


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.filter_too_much])
@given(COUNTABLE)
def test_counting_agrees_with_naming_and_with_the_oracle(problem: Problem) -> None:
    found, alike = PlannerSession().plan(problem), PlannerSession(ALIKE).plan(problem)
    assert not differences(problem, found, oracle_of(problem))
    assert as_good(found) == as_good(alike) == as_good(named(problem))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("minimise", [(Objective.COST,), (Objective.HOSTS, Objective.UNITS)])
def test_a_deployment_is_proven_as_with_names(seed: int, minimise: tuple[Objective, ...]) -> None:
    problem = deployment(seed, minimise=minimise)
    found, alike = counted(problem), PlannerSession(ALIKE).plan(problem)
    assert found.status is Status.OPTIMAL
    assert as_good(found) == as_good(alike) == as_good(named(problem))


ONE_WORD = {
    "feedback": {"feedback": True},
    "worth": {"optional": True, "worth_us": 1_000},
    "distinct": {"distinct": "d"},
}


@pytest.mark.parametrize("said", ONE_WORD.values(), ids=ONE_WORD)
def test_one_word_does_not_end_the_counting_of_all_others(said: Mapping[str, object]) -> None:
    """By names these are open after a quarter of a minute."""
    found = counted(with_one_word(deployment(1, hosts=20, replicas=6), **said))
    assert found.status is Status.OPTIMAL
    assert found.counts["groups"] <= 18 and found.counts["kinds of hosts"] == 2


@pytest.mark.parametrize("said", ONE_WORD.values(), ids=ONE_WORD)
def test_units_that_are_told_apart_beside_counted_ones_are_proven_as_with_names(said: Mapping[str, object]) -> None:
    problem = with_one_word(deployment(0, hosts=4), **said)
    assert as_good(PlannerSession(ALIKE).plan(problem)) == as_good(named(problem))


def test_units_that_might_feed_each_other_do_not_end_the_counting_of_all_others() -> None:
    """By names two of three have no plan after 11 and 20 s of CPU time."""
    found = counted(with_a_ring(deployment(1, hosts=20, replicas=6)))
    assert found.status is Status.OPTIMAL
    assert found.counts["groups"] < 30 and found.counts["kinds of hosts"] == 2


@pytest.mark.parametrize("seed", [0, 3])
def test_counted_units_beside_a_ring_are_proven_as_with_names(seed: int) -> None:
    problem = with_a_ring(deployment(seed, hosts=4))
    assert as_good(PlannerSession(ALIKE).plan(problem)) == as_good(named(problem))


@pytest.mark.parametrize("serves", [None, 1])
def test_counted_units_do_not_ground_a_ring(serves: int | None) -> None:
    """Twelve units of `f` are wanted; `g` could feed them for less than `a`, but needs one of them."""
    source = Transformation("a", (), (OutputPort("o", "A", serves=serves),), upkeep_us=90)
    fed = Transformation("f", (InputPort("i", "A"),), (OutputPort("o", "B"),), upkeep_us=1, max_instances=12)
    back = Transformation("g", (InputPort("i", "B"),), (OutputPort("o", "A"),), upkeep_us=5, max_instances=12)
    reader = Transformation("r", (InputPort("i", "B", count=12),), (OutputPort("o", "C"),), upkeep_us=1)
    problem = world("C", source, fed, back, reader, replace(replicas(4), outputs=(OutputPort("o", "D"),)), hosts=THREE)
    found = PlannerSession(ALIKE).plan(problem)
    assert (found.status, found.counts["groups"]) == (Status.OPTIMAL, 27)
    assert found.cost_us == (14_000_107 if serves is None else 15_000_112), "each start costs a second but for `s`"


def test_a_required_transformation_does_not_end_the_counting_of_others() -> None:
    problem = deployment(1, hosts=8)
    library = tuple(replace(t, required=t.label == "agent") for t in problem.environment.library)
    asked = replace(problem, environment=replace(problem.environment, library=library))
    found = counted(asked)
    assert found.status is Status.OPTIMAL
    assert as_good(found) == as_good(named(asked))


def test_a_required_transformation_that_no_numbers_let_serve_a_target_is_proven_unused() -> None:
    alone = replace(kind("x", gives="X"), required=True)
    problem = world("A", replicas(4), alone, hosts=THREE)
    found = counted(problem)
    assert (found.status, found.unused_required) == (Status.OPTIMAL, ("x",))
    assert as_good(found) == as_good(named(problem))


def test_each_new_unit_with_an_optional_input_is_a_group_and_so_is_whom_it_takes_all_of() -> None:
    reader = Transformation("f", (InputPort("i", "A", count=2, optional=True, worth_us=5),), (OutputPort("o", "B"),))
    problem = world("B", replicas(3), replace(reader, max_instances=2))
    groups = groups_of(Candidates(problem))
    assert [*map(len, groups)].count(1) == len(groups)


@pytest.mark.parametrize("seed", [203, 209])
def test_hosts_that_are_limited_together_bear_what_they_bear_one_by_one(seed: int) -> None:
    """Where the units that are best by numbers do not fit."""
    problem = deployment(seed, hosts=12, replicas=4)
    assert as_good(PlannerSession(ALIKE).plan(problem)) == as_good(counted(problem))


@st.composite
def on_one_host(draw: st.DrawFn) -> tuple[Transformation, ...]:
    """Transformations whose units take room, are alone, few or in company on a host with room for 6."""
    labels = "abcd"
    return tuple(
        replace(
            kind(label, gives=label.upper()),
            max_instances=9,
            memory_mb=draw(st.integers(1, 6)),
            per_host=draw(st.none() | st.integers(1, 2)),
            conflicts_on_host=draw(st.sampled_from([(), *((one,) for one in labels if one != label)])),
            beside=draw(st.sampled_from([(), *((one,) for one in labels if one < label)])),
        )
        for label in labels
    )


def bears(library: Sequence[Transformation], numbers: Sequence[int]) -> bool:
    """Whether a host with room for 6 can have so many units of each."""
    there = {t.label: number for t, number in zip(library, numbers, strict=True) if number}
    kinds = [t for t in library if t.label in there]
    return (
        sum(t.memory_mb * there[t.label] for t in kinds) <= 6
        and all(t.per_host is None or there[t.label] <= t.per_host for t in kinds)
        and all(other not in there for t in kinds for other in t.conflicts_on_host)
        and all(other in there for t in kinds for other in t.beside)
    )


@settings(max_examples=40, deadline=None)
@given(on_one_host(), st.lists(st.integers(0, 6), min_size=4, max_size=4), st.integers(1, 4))
def test_a_limit_forbids_these_units_and_nothing_that_hosts_can_have(
    library: tuple[Transformation, ...], numbers: list[int], hosts: int
) -> None:
    candidates = Candidates(world("ABCD", *library, hosts=[Host(f"h{n}", memory_mb=6) for n in range(4)]))
    groups = groups_of(candidates)
    (alike,) = host_kinds(candidates)
    patterns = Patterns(candidates, groups, alike)
    place = {t.label: i for i, t in enumerate(library)}
    labels = [candidates.all[group[0]].transformation.label for group in groups]
    there = {n: numbers[place[label]] for n, label in enumerate(labels)}
    if patterns.is_too_much(there, hosts, Clock()):
        (limit,) = patterns.limits
        of = [limit.of.get(n, 0) for n in sorted(there, key=lambda n: place[labels[n]])]
        assert sum(map(mul, of, numbers)) > limit.most * hosts
        assert all(sum(map(mul, of, one)) <= limit.most for one in product(range(7), repeat=4) if bears(library, one))
    else:
        assert not patterns.limits


def test_four_units_of_which_a_host_bears_one_are_too_much_for_three_hosts() -> None:
    candidates = Candidates(world("A", replace(replicas(4), memory_mb=3), hosts=THREE))
    groups = groups_of(candidates)
    patterns = Patterns(candidates, groups, *host_kinds(candidates))
    assert not patterns.is_too_much({0: 3}, 3, Clock())
    assert patterns.is_too_much({0: 4}, 3, Clock())
    assert patterns.limits[0].of[0] == patterns.limits[0].most


def test_new_units_of_a_transformation_are_one_group_and_hosts_alike_are_one_kind() -> None:
    candidates = Candidates(world("A", replicas(4), hosts=THREE))
    groups = groups_of(candidates)
    assert [*map(len, groups)] == [4]
    assert [one.names for one in host_kinds(candidates)] == [("h0", "h1", "h2")]


def test_a_host_where_something_runs_is_of_its_own_kind() -> None:
    candidates = Candidates(world("A", replicas(4), hosts=THREE, units=(ComputationUnit("s.1", "s", host="h1"),)))
    kinds = host_kinds(candidates)
    assert sorted(one.names for one in kinds) == [("h0", "h2"), ("h1",)]


def test_a_host_that_a_selector_chooses_is_of_another_kind() -> None:
    hosts = (*THREE[:2], replace(THREE[2], labels=("spot",)))
    candidates = Candidates(world("A", replicas(4, at_most={"spot": 1}), hosts=hosts))
    assert [one.names for one in host_kinds(candidates)] == [("h0", "h1"), ("h2",)]


@pytest.mark.parametrize("most", [0, 1, 3])
def test_units_on_hosts_that_a_selector_chooses_are_counted_together(most: int) -> None:
    """The hosts that cost nothing are chosen by it, and each host has room for two units."""
    hosts = (*(replace(host, labels=("spot",)) for host in THREE), *(Host(f"i{n}", 4, 4, rent_us=9) for n in range(3)))
    problem = world("A", replicas(4, at_most={"spot": most}), hosts=hosts)
    found = counted(problem)
    assert as_good(found) == as_good(named(problem))
    assert found.cost_us is not None
    free = named(replace(problem, environment=replace(problem.environment, library=(replicas(4),))))
    assert found.cost_us - (free.cost_us or 0) == 9 * problem.horizon_s * -(-(4 - most) // 2)


def test_a_host_with_another_price_is_of_another_kind() -> None:
    hosts = (*THREE[:2], replace(THREE[2], rent_us=1))
    candidates = Candidates(world("A", replicas(4), hosts=hosts))
    assert [one.names for one in host_kinds(candidates)] == [("h0", "h1"), ("h2",)]


@pytest.mark.parametrize(
    "problem",
    [
        world("A", replicas(4), hosts=THREE, survive=Failures.UNITS),
        world("A", kind("s", gives="A"), kind("t", gives="A", conflicts=("s",))),
        world("A", replicas(4, required=True), hosts=THREE),
    ],
    ids=["failures", "nothing to count", "required"],
)
def test_where_it_matters_who_is_wired_to_whom_units_are_named(problem: Problem) -> None:
    assert not is_countable(Candidates(problem))


def test_a_stream_with_a_price_on_its_way_makes_units_named() -> None:
    carried = replace(replicas(4), outputs=(OutputPort("o", "A", (), 1_000_000, 1_000_000),))
    assert not is_countable(Candidates(world("A", carried, hosts=THREE, transfer_us=1)))
    assert is_countable(Candidates(world("A", carried, hosts=THREE)))


def test_twelve_streams_of_twenty_that_may_run_are_taken() -> None:
    many = replace(kind("s", gives="A"), max_instances=20)
    balancer = Transformation("f", (InputPort("i", "A", count=12),), (OutputPort("o", "B"),))
    found = counted(world("B", many, balancer))
    assert found.status is Status.OPTIMAL
    assert found.change_set is not None and len(found.change_set.started) == 13


def test_a_hundred_hosts_each_have_the_company_that_a_unit_needs() -> None:
    users = replace(kind("s", gives="A"), min_instances=20, max_instances=20, per_host=1, beside=("agent",))
    hosts = tuple(Host(f"h{n:03}") for n in range(100))
    found = counted(world("A", users, kind("agent", gives="Z"), hosts=hosts))
    assert found.change_set is not None and len(found.change_set.started) == 40


def test_units_that_do_not_fit_together_are_placed_host_by_host() -> None:
    """Of memory alone three hosts would do for four units of 3, but each bears one."""
    big = replace(kind("s", gives="A"), min_instances=4, max_instances=4, memory_mb=3)
    assert counted(world("A", big, hosts=THREE)).status is Status.INFEASIBLE
    assert counted(world("A", big, hosts=(*THREE, Host("h3", memory_mb=4)))).status is Status.OPTIMAL


def test_a_running_unit_stays_as_it_is_where_that_costs_nothing() -> None:
    reader = Transformation("f", (InputPort("i", "A", count=2),), (OutputPort("o", "B"),))
    problem = world("B", replicas(3), reader)
    first = counted(problem)
    again = replace(problem, environment=problem.after(first))
    found = counted(again)
    assert found.change_set is not None and not found.change_set


@pytest.mark.parametrize("rents_us", [(5, 1), (1, 5)])
def test_a_host_is_paid_where_something_is_on_it(rents_us: tuple[int, ...]) -> None:
    hosts = tuple(Host(f"h{n}", rent_us=rent_us) for n, rent_us in enumerate(rents_us))
    problem = world("A", replicas(4), hosts=hosts)
    assert counted(problem).cost_us == named(problem).cost_us == problem.horizon_s * 1 + 4


def test_a_unit_that_gets_another_topic_is_wired_anew() -> None:
    problem = world("A", replicas(3), hosts=THREE)
    first = counted(problem)
    target = replace(problem.environment.targets[0], label="more", topic="/more")
    more = replace(problem.after(first), targets=(*problem.environment.targets, target))
    found = counted(replace(problem, environment=more))
    assert found.change_set is not None and len(found.change_set.rewired) == 1 and not found.change_set.started


@pytest.mark.parametrize("rooms_mb", [(8, 2), (2, 8)])
def test_hosts_of_different_room_are_not_alike(rooms_mb: tuple[int, ...]) -> None:
    hosts = tuple(Host(f"h{n}", memory_mb=room) for n, room in enumerate(rooms_mb))
    assert counted(world("A", replicas(5), hosts=hosts)).status is Status.OPTIMAL
    assert counted(world("A", replicas(6), hosts=hosts)).status is Status.INFEASIBLE
