"""How a fleet on hosts is planned: among few units first, below the best plan's cost, with hosts forgotten.

`CFGPLAN_EXAMPLES=5000 pytest tests/planners` runs the long version.
"""

from __future__ import annotations

from dataclasses import replace

import pytest
from fixed import Hubs, kind, runs, unit, world
from fleets import fleets
from hypothesis import assume, given
from test_fleets_against_the_oracle import agree_with_the_explicit_model, some
from worlds import examples

from cfgplan.domain import Environment, Host, InputPort, OutputPort, Similarity, Target, Transformation
from cfgplan.planners import PLANNERS
from cfgplan.planners.exact import fleet
from cfgplan.planners.exact.candidates import Candidates
from cfgplan.planners.exact.first_plans import FirstPlans
from cfgplan.planners.exact.fleet import remaining_by_bounds
from cfgplan.planners.exact.session import PlannerSession
from cfgplan.planners.exact.solve_state import SolveState
from cfgplan.planners.solving.clock import Clock
from cfgplan.planners.tuning import Fleets, Tuning
from cfgplan.planning import Failures, Feature, Problem, Status
from cfgplan.reasons import unmet_reasons
from cfgplan.validity import plan_violations

on_hosts = fleets(frozenset({Feature.HOSTS, Feature.CONFLICTS, Feature.INSTANCES}), most=9)


IN_PARTS = Tuning(fleet=Fleets(sizes=(1, 2, 4)))
"""Even few units are looked at in parts."""


@some
@given(on_hosts)
def test_looking_among_few_units_first_changes_no_answer(problem: Problem) -> None:
    agree_with_the_explicit_model(problem, IN_PARTS)


@examples(40, part=2)
@given(on_hosts)
def test_looks_that_are_too_short_change_no_answer(problem: Problem) -> None:
    agree_with_the_explicit_model(problem, Tuning(fleet=replace(IN_PARTS.fleet, look=1e-5)))


@some
@given(on_hosts)
def test_with_hosts_forgotten_no_plan_costs_less_than_the_bound(problem: Problem) -> None:
    assume(not unmet_reasons(problem))
    state = SolveState(problem, Clock(), None)
    remaining_by_bounds(Candidates(problem), state)
    found = PlannerSession(IN_PARTS).plan(problem)
    assume(found.status is Status.OPTIMAL)
    assert found.cost_us is not None
    assert state.bound_us <= found.cost_us


def test_what_costs_more_than_the_best_plan_on_any_host_is_left_out() -> None:
    library = (kind("s", gives="A"), kind("dear", gives="A", labor_us=9), kind("f", "A", "B"))
    problem = world("B", *library, hosts=(Host("h0"), Host("h1")))
    candidates, state = Candidates(problem), SolveState(problem, Clock(), None)
    assert remaining_by_bounds(candidates, state).names(candidates.network) == ["dear", "f", "s"]
    FirstPlans(candidates, state).look(0)
    assert remaining_by_bounds(candidates, state).names(candidates.network) == ["f", "s"]


def test_a_dearer_unit_on_the_target_s_host_beats_a_cheap_one_and_a_transfer() -> None:
    library = tuple(
        Transformation(f"{label}{n}", inputs, (OutputPort("out", tag, (), 1_000_000, 1_000_000),), us, 0, host=host)
        for label, inputs, tag, us, host in (
            ("source", (), "a", 10, "h0"),
            ("near", (), "a", 25, "h1"),
            ("sink", (InputPort("in", "a"),), "b", 5, "h1"),
        )
        for n in range(3)
    )
    environment = Environment(
        (), library, (Target("t", "b", "/t", host="h1"),), (Host("h0"), Host("h1")), transfer_us=20
    )
    problem = Problem(environment, Similarity({"a": frozenset("a"), "b": frozenset("b")}), 1)
    found = PlannerSession(IN_PARTS).plan(problem)
    assert found.status is Status.OPTIMAL
    assert found.cost_us == 30
    assert found.change_set is not None
    assert {unit.transformation[:4] for unit in found.change_set.started} == {"near", "sink"}


