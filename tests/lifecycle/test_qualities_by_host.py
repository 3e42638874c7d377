"""A transformation may be good on one host and bad on another: each host has an estimate, and plans follow it."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from math import inf
from pathlib import Path

import pytest
from cfgplan_runtime import Policy
from cfgplan_runtime.lifecycle.back_off import Place
from cfgplan_runtime.lifecycle.basis import plan_text
from cfgplan_runtime.lifecycle.changes import ReplaceWorld
from cfgplan_runtime.lifecycle.looks import Looks
from cfgplan_runtime.lifecycle.perturbations import HorizonReached, LookDue
from cfgplan_runtime.operating.records import snapshot_record
from cfgplan_runtime.supervision.simulated_backend import Behaviour
from simulated_life import Life, started
from test_qualities_of_a_run import ERROR, looks_of, pass_until_a_look, saying, sensor, step_at, watched

from cfgplan import api
from cfgplan.domain import Environment, Host, InputPort, OutputPort, Statement, Target, Transformation
from cfgplan.formats.observed_file import observed_text, read_observed
from cfgplan.observed import FORGET_S
from cfgplan.planners import PLANNERS
from cfgplan.qualities import MICRO, Contribution, Over, QualityRule, Wish

HOSTS = Host("r1", speed=2 * MICRO), Host("r2")
CLEAN, DIRTY = 0.2, 0.8
WORLD = watched(sensor("camera", CLEAN, 1000), sensor("lidar", 0.3, 100_000), hosts=HOSTS)
"""A cheap camera, cheapest on r1, and a dear lidar; one of them has to say an error of 0.5 m at most."""


def seeing(r1: Callable[[float], float], r2: Callable[[float], float], lidar: float = 0.3) -> dict[str, Behaviour]:
    """A camera with these errors on the two hosts, and a lidar."""
    of_lidar = saying(lambda _: lidar)
    return {"camera on r1": saying(r1, seed=1), "camera on r2": saying(r2, seed=2), "lidar": of_lidar}


def fleet(policy: Policy | None = None, **errors: Callable[[float], float]) -> Life:
    """A run of WORLD."""
    return started(world=WORLD, behaviours=seeing(**errors), policy=policy)


def places(run: Life) -> set[tuple[str, str | None]]:
    return {(unit.transformation, unit.host) for unit in run.runtime.environment.units}


def test_a_camera_with_a_dirty_lens_is_replaced_by_the_same_camera_on_another_host() -> None:
    run = fleet(r1=step_at(20, CLEAN, DIRTY), r2=lambda _: 0.25)
    run.pass_time(18)
    assert places(run) == {("camera", "r1")}
    run.pass_time(30)
    assert places(run) == {("camera", "r2")}
    snapshot = run.manager.snapshot()
    dirty, clean = snapshot.qualities
    assert (dirty.host, dirty.planned) == ("r1", pytest.approx(800_000, rel=0.06))
    assert (clean.host, clean.estimate) == ("r2", pytest.approx(250_000, rel=0.06))
    assert snapshot.qualities_now["camera/p error on r1"].endswith("m observed, 0.2 m declared")
    started_on = [unit.host for one in run.reviews if one.change_set for unit in one.change_set.started]
    assert started_on == ["r1", "r2"]


def test_a_host_where_nothing_was_observed_has_the_declared_quality() -> None:
    run = fleet(r1=lambda _: DIRTY, r2=lambda _: DIRTY)
    run.pass_time(60)
    assert places(run) <= {("lidar", "r1"), ("lidar", "r2")}
    assert run.starts("camera") == 2  # once on each host


def test_a_lens_that_was_cleaned_is_found_by_a_look_at_its_host() -> None:
    run = fleet(r1=lambda at_s: DIRTY if 20 <= at_s < 100 else CLEAN, r2=lambda _: CLEAN)
    run.pass_time(50)
    assert places(run) == {("camera", "r2")}
    pass_until_a_look(run)
    assert looks_of(run)[0] == LookDue("camera", "r1")
    assert places(run) == {("camera", "r1"), ("camera", "r2")}
    run.pass_time(240)
    assert places(run) == {("camera", "r1")}


def test_looks_at_a_lens_that_stays_dirty_become_rare() -> None:
    run = fleet(r1=lambda _: DIRTY, r2=lambda _: CLEAN)
    run.pass_time(3600)
    assert {(look.transformation, look.host) for look in looks_of(run)} == {("camera", "r1")}
    assert 4 <= len(looks_of(run)) <= 8
    assert places(run) == {("camera", "r2")}


def weighed(*library: Transformation, hosts: tuple[Host, ...] = HOSTS, **behaviours: Behaviour) -> Life:
    """A run of a library for a target whose error of 1 m costs 20 CPU seconds; behaviours are named as `camera_r1`."""
    target = Target("position", "Position", "/position", quality=(Wish("error", None, 20 * MICRO),))
    environment = Environment(library=library, targets=(target,), hosts=hosts, qualities=(ERROR,))
    named = {name.replace("_", " on "): behaviour for name, behaviour in behaviours.items()}
    return started(world=api.world(environment, horizon_s=3600), behaviours=named)


def test_the_first_look_at_what_never_ran_is_on_the_host_that_a_plan_would_use() -> None:
    """The second look, at what it found, comes after twice the time."""
    lidar = replace(sensor("lidar", 0.3, 1000), hosts=("r1",))
    camera = replace(sensor("camera", 0.2, 1000), hosts=("r1",))
    run = weighed(camera, lidar, camera=saying(lambda _: 0.2), lidar=saying(lambda _: 0.31))
    run.pass_time(400)
    assert looks_of(run) == [LookDue("lidar", "r1"), LookDue("lidar", "r1")]
    assert [one.host for one in run.manager.snapshot().qualities] == ["r1", "r1"]


def test_a_host_where_a_running_transformation_was_never_observed_is_looked_at() -> None:
    camera = sensor("camera", CLEAN, 10)
    run = weighed(camera, camera_r1=saying(lambda _: CLEAN), camera_r2=saying(lambda _: CLEAN / 4))
    run.pass_time(58)
    assert (looks_of(run), places(run)) == ([], {("camera", "r1")})
    run.pass_time(10)
    assert looks_of(run) == [LookDue("camera", "r2")]
    assert places(run) == {("camera", "r2")}


def test_each_host_is_looked_at_though_the_transformation_was_observed_or_silent_on_others() -> None:
    """The lidar says nothing on r1, is bad on r2, and is good on r3."""
    bad, good = saying(lambda _: DIRTY), saying(lambda _: CLEAN / 4)
    hosts = Host("r1", speed=2 * MICRO), Host("r2"), Host("r3", speed=MICRO // 2)
    camera = replace(sensor("camera", CLEAN, 10), hosts=("r1",))
    cameras, lidar = saying(lambda _: CLEAN), sensor("lidar", 0.3, 10)
    run = weighed(camera, lidar, hosts=hosts, camera=cameras, lidar_r1=Behaviour(), lidar_r2=bad, lidar_r3=good)
    run.pass_time(1000)
    assert {look.host for look in looks_of(run)} == {"r1", "r2", "r3"}
    assert places(run) == {("lidar", "r3")}


def test_a_transformation_that_may_run_on_one_host_has_no_other_place() -> None:
    run = weighed(replace(sensor("camera", CLEAN, 10), hosts=("r1",)), camera=saying(lambda _: CLEAN))
    run.pass_time(30)
    assert places(run) == {("camera", "r1")}
    assert run.manager._state.looks_due_s == {}


def test_a_place_that_was_observed_without_a_look_has_no_pause_of_looks_at_other_hosts() -> None:
    looks, known = Looks(), set[Place]()
    for number in range(4):  # looks at four new hosts, each after twice the time
        place = Place("camera", f"r{number}")
        looks = looks.begun((place,), 0.0, 60.0, is_possible=True, known=known)
        known.add(place)
    assert looks.due_s(Place("camera"), -inf, 60.0) == 480
    assert looks.due_s(Place("camera", "r4"), 100.0, 60.0) == 160


def test_a_look_runs_a_transformation_on_one_host_only() -> None:
    """The plan with the hoped qualities has a lidar on each host; the result of a look is compared at its place."""
    averaged = Contribution("error", QualityRule.ADD, 0, over=Over.MEAN)
    ports = (InputPort("x", "Position", count=2),), (OutputPort("f", "Fused", (averaged,)),)
    fuse = Transformation("fuse", *ports, 1000, 1000, source="units.py:fuse")
    sonar = replace(sensor("sonar", CLEAN, 10), max_instances=2, hosts=("r1",))
    lidar = replace(sensor("lidar", 0.25, 10), max_instances=2, per_host=1)
    target = Target("fused", "Fused", "/fused", quality=(Wish("error", None, 20 * MICRO),))
    environment = Environment(library=(sonar, lidar, fuse), targets=(target,), hosts=HOSTS, qualities=(ERROR,))
    behaviours = {"sonar": saying(lambda _: CLEAN), "lidar": saying(lambda _: 0.1)}
    run = started(world=api.world(environment, horizon_s=3600), behaviours=behaviours)
    pass_until_a_look(run)
    (host,) = {host for label, host in places(run) if label == "lidar"}
    assert looks_of(run) == [LookDue("lidar", host)]
    run.pass_time(100)
    assert {host for label, host in places(run) if label == "lidar"} == {"r1", "r2"}


def test_without_looks_what_was_learned_on_a_host_fades_there() -> None:
    behaviours = seeing(lambda at_s: DIRTY if at_s < 100 else CLEAN, lambda _: CLEAN)
    run = started(world=replace(WORLD, horizon_s=120), behaviours=behaviours, policy=Policy(look_every_s=None))
    run.pass_time(50)
    assert places(run) == {("camera", "r2")}
    run.pass_time(4 * FORGET_S)
    assert run.perturbations(HorizonReached)
    assert places(run) == {("camera", "r1")}


def test_estimates_of_a_host_that_is_gone_from_the_world_are_forgotten() -> None:
    run = fleet(r1=lambda _: DIRTY, r2=lambda _: 0.25)
    run.pass_time(60)
    assert {one.host for one in run.manager.snapshot().qualities} == {"r1", "r2"}
    world = watched(sensor("camera", CLEAN, 1000), sensor("lidar", 0.3, 100_000), hosts=HOSTS[1:])
    run.reviewed(ReplaceWorld(world, "a test"))
    assert {one.host for one in run.manager.snapshot().qualities} == {"r2"}
    run.reviewed(ReplaceWorld(watched(sensor("camera", CLEAN, 1000)), "another test"))
    assert run.manager.snapshot().qualities == ()


def test_a_file_of_what_a_run_observed_has_the_hosts_and_gives_the_plan_of_the_run(tmp_path: Path) -> None:
    run = fleet(r1=lambda _: DIRTY, r2=lambda _: 0.25)
    run.pass_time(60)
    state, file = snapshot_record(run.manager.snapshot()), tmp_path / "now.json"
    file.write_text(observed_text(state["facts"], state["qualities"]))
    assert [(one["output"], one["host"]) for one in state["qualities"]] == [("camera/p", "r1"), ("camera/p", "r2")]
    world = api.world(read_observed(file, WORLD.environment), horizon_s=36_000)
    here, there = (world.environment.stated(Statement("camera", "p", "error", host)) for host in ("r1", "r2"))
    assert here is not None and here.value == pytest.approx(800_000, rel=0.06)
    assert there is not None and there.stated == 200_000
    problem = api.match(world)
    plan = PLANNERS["cpsat"](problem)
    assert plan.change_set is not None
    assert [(unit.transformation, unit.host) for unit in plan.change_set.started] == [("camera", "r2")]
    assert plan.cost_us == PLANNERS["exhaustive"](problem).cost_us


def test_a_preview_has_the_qualities_by_host_in_its_plan_file() -> None:
    run = fleet(r1=lambda _: DIRTY, r2=lambda _: 0.25)
    run.pass_time(60)
    future = run.manager.preview()
    run.settle()
    plan = json.loads(plan_text(future.result(0)))
    assert plan["qualities"]["camera/p error on r1"]["used"] == pytest.approx(0.8, rel=0.06)
    assert plan["qualities"]["camera/p error on r1"]["declared"] == 0.2


def test_no_look_is_taken_at_a_camera_whose_quality_is_told_wherever_it_runs_while_it_runs_elsewhere() -> None:
    """The camera is dirty on r1, where it would be "clean" as long as another unit says so of r2."""
    camera = sensor("camera", CLEAN, 1_000, observe="diagnostics.camera.error")
    world = watched(camera, sensor("lidar", 0.3, 100_000), hosts=HOSTS)
    run = started(world=world, behaviours={"lidar": saying(lambda _: 0.3)})
    (statement,) = (each for each in world.environment.observable if each.transformation == "camera")
    for _ in range(900):
        for unit in run.runtime.environment.units:
            if unit.transformation == "camera":
                run.manager.tell_quality(statement, {"r1": DIRTY, "r2": 0.25}[unit.host or ""])
        run.pass_time(1)
    assert looks_of(run) == []
    assert places(run) == {("camera", "r2")}
