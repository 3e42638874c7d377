"""A host where a transformation keeps failing takes down nothing that can run elsewhere. No process."""

from __future__ import annotations

import pytest
from cfgplan_runtime import SimulatedRuntime
from cfgplan_runtime.lifecycle.back_off import Place
from cfgplan_runtime.lifecycle.reports import BackedOff
from cfgplan_runtime.supervision.simulated_backend import Behaviour
from simulated_life import HORIZON_S, RESULT, Life, source, started, worker

from cfgplan import api
from cfgplan.domain import Environment, Host, Transformation

HOSTS = (Host("r1"), Host("r2"), Host("base"))


def life(bad: Behaviour, *library: Transformation, **hosts: Behaviour) -> Life:
    """A worker that the planner puts on r1 first, where it behaves badly."""
    library = library or (source(host="base"), worker(hosts=("r1", "r2")))
    behaviours = {"work on r1": bad, **{f"work on {host}": behaviour for host, behaviour in hosts.items()}}
    runtime = SimulatedRuntime(behaviours=behaviours)
    for host in HOSTS:
        runtime.backend.join_host(host.name)
    world = api.world(Environment((), library, (RESULT,), HOSTS), horizon_s=HORIZON_S)
    return started(world=world, runtime=runtime)


def host_of_work(run: Life) -> list[str | None]:
    return [unit.host for unit in run.runtime.environment.units if unit.transformation == "work"]


@pytest.mark.parametrize(
    "bad", [Behaviour(dies_at_start="no camera"), Behaviour(dies_s=0.3)], ids=["at its start", "while it runs"]
)
def test_what_fails_on_one_host_runs_on_another_within_seconds(bad: Behaviour) -> None:
    run = life(bad)
    run.pass_time(10.0)
    assert (host_of_work(run), run.met) == (["r2"], {"result"})
    failed_at = {report.backing_off.host for report in run.reports if isinstance(report, BackedOff)}
    assert failed_at == {"r1"}


def test_it_is_left_out_only_where_all_of_its_hosts_fail() -> None:
    bad = Behaviour(dies_at_start="no camera")
    run = life(bad, r2=bad)
    run.pass_time(3.0)
    assert (host_of_work(run), run.met) == ([], set())
    assert {"work": "after failures"} in [dict(review.avoided) for review in run.reviews]
    places = run.manager.snapshot().backing_off
    assert {Place(one.transformation, one.host) for one in places} <= {Place("work", "r1"), Place("work", "r2")}


def test_a_target_of_the_bad_host_itself_waits_for_it_and_no_other_does() -> None:
    library = source(host="base"), worker(host="r1"), worker("spare", host="r2", upkeep_us=900_000)
    run = life(Behaviour(dies_at_start="no camera"), *library)
    run.pass_time(5.0)
    assert {unit.transformation for unit in run.runtime.environment.units} == {"count", "spare"}
    assert run.met == {"result"}


def test_the_bad_host_gets_another_chance_when_its_back_off_has_ended() -> None:
    run = life(Behaviour(dies_at_start="no camera"))
    run.pass_time(1.0)
    del run.runtime.backend.behaviours["work on r1"]
    run.runtime.backend.lose_host("r2")
    run.pass_time(30.0)
    assert (host_of_work(run), run.met) == (["r1"], {"result"})