def test_a_repair_that_rewires_only_what_has_lost_its_feed_is_proven_without_search(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    library = kind("s", gives="A", labor_us=9), kind("f", "A", "B", labor_us=9)
    problem = world("B", *library, hosts=(Host("h0"), Host("h1")))
    monkeypatch.delattr(fleet, "_search")
    running = problem.after(PlannerSession().plan(problem)).units
    (left,) = (replace(unit, subscriptions=()) for unit in running if unit.transformation == "f")
    found = PlannerSession().plan(problem.with_parts(units=(left,)))
    assert (found.status, found.cost_us, found.ties_proven) == (Status.OPTIMAL, 9, True)
    assert found.change_set is not None
    assert [unit.id for unit in found.change_set.rewired] == [left.id]


def test_what_nothing_grounds_on_any_host_is_cut_by_who_has_to_run() -> None:
    """Two units could feed each other from any hosts; only `s` starts from nothing."""
    output = OutputPort("x", "", rate_uhz=1_000_000, size_bytes=1_000_000)
    library = (
        kind("s", gives="A", labor_us=90, output=output),
        kind("t", "A", "B", output=output),
        kind("u", "B", "A", output=output),
    )
    hosts = (Host("h0"), Host("h1"), Host("h2"))
    target = Target("B", "B", "/B", host="h0")
    fixed = Hubs(world((target,), *library, hosts=hosts, transfer_us=1))
    fixed.build()
    model, s = fixed.model, fixed.candidates.index_of["s.1"]
    true = {literal.index for literal in model.literals} - {model.runs[s].index}
    unfounded, ways_in = model.anywhere.cut(true, model.anywhere.grounded(true))
    assert len(unfounded) == 2
    assert ways_in == [model.runs[s].index]
    assert not fixed.allows(runs("t.1"), runs("u.1"), ~runs("s.1"))


SOLVER_ONLY = Tuning(is_solver_only=True)


@pytest.mark.parametrize("tuning", [IN_PARTS, SOLVER_ONLY], ids=["usual", "solver only"])
@pytest.mark.parametrize(("transfer_us", "place", "cost_us"), [(59, "far", 89), (61, "near", 90)])
def test_a_unit_runs_on_the_faster_host_unless_its_streams_cost_more_to_carry(
    tuning: Tuning, transfer_us: int, place: str, cost_us: int
) -> None:
    output = OutputPort("x", "", rate_uhz=1_000_000, size_bytes=1_000_000)
    library = (kind("t", gives="B", labor_us=90, output=output),)
    hosts = (Host("far", speed=3_000_000), Host("near"))
    problem = world((Target("B", "B", "/B", host="near"),), *library, hosts=hosts, transfer_us=transfer_us)
    found = PlannerSession(tuning).plan(problem)
    assert found.change_set is not None
    assert [unit.host for unit in found.change_set.started] == [place]
    assert (found.status, found.cost_us) == (Status.OPTIMAL, cost_us)
    assert not plan_violations(problem, found)


@pytest.mark.parametrize("tuning", [IN_PARTS, SOLVER_ONLY], ids=["usual", "solver only"])
def test_a_spare_waits_where_that_is_cheapest(tuning: Tuning) -> None:
    library = (
        replace(kind("runs", gives="B", labor_us=1), host="a", max_instances=1),
        replace(kind("waits", gives="B", labor_us=1000), standby_us=12),
    )
    hosts = (Host("a", speed=500_000), Host("b", speed=3_000_000), Host("c"))
    problem = replace(world((Target("B", "B", "/B"),), *library, hosts=hosts), survive=Failures.UNITS)
    found = PlannerSession(tuning).plan(problem)
    assert found.change_set is not None
    assert {(unit.transformation, unit.host) for unit in found.change_set.started} == {("runs", "a"), ("waits", "b")}
    assert (found.status, found.cost_us) == (Status.OPTIMAL, 2 + 4)
    assert not plan_violations(problem, found)


@pytest.mark.parametrize("tuning", [IN_PARTS, SOLVER_ONLY], ids=["usual", "solver only"])
@pytest.mark.parametrize(("speed", "status"), [(900_000, Status.INFEASIBLE), (1_000_000, Status.OPTIMAL)])
def test_a_unit_takes_more_of_a_slow_host(tuning: Tuning, speed: int, status: Status) -> None:
    library = (replace(kind("t", gives="B"), upkeep_us=10),)
    problem = world((Target("B", "B", "/B"),), *library, hosts=(Host("a", cpu_us=10, speed=speed),))
    assert PlannerSession(tuning).plan(problem).status is status


def test_a_pinned_unit_is_kept_by_plans_of_few_transformations_too() -> None:
    apart = kind("p", "A", "C", pinned=True, conflicts=("s",))
    library = (apart, kind("s", gives="A"), kind("b", gives="B"), kind("c", gives="B", labor_us=5))
    problem = world("B", *library, units=(unit("p", "s.1/x0", host="h"),), hosts=(Host("h"),))
    assert PlannerSession(IN_PARTS).plan(problem).status is Status.INFEASIBLE


def test_that_no_host_fits_a_selector_is_said() -> None:
    found = PLANNERS["cpsat"](world("A", kind("web", gives="A", on="gpu and not spot"), hosts=(Host("h"),)))
    assert found.reasons["A"] == "target A would have no stream: no host is one that web may run on: gpu and not spot"


def test_that_no_host_bears_a_unit_and_its_company_is_said() -> None:
    library = (
        kind("web", gives="A", beside=("db",), memory_mb=3),
        kind("db", gives="B", memory_mb=3, on="big or small"),
    )
    small, big = Host("h", 5, 5, labels=("small",)), Host("i", memory_mb=6, labels=("big",))
    found = PLANNERS["cpsat"](world("A", *library, hosts=(small, Host("j"))))
    assert found.reasons["A"] == "target A would have no stream: no host has room for web together with db"
    found = PLANNERS["cpsat"](world("A", *library, hosts=(small, big)))
    assert found.change_set is not None
    assert {(unit.transformation, unit.host) for unit in found.change_set.started} == {("web", "i"), ("db", "i")}


def test_which_replica_finds_no_host_is_said() -> None:
    hosts = (Host("a", memory_mb=1100), Host("b", memory_mb=500))
    for more, text in (
        ({"memory_mb": 512, "min_instances": 3}, "number 3 finds no host with 512 MB of memory left"),
        ({"per_host": 1, "min_instances": 3}, "number 3 finds no host with fewer than 1 of them"),
        (
            {"at_most": {"a or b": 1}, "min_instances": 2},
            "number 2 finds no host with room for it, as at most 1 may run on a or b",
        ),
    ):
        found = PLANNERS["cpsat"](world("A", kind("web", gives="A", **more), hosts=hosts))
        assert found.status is Status.INFEASIBLE
        assert text in found.reasons["A"]


def test_which_unit_of_a_count_finds_no_host_is_said() -> None:
    hosts = (Host("a", memory_mb=1100), Host("b", memory_mb=500), Host("c", memory_mb=600))
    balancer = replace(kind("balancer", gives="B"), inputs=(InputPort("i", "A", count=3),))
    web = kind("web", gives="A", memory_mb=512, per_host=1)
    found = PLANNERS["cpsat"](world("B", web, balancer, hosts=hosts))
    assert found.status is Status.INFEASIBLE
    assert found.reasons["B"].endswith(
        "only web/x0 can feed it, 2 in all, "
        "as web number 3 finds no host with 512 MB of memory left and fewer than 1 of them"
    )
    alone = world("B", replace(web, per_host=None), balancer, hosts=hosts)
    assert PLANNERS["cpsat"](alone).status is Status.OPTIMAL


def test_of_several_ways_each_that_finds_no_room_is_said() -> None:
    ways = (kind("warm", gives="A", needs={"power": 2}), kind("seen", gives="A", needs={"power": 3}))
    found = PLANNERS["cpsat"](world("A", *ways, hosts=(Host("h", energy=19),), horizon_s=10))
    assert found.reasons["A"] == (
        "target A would have no stream: no host where seen may run has 3 W of power for 10 s, "
        "and no host where warm may run has 2 W of power for 10 s"
    )


def test_what_has_to_be_on_one_host_and_finds_no_room_together_is_said() -> None:
    library = (
        kind("camera", gives="A", host="h", needs={"power": 3}),
        kind("pose", gives="B", host="h", needs={"power": 1}),
        kind("both", "AB", "C"),
    )
    found = PLANNERS["cpsat"](world("C", *library, hosts=(Host("h", energy=39), Host("i")), horizon_s=10))
    assert found.reasons["C"].endswith("together: camera, pose need 4 W of power, but h has 3")
