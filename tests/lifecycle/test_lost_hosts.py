"""Hosts that are lost and come back, with units that run only in thought. No process, no network."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from cfgplan_runtime import Policy, SimulatedRuntime
from cfgplan_runtime.lifecycle.changes import KillUnit, LoseHost, RegainHost, ReplaceWorld, ReviewNow
from cfgplan_runtime.lifecycle.perturbations import HostBack, HostGone, SubscriptionLost, UnitGone
from cfgplan_runtime.lifecycle.reports import Decision, UnitEvent
from cfgplan_runtime.supervision.events import UnitReady
from cfgplan_runtime.supervision.simulated_backend import Behaviour
from simulated_life import HORIZON_S, RESULT, Life, source, started, worker

from cfgplan import api
from cfgplan.domain import ComputationUnit, Environment, Host, Target, Transformation
from cfgplan.errors import InputError
from cfgplan.planning import Failures

FLEET = Path(__file__).parents[2] / "models" / "fleet"
HOSTS = (Host("r1"), Host("r2"), Host("base"))
AT_BASE = replace(RESULT, host="base")


def world(
    *library: Transformation,
    hosts: tuple[Host, ...] = HOSTS,
    targets: tuple[Target, ...] = (RESULT,),
    survive: Failures | None = None,
    **more: Any,
) -> api.World:
    library = library or (source(host="base"), worker(hosts=("r1", "r2")))
    made = api.world(Environment((), library, targets, hosts, **more), horizon_s=HORIZON_S)
    return replace(made, survive=survive)


def fleet(stage: str) -> Life:
    """A stage of the model whose first review is over."""
    loaded = api.load(FLEET / f"{stage}.yaml")
    library = tuple(replace(one, source="units.py:unit") for one in loaded.environment.library)
    return started(world=replace(loaded, environment=replace(loaded.environment, units=(), library=library), file=None))


def hosts(life: Life) -> dict[str, str | None]:
    return {unit.id: unit.host for unit in life.runtime.environment.units}


def lose(life: Life, *names: str) -> None:
    for name in names:
        life.runtime.backend.lose_host(name)
    life.pass_time(0.01)
    life.settle()


def join(life: Life, *names: str) -> None:
    for name in names:
        life.runtime.backend.join_host(name)
    life.pass_time(0.01)
    life.settle()


def test_a_lost_host_is_replaced_at_once_and_blames_nobody() -> None:
    life = started(world=world())
    assert hosts(life) == {"count.1": "base", "work.1": "r1"}
    began_s = life.now
    lose(life, "r1")
    assert life.now - began_s < 0.1
    assert hosts(life) == {"count.1": "base", "work.1": "r2"}
    assert life.met == {"result"}
    ready = [one for one in life.reports if isinstance(one, UnitEvent) and isinstance(one.event, UnitReady)]
    assert [(one.event.unit, one.host) for one in ready] == [("count.1", "base"), ("work.1", "r1"), ("work.1", "r2")]
    assert life.perturbations(HostGone) == [HostGone("r1", "its link is cut")]
    assert not life.perturbations(UnitGone)
    assert not life.perturbations(SubscriptionLost)
    seen = life.manager.snapshot()
    assert (seen.backing_off, seen.lost_hosts) == ((), ("r1",))
    assert [(view.unit.id, view.host) for view in seen.units] == [("count.1", "base"), ("work.1", "r2")]
    join(life, "r1")
    assert life.perturbations(HostBack) == [HostBack("r1")]
    assert life.manager.snapshot().lost_hosts == ()


def test_what_only_a_lost_host_could_do_waits_for_it_and_the_reason_says_so() -> None:
    life = started(world=world())
    lose(life, "r1", "r2")
    (view,) = life.manager.snapshot().targets
    assert view.reason.endswith("but needs transformations that are left out for now: work (hosts r1, r2 are gone)")
    assert hosts(life) == {}
    join(life, "r2")
    assert hosts(life) == {"count.1": "base", "work.1": "r2"}
    assert life.met == {"result"}


def test_a_target_on_a_lost_host_is_met_again_when_the_host_is_back() -> None:
    there = replace(RESULT, host="r2")
    life = started(world=world(targets=(there, Target("other", "N", "/other"))))
    lose(life, "r2")
    reasons = {view.label: view.reason for view in life.manager.snapshot().targets}
    assert reasons == {"result": "host r2 is gone", "other": ""}
    assert life.runtime.backend.topics.keys() == {"/other"}
    join(life, "r2")
    assert life.met == {"result", "other"}
    assert life.runtime.backend.topics == {"/other": None, "/result": "r2"}


def test_when_all_hosts_are_lost_nothing_is_planned_and_what_comes_back_is_used() -> None:
    life = started(world=world(survive=Failures.HOSTS))
    lose(life, "r1", "r2", "base")
    assert hosts(life) == {}
    assert life.reviews[-1].decision is Decision.KEPT
    join(life, "r1", "r2", "base")
    assert life.met == {"result"}


def test_a_host_that_is_lost_while_a_unit_starts_there_blames_nobody() -> None:
    life = Life(world=world(), behaviours={"work": Behaviour(start_s=1.0)})
    life.pass_time(0.0)
    life.runtime.backend.lose_host("r1")
    life.settle()
    assert hosts(life) == {"count.1": "base", "work.1": "r2"}
    assert life.manager.snapshot().backing_off == ()
    assert life.now < 2.0


def test_a_host_that_is_given_up_by_request_is_left_without_a_gap_and_used_again() -> None:
    life = started(world=world())
    life.runtime.backend.calls.clear()
    review = life.reviewed(LoseHost("r1", "is to be mended"))
    assert review.decision is Decision.APPLIED
    assert hosts(life) == {"count.1": "base", "work.2": "r2"}
    verbs = [call[0] for call in life.runtime.backend.calls]
    assert verbs.index("start") < verbs.index("stop")
    life.reviewed(RegainHost("r1"))
    assert life.manager.snapshot().lost_hosts == ()


def test_a_host_that_is_not_there_can_not_be_asked_back() -> None:
    life = started(world=world())
    lose(life, "r1")
    with pytest.raises(
        InputError, match=r"'r1' was not taken out of service \(the run uses it as soon as it can be reached\)"
    ):
        life.ask(RegainHost("r1"))


def test_the_first_review_waits_until_all_hosts_have_joined() -> None:
    life = Life(world=world(), policy=Policy(hosts_s=5.0))
    for host in ("r1", "base", "stranger"):
        life.pass_time(1.0)
        life.runtime.backend.join_host(host)
    life.pass_time(1.0)
    assert not life.reviews
    join(life, "r2")
    assert life.now < 5.0
    assert life.met == {"result"}
    assert len(life.reviews) == 1


def test_a_host_that_is_told_to_be_lost_at_the_start_is_not_waited_for() -> None:
    runtime = SimulatedRuntime()
    runtime.backend.join_host("r2")
    runtime.backend.lose_host("r1")
    runtime.supervisor.pump(0.01)  # before anybody listens
    life = Life(world=world(), policy=Policy(hosts_s=5.0), runtime=runtime)
    life.pass_time(1.0)
    assert not life.reviews
    join(life, "base")
    assert life.now < 2.0
    assert hosts(life) == {"count.1": "base", "work.1": "r2"}


def test_a_host_that_the_file_names_later_is_used_when_it_joins() -> None:
    life = Life(world=world(hosts=HOSTS[1:]), policy=Policy(hosts_s=5.0))
    join(life, "r2", "base")
    life.reviewed(ReplaceWorld(world(worker(hosts=("r1",)), source(host="base")), "file"))
    assert life.manager.snapshot().lost_hosts == ("r1",)
    assert not life.met
    join(life, "r1")
    assert life.met == {"result"}


def test_hosts_that_do_not_come_are_planned_without_and_used_when_they_come() -> None:
    life = Life(world=world(), policy=Policy(hosts_s=5.0))
    life.runtime.backend.join_host("base")
    life.runtime.backend.join_host("r2")
    life.pass_time(6.0)
    assert hosts(life) == {"count.1": "base", "work.1": "r2"}
    assert life.manager.snapshot().lost_hosts == ("r1",)
    lose(life, "r2")
    assert not life.met
    join(life, "r1")
    assert hosts(life) == {"count.1": "base", "work.1": "r1"}
    assert life.met == {"result"}


def test_cold_spares_are_started_when_they_are_needed() -> None:
    life = fleet("4-base-may-fail")
    spares = {unit.id for unit in life.runtime.environment.units if unit.standby}
    # Units on r1 are as good as units on r2.
    names = sorted(spare.partition("(")[0] for spare in spares)
    assert names == ["camera", "localiser", "obstacle_finder", "small_detector"]
    assert spares.isdisjoint(life.runtime.backend.units)
    with pytest.raises(InputError, match="is a cold spare, and does not run"):
        life.ask(KillUnit(min(spares)))
    lose(life, "r2")
    assert life.met == {"obstacles"}
    assert "the configuration does not survive every failure" in life.reviews[-1].warnings
    join(life, "r2")
    assert any(unit.standby for unit in life.runtime.environment.units)
    assert "the configuration does not survive every failure" not in life.reviews[-1].warnings


THREE = (Host("r1"), Host("r2"), Host("r3"), Host("base"))


def with_spares(*places: Host) -> Life:
    """A worker on one of these hosts, not the base, which takes 2 s to start, and a cold spare of it on another."""
    slow = worker(hosts=tuple(host.name for host in places if host.name != "base"), standby_us=1)
    made = world(source(hosts=("base",), standby_us=1), slow, hosts=places, survive=Failures.HOSTS, targets=(AT_BASE,))
    runtime = SimulatedRuntime(behaviours={"work": Behaviour(start_s=2.0)})
    life = started(world=made, runtime=runtime)
    life.pass_time(3.0)
    return life


def of_work(life: Life) -> tuple[ComputationUnit, ComputationUnit]:
    """The worker that runs, and its spare."""
    hot, cold = sorted((u for u in life.runtime.environment.units if u.transformation == "work"), key=is_cold)
    assert not hot.standby and cold.standby
    return hot, cold


def is_cold(one: ComputationUnit) -> bool:
    return one.standby


@pytest.mark.parametrize("is_host", [False, True])
def test_what_fails_is_replaced_where_its_spare_is_prepared_and_another_spare_is_prepared(is_host: bool) -> None:
    life = with_spares(*THREE)
    hot, cold = of_work(life)
    began_s = life.now
    if is_host:
        lose(life, str(hot.host))
    else:
        life.fail(hot.id)
    assert life.now - began_s < 0.1, "it does not take the 2 s of a start"
    new, other = of_work(life)
    assert new.host == cold.host and other.host not in (new.host, hot.host if is_host else None)
    assert life.reviews[-1].is_proven and not life.reviews[-1].warnings
    life.pass_time(3.0)
    prepared = {view.unit.id for view in life.manager.snapshot().units if view.is_prepared}
    assert prepared == {unit.id for unit in life.runtime.environment.units if unit.standby}


def test_what_dies_does_not_go_where_its_spare_is_if_that_is_dearer() -> None:
    life = with_spares(THREE[0], replace(THREE[1], speed=500_000), THREE[3])
    before = of_work(life)
    assert [unit.host for unit in before] == ["r1", "r2"]
    life.fail(before[0].id)
    assert [unit.host for unit in of_work(life)] == ["r1", "r2"]
    assert of_work(life)[1] == before[1]


def test_as_many_instances_as_fit_run_where_a_lost_host_leaves_too_little_room() -> None:
    large = worker(memory_mb=60, min_instances=2, max_instances=2, hosts=("r1", "r2"))
    narrow = (Host("r1", memory_mb=100), Host("r2", memory_mb=100), Host("base"))
    life = started(world=world(source(host="base"), large, hosts=narrow))
    assert sorted(map(str, hosts(life).values())) == ["base", "r1", "r2"]
    lose(life, "r2")
    assert life.met == {"result"}
    assert "there is no room for as many instances as are asked for" in life.reviews[-1].warnings
    join(life, "r2")
    assert sorted(map(str, hosts(life).values())) == ["base", "r1", "r2"]


@pytest.mark.parametrize("stage", ["1-start", "2-better-map", "3-best-map", "4-base-may-fail"])
def test_after_hosts_were_lost_and_have_come_back_a_fleet_costs_what_a_fresh_plan_costs(stage: str) -> None:
    life = fleet(stage)
    for names in (("r2",), ("base",), ("r1", "r2"), ("base", "r1", "r2")):
        lose(life, *names)
        join(life, *names)
    life.reviewed(ReviewNow())
    life.pass_time(life.manager.world.horizon_s + 1.0)
    asked = life.manager.world
    running = replace(asked.environment, units=life.runtime.environment.units)
    problem = api.problem(replace(asked, environment=running), api.match(asked).similarity)
    assert api.plan(problem).change_set is not None
    assert not api.plan(problem).change_set
    assert life.met == {"obstacles"}


def test_a_file_that_declares_hosts_later_has_its_units_placed() -> None:
    life = started()
    life.reviewed(ReplaceWorld(world(), "file"))
    assert set(hosts(life).values()) == {"base", "r1"}
    life.reviewed(ReplaceWorld(world(hosts=HOSTS[1:]), "file"))
    assert set(hosts(life).values()) == {"base", "r2"}
    life.reviewed(ReplaceWorld(world(source(), worker(), hosts=()), "file"))
    assert set(hosts(life).values()) == {None}
    assert life.runtime.environment.hosts == ()
