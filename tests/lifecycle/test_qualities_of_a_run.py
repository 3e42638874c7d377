"""Streams that say how good they are: plans follow what is so, and noise makes none."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from math import inf
from random import Random
from typing import Any

import pytest
from cfgplan_runtime import Policy
from cfgplan_runtime.children.messages import PortCounts, Qualities, Quality
from cfgplan_runtime.lifecycle.basis import plan_text
from cfgplan_runtime.lifecycle.changes import ApplyPlan, KillUnit, ReplaceWorld, SetFact
from cfgplan_runtime.lifecycle.perturbations import HorizonReached, LookDue, LookOver, QualitiesObserved
from cfgplan_runtime.lifecycle.reports import Decision
from cfgplan_runtime.lifecycle.state import Entry
from cfgplan_runtime.supervision.events import UnitStatus
from cfgplan_runtime.supervision.simulated_backend import Behaviour
from simulated_life import Life, started

from cfgplan import api
from cfgplan.domain import Environment, Host, InputPort, OutputPort, RunOptions, Target, Transformation
from cfgplan.facts import Fact
from cfgplan.formats.plan_file import read_run_plan
from cfgplan.observed import FORGET_S
from cfgplan.qualities import MICRO, Better, Contribution, Curve, Over, QualityAttribute, QualityRule, Wish

ERROR = QualityAttribute("error", Better.LOWER, unit="m", worst=10 * MICRO)


def sensor(label: str, declared: float, upkeep_us: int, *, observe: str | None = "error") -> Transformation:
    stated = Contribution("error", QualityRule.SET, round(declared * MICRO), observe=observe)
    output = OutputPort("p", "Position", (stated,))
    return Transformation(label, (), (output,), 1000, upkeep_us, source=f"units.py:{label}")


def saying(truth: Callable[[float], float], *, noise: float = 0.0, elements: int = 10, seed: int = 0) -> Behaviour:
    """A unit whose elements say their error, which follows the clock; `noise` is a share of it."""
    chance = Random(seed)

    def says(at_s: float) -> Qualities:
        values = [truth(at_s) * (1 + noise * chance.gauss(0, 1)) for _ in range(elements)]
        mean = sum(values) / elements
        return {"p": {"error": Quality(elements, mean, sum((one - mean) ** 2 for one in values))}}

    return Behaviour(says=says)


def watched(*sensors: Transformation, more: tuple[Transformation, ...] = (), hosts: tuple[Host, ...] = ()) -> api.World:
    """Some sensors, one of which has to say an error of 0.5 m at most."""
    target = Target("position", "Position", "/position", quality=(Wish("error", MICRO // 2),))
    environment = Environment(library=(*sensors, *more), targets=(target,), hosts=hosts, qualities=(ERROR,))
    return api.world(environment, horizon_s=36_000)


def life(
    *,
    horizon_s: int = 3600,
    weight_us: int = 0,
    bound: float | None = 0.5,
    policy: Policy | None = None,
    **behaviours: Behaviour,
) -> Life:
    """A cheap sonar and a dear camera; the target bounds the error, in metres."""
    library = sensor("sonar", 0.2, 1000), sensor("camera", 0.3, 100_000)
    wish = Wish("error", None if bound is None else round(bound * MICRO), weight_us)
    target = Target("position", "Position", "/position", quality=(wish,))
    environment = Environment(library=library, targets=(target,), qualities=(ERROR,))
    return started(world=api.world(environment, horizon_s=horizon_s), policy=policy, behaviours=behaviours)


def step_at(at_s: float, before: float, after: float) -> Callable[[float], float]:
    return lambda now_s: before if now_s < at_s else after


def test_a_stream_that_is_worse_than_its_bound_is_replaced() -> None:
    run = life(sonar=saying(step_at(20, 0.2, 0.8)), camera=saying(lambda _: 0.3))
    run.pass_time(18)
    assert run.units == {"sonar.1"}
    run.pass_time(12)
    assert run.units == {"camera.1"}
    assert run.perturbations(QualitiesObserved) != []
    assert run.reviews[-1].decision is Decision.APPLIED
    snapshot = run.manager.snapshot()
    (sonar,) = (one for one in snapshot.qualities if one.transformation == "sonar")
    assert (sonar.stated, sonar.planned > 500_000) == (200_000, True)
    assert snapshot.qualities_now["sonar/p error"].endswith("m observed, 0.2 m declared")


def test_noise_makes_no_review() -> None:
    run = life(sonar=saying(lambda _: 0.2, noise=0.2), camera=saying(lambda _: 0.3))
    before = len(run.reviews)
    run.pass_time(3000)
    assert (run.perturbations(QualitiesObserved), len(run.reviews), run.units) == ([], before, {"sonar.1"})


def test_a_stream_that_is_as_declared_is_confirmed_and_shown() -> None:
    run = life(sonar=saying(lambda _: 0.205, noise=0.05))
    run.pass_time(30)
    (sonar,) = run.manager.snapshot().qualities
    assert (sonar.planned, sonar.stated) == (200_000, 200_000)
    assert sonar.estimate == pytest.approx(205_000, abs=5_000)
    assert sonar.ago_s < 5


def test_what_is_learned_outlives_the_unit_and_its_replacement() -> None:
    run = life(bound=None, weight_us=1000, sonar=saying(lambda _: 0.8))
    run.pass_time(15)
    assert run.units == {"sonar.1"}
    run.reviewed(KillUnit("sonar.1"))
    (sonar,) = run.manager.snapshot().qualities
    assert sonar.planned == pytest.approx(800_000, rel=0.06)


def test_what_is_not_seen_for_long_is_tried_again_at_a_horizon() -> None:
    """The sonar is over the bound, and fades back below it while the camera runs; then it is found wanting again."""
    never = Policy(look_every_s=None)
    run = life(horizon_s=120, policy=never, sonar=saying(lambda _: 0.8), camera=saying(lambda _: 0.3))
    run.pass_time(30)
    assert run.units == {"camera.1"}
    run.pass_time(2 * FORGET_S)
    tries = [one for one in run.perturbations(QualitiesObserved)[1:] if "sonar" in one.outputs[0]]
    assert len(tries) == 1
    assert run.units == {"camera.1"}
    assert run.perturbations(HorizonReached) != []


def test_without_observe_nothing_is_taken_in() -> None:
    run = life(sonar=Behaviour(), camera=Behaviour())
    run.pass_time(60)
    assert run.manager.snapshot().qualities == ()


def test_a_plan_stays_fresh_while_qualities_are_learned() -> None:
    """Its basis has what is declared, so that noisy streams do not make it stale."""
    run = life(bound=None, weight_us=1000, sonar=saying(step_at(20, 0.2, 0.3)))
    run.pass_time(10)
    future = run.manager.preview()
    run.settle()
    before = future.result(0)
    run.pass_time(30)
    assert run.perturbations(QualitiesObserved) != []
    future = run.manager.preview()
    run.settle()
    assert future.result(0).basis == before.basis
    plan, basis = read_run_plan(plan_text(before), "plan.json")
    assert plan.change_set is not None
    run.ask(ApplyPlan(plan.change_set, basis))
    assert run.units == {"sonar.1"}


def test_a_plan_file_says_what_was_used_beside_what_is_declared() -> None:
    run = life(sonar=saying(lambda _: 0.4))
    run.pass_time(20)
    future = run.manager.preview()
    run.settle()
    qualities = json.loads(plan_text(future.result(0)))["qualities"]
    assert qualities["sonar/p error"]["declared"] == 0.2
    assert qualities["sonar/p error"]["used"] == pytest.approx(0.4, rel=0.06)


def test_a_drifting_stream_makes_few_reviews() -> None:
    """From 0.2 to 0.45 m in 200 s: a review for each 5 %, not for each second."""
    run = life(sonar=saying(lambda at_s: min(0.2 + at_s / 800, 0.45), noise=0.1))
    run.pass_time(400)
    assert 3 <= len(run.perturbations(QualitiesObserved)) <= 20
    assert run.units == {"sonar.1"}


@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_a_stream_that_drifts_too_slowly_for_any_step_to_be_news_is_replaced_too(noise: float) -> None:
    """From 0.2 to 0.6 m in 2000 s: 1 % in the 10 s after which a stream teaches again."""
    run = life(sonar=saying(lambda at_s: 0.2 + at_s / 5000, noise=noise), policy=Policy(look_every_s=None))
    run.pass_time(2000)
    assert run.units == {"camera.1"}
    assert len(run.perturbations(QualitiesObserved)) <= 25


def test_a_drift_that_changes_no_plan_makes_a_review_every_16_s() -> None:
    """1 % a second: before, each 5 % made one, which was every few seconds."""
    run = life(bound=None, weight_us=1000, sonar=saying(lambda at_s: 0.05 * 1.01**at_s))
    run.pass_time(300)
    reviews = [one for one in run.reviews if isinstance(one.perturbations[0], QualitiesObserved)]
    assert 10 <= len(reviews) <= 20
    intervals_s = [after.at_s - before.at_s for before, after in pairwise(reviews)]
    assert min(intervals_s[3:]) >= 16
    (sonar,) = run.manager.snapshot().qualities
    assert sonar.planned == pytest.approx(sonar.estimate, rel=0.2)


def test_a_bound_is_answered_at_once_though_reviews_of_a_drift_are_rare() -> None:
    run = life(bound=0.5, sonar=saying(lambda at_s: min(0.1 * 1.01**at_s, 0.55 if at_s < 200 else 9)))
    run.pass_time(155)  # the error is 0.47 m
    assert run.units == {"sonar.1"}
    reviews = [one for one in run.reviews if isinstance(one.perturbations[0], QualitiesObserved)]
    assert len(reviews) <= 12
    run.pass_time(12)  # the bound is crossed after 161.7 s, and the mean of the last 5 s follows
    assert "camera.1" in run.units


def test_changed_worlds_forget_outputs_that_are_gone() -> None:
    run = life(bound=None, weight_us=1000, sonar=saying(lambda _: 0.8))
    run.pass_time(20)
    world = run.manager.world
    library = tuple(replace(one, label="lidar") if one.label == "sonar" else one for one in world.environment.library)
    run.reviewed(ReplaceWorld(replace(world, environment=replace(world.environment, library=library)), "a test"))
    run.pass_time(20)
    assert run.manager.snapshot().qualities == ()


@pytest.mark.parametrize("other", [{"value": 800_000}, {"rule": QualityRule.SCALE}, {"over": Over.BEST}])
def test_what_is_declared_anew_is_believed_until_streams_say_otherwise(other: dict[str, Any]) -> None:
    """What was learned was the difference from what was declared before, in the terms of its rule."""
    run = life(bound=None, weight_us=1000, sonar=saying(lambda _: 0.8))
    run.pass_time(20)
    world = run.manager.world
    (sonar,) = (one for one in world.environment.library if one.label == "sonar")
    (port,) = sonar.outputs
    anew = replace(sonar, outputs=(replace(port, quality=(replace(port.quality[0], **other),)),))
    library = tuple(anew if one is sonar else one for one in world.environment.library)
    run.reviewed(ReplaceWorld(replace(world, environment=replace(world.environment, library=library)), "a test"))
    assert run.manager.snapshot().qualities == ()
    run.pass_time(20)
    (view,) = run.manager.snapshot().qualities
    assert view.planned == pytest.approx(800_000, rel=0.06)


def looks_of(run: Life) -> list[LookDue]:
    return [one for review in run.reviews for one in review.perturbations if isinstance(one, LookDue)]


def pass_until_a_look(run: Life) -> None:
    for _ in range(240):
        if not looks_of(run):
            run.pass_time(0.5)
    assert looks_of(run)


def test_a_way_that_was_too_bad_is_looked_at_beside_what_runs_and_taken_once_it_is_good_again() -> None:
    """The sonar is murky from 20 to 400 s; the horizon is far away."""
    truth = lambda at_s: 0.8 if 20 <= at_s < 400 else 0.2  # noqa: E731
    run = life(sonar=saying(truth, noise=0.1), camera=saying(lambda _: 0.3, noise=0.1))
    run.pass_time(40)
    assert run.units == {"camera.1"}
    run.pass_time(360)
    assert looks_of(run)
    assert run.units == {"camera.1"}
    run.pass_time(600)
    assert {unit.split(".")[0] for unit in run.units} == {"sonar"}


def test_looks_that_teach_nothing_become_rare() -> None:
    run = life(sonar=saying(lambda _: 0.8), camera=saying(lambda _: 0.3))
    run.pass_time(3600)
    assert 4 <= len(looks_of(run)) <= 8  # after 60, 120, 240, 480, 960, 960, 960 s
    switches = [review for review in run.reviews if review.change_set and review.change_set.started]
    assert len(switches) == 2 + len(looks_of(run))


def test_each_way_has_its_own_gap_between_looks() -> None:
    """Looks at the sonar, which stays bad, are rare by the time when the lidar fails and is looked at."""
    library = sensor("sonar", 0.2, 1000), sensor("lidar", 0.2, 2000), sensor("camera", 0.3, 100_000)
    behaviours = {
        "sonar": saying(lambda _: 0.8),
        "lidar": saying(lambda at_s: 0.8 if 3000 <= at_s < 3050 else 0.2),
        "camera": saying(lambda _: 0.3),
    }
    run = started(world=watched(*library), behaviours=behaviours)
    run.pass_time(2990)
    assert "lidar.1" in run.units
    run.pass_time(30)
    assert "camera.1" in run.units
    run.pass_time(60)
    assert [look.transformation for look in looks_of(run)][-1] == "lidar"
    assert {unit.split(".")[0] for unit in run.units} == {"lidar"}


def test_a_look_uses_no_topic_and_its_unit_stops_when_it_is_over() -> None:
    run = life(sonar=saying(lambda _: 0.8), camera=saying(lambda _: 0.3))
    pass_until_a_look(run)
    assert looks_of(run) == [LookDue("sonar")]
    (looked_at,) = (unit for unit in run.manager.snapshot().environment.units if unit.transformation == "sonar")
    assert looked_at.publications == ()
    run.pass_time(5)
    assert run.perturbations(LookOver) == [LookOver((looked_at.id,))]
    assert run.units == {"camera.1"}


def test_what_would_not_be_chosen_however_good_is_not_looked_at() -> None:
    """The camera is far dearer, and its weight small: as good as declared it would not run."""
    run = life(bound=None, weight_us=1, sonar=saying(lambda _: 0.2), camera=saying(lambda _: 0.9))
    run.pass_time(600)
    assert (looks_of(run), run.units) == ([], {"sonar.1"})


def choice(declared: dict[str, float], *, horizon_s: int = 3600, **behaviours: Behaviour) -> Life:
    """Sensors of equal cost with these declared errors, in metres; an error of 1 m costs 20 CPU seconds."""
    library = tuple(sensor(label, error, 10_000) for label, error in declared.items())
    target = Target("position", "Position", "/position", quality=(Wish("error", None, 20 * MICRO),))
    environment = Environment(library=library, targets=(target,), qualities=(ERROR,))
    return started(world=api.world(environment, horizon_s=horizon_s), behaviours=behaviours)


def test_a_way_that_never_ran_is_looked_at_and_taken_if_it_is_better_than_declared() -> None:
    run = choice({"sonar": 0.2, "lidar": 0.3}, sonar=saying(lambda _: 0.2), lidar=saying(lambda _: 0.1))
    run.pass_time(58)
    assert (looks_of(run), run.units) == ([], {"sonar.1"})
    run.pass_time(60)
    assert looks_of(run) == [LookDue("lidar")]
    assert run.units == {"lidar.1"}


def test_a_way_that_could_not_be_better_than_what_runs_is_not_looked_at() -> None:
    """The standard deviation of a declared error is half of it: the lidar has 0.3 m at best."""
    run = choice({"sonar": 0.2, "lidar": 0.6}, sonar=saying(lambda _: 0.2), lidar=saying(lambda _: 0.1))
    run.pass_time(1000)
    assert (looks_of(run), run.units) == ([], {"sonar.1"})


@pytest.mark.parametrize(("labor_us", "looks"), [(100_000, True), (900_000, False)])
def test_a_look_is_taken_if_the_plan_may_save_twice_its_cost(labor_us: int, *, looks: bool) -> None:
    """At its best of 0.15 m, the lidar saves 1 s of CPU by its error, less its start."""
    sonar, lidar = sensor("sonar", 0.2, 1000), replace(sensor("lidar", 0.3, 1000), labor_us=labor_us)
    target = Target("position", "Position", "/position", quality=(Wish("error", None, 20 * MICRO),))
    environment = Environment(library=(sonar, lidar), targets=(target,), qualities=(ERROR,))
    behaviours = {label: saying(lambda _: 0.2) for label in ("sonar", "lidar")}
    run = started(world=api.world(environment, horizon_s=60), behaviours=behaviours)
    run.pass_time(90)
    assert bool(looks_of(run)) == looks


def test_a_look_starts_only_what_it_observes_and_the_units_that_feed_it() -> None:
    """The camera says how good its pictures are, so that the finder need not run in a look."""
    stated = Contribution("error", QualityRule.SET, 300_000, observe="error")
    camera = Transformation("camera", (InputPort("t", "Trigger"),), (OutputPort("i", "Image", (stated,)),), 1000, 1000)
    trigger = Transformation("trigger", (), (OutputPort("t", "Trigger"),), 1000, 100)
    added = OutputPort("p", "Position", (Contribution("error", QualityRule.ADD, 0),))
    finder = Transformation("finder", (InputPort("i", "Image"),), (added,), 1000, 1000)
    sources = (replace(one, source=f"units.py:{one.label}") for one in (camera, trigger, finder))
    target = Target("position", "Position", "/position", quality=(Wish("error", MICRO // 2),))
    library = (sensor("beacon", 0.4, 100_000, observe=None), *sources)
    environment = Environment(library=library, targets=(target,), qualities=(ERROR,))
    says = {"i": {"error": Quality(10, 0.8, 0.0)}}
    run = started(world=api.world(environment, horizon_s=36_000), behaviours={"camera": Behaviour(says=lambda _: says)})
    run.pass_time(30)
    assert run.units == {"beacon.1"}
    pass_until_a_look(run)
    assert {unit.split(".")[0] for unit in run.units} == {"beacon", "camera", "trigger"}
    run.pass_time(10)
    assert run.units == {"beacon.1"}


def test_a_horizon_does_not_end_a_look() -> None:
    run = life(horizon_s=60, sonar=saying(lambda _: 0.8), camera=saying(lambda _: 0.3))
    pass_until_a_look(run)
    horizons = len(run.perturbations(HorizonReached))
    run.pass_time(2)
    assert any(unit.startswith("sonar") for unit in run.units)
    run.pass_time(5)
    assert run.perturbations(LookOver) != []
    assert len(run.perturbations(HorizonReached)) <= horizons + 1
    assert run.units == {"camera.1"}


def test_without_looks_there_are_none() -> None:
    run = life(policy=Policy(look_every_s=None), sonar=saying(lambda _: 0.8), camera=saying(lambda _: 0.3))
    run.pass_time(900)
    assert (looks_of(run), run.units) == ([], {"camera.1"})


def test_a_slow_stream_is_looked_at_until_it_has_said_enough() -> None:
    """At one element every 2 s, three seconds would never be enough."""
    truth = lambda at_s: 0.8 if at_s < 200 else 0.2  # noqa: E731
    slow = lambda at_s: {"p": {"error": Quality(1, truth(at_s), 0.0)}} if round(at_s) % 2 else {}  # noqa: E731
    run = life(sonar=Behaviour(says=slow), camera=saying(lambda _: 0.3))
    run.pass_time(100)
    assert "camera.1" in run.units
    run.pass_time(900)
    assert {unit.split(".")[0] for unit in run.units} == {"sonar"}


def test_a_way_that_says_nothing_in_its_look_keeps_no_other_from_being_looked_at() -> None:
    library = sensor("sonar", 0.2, 1000), sensor("lidar", 0.2, 2000), sensor("camera", 0.3, 100_000)
    falls_silent = lambda at_s: {"p": {"error": Quality(10, 0.8, 0.0)}} if at_s < 40 else {}  # noqa: E731
    behaviours = {
        "sonar": Behaviour(says=falls_silent),
        "lidar": saying(lambda at_s: 0.8 if at_s < 200 else 0.2),
        "camera": saying(lambda _: 0.3),
    }
    run = started(world=watched(*library), behaviours=behaviours)
    run.pass_time(40)
    assert run.units == {"camera.1"}
    run.pass_time(1000)
    assert {look.transformation for look in looks_of(run)} == {"sonar", "lidar"}
    assert {unit.split(".")[0] for unit in run.units} == {"lidar"}


def test_looks_go_on_where_there_is_no_room_for_as_many_instances_as_are_asked_for() -> None:
    crowd = Transformation("crowd", (), (OutputPort("c", "C"),), 1, 400_000, min_instances=3)
    library = sensor("sonar", 0.2, 1000), sensor("camera", 0.3, 100_000)
    behaviours = {"sonar": saying(lambda at_s: 0.8 if at_s < 200 else 0.2), "camera": saying(lambda _: 0.3)}
    world = watched(*library, more=(crowd,), hosts=(Host("h", cpu_us=MICRO),))
    run = started(world=world, behaviours=behaviours)
    run.pass_time(40)
    assert "camera.1" in run.units
    run.pass_time(800)
    assert looks_of(run)
    assert not any(unit.startswith("camera") for unit in run.units)


def test_a_look_is_no_reason_to_wake_while_a_perturbation_waits() -> None:
    run = life(sonar=saying(lambda _: 0.8), camera=saying(lambda _: 0.3))
    run.pass_time(40)
    state = run.manager._state
    assert state.look_at_s < inf
    entry = Entry(HorizonReached(1), run.now, run.now + 1000)
    assert replace(state, entries=(entry,)).look_at_s == inf


def test_a_stream_that_follows_its_curve_is_no_news_when_the_fact_changes() -> None:
    """The stream before the change is not measured with what is stated after it, nor are those behind it."""
    curve = Curve("light", ((0, 900_000), (MICRO, 100_000)))
    stated = Contribution("error", QualityRule.SET, 100_000, by=curve, observe="error")
    seeing = Transformation("see", (), (OutputPort("i", "Image", (stated,)),), 1, 1, source="units.py:see")
    added = Contribution("error", QualityRule.ADD, 10_000, observe="error")
    output = OutputPort("p", "Position", (added,))
    finding = Transformation("find", (InputPort("i", "Image"),), (output,), 1, 1, source="units.py:find")
    light = {"now": 1.0}
    environment = Environment(
        library=(seeing, finding),
        targets=(Target("position", "Position", "/position"),),
        qualities=(ERROR,),
        facts=(Fact("light", MICRO),),
    )
    behaviours = {
        "see": Behaviour(says=lambda _: {"i": {"error": Quality(10, 0.9 - 0.8 * light["now"], 0.0)}}),
        "find": saying(lambda _: 0.91 - 0.8 * light["now"]),
    }
    run = started(world=api.world(environment, horizon_s=3600), behaviours=behaviours)
    run.pass_time(30)
    for value in (0.0, 1.0, 0.5, 1.0):
        light["now"] = value
        run.ask(SetFact("light", str(value)))
        run.pass_time(30)
    assert run.perturbations(QualitiesObserved) == []


@pytest.mark.parametrize("mean", [float("nan"), float("inf"), 1e308, -1e308])
def test_sums_that_are_no_numbers_end_no_run(mean: float) -> None:
    run = life(sonar=Behaviour(says=lambda _: {"p": {"error": Quality(10, mean, mean)}}))
    run.pass_time(30)
    assert run.units == {"sonar.1"}
    assert run.manager.snapshot().qualities == ()


def test_modes_that_share_a_state_are_not_looked_at() -> None:
    """Two modes that run at once would write one state."""
    shared = RunOptions(state="place")
    library = tuple(replace(one, run=shared) for one in (sensor("sonar", 0.2, 1000), sensor("camera", 0.3, 100_000)))
    target = Target("position", "Position", "/position", quality=(Wish("error", 500_000),))
    environment = Environment(library=library, targets=(target,), qualities=(ERROR,))
    behaviours = {"sonar": saying(lambda _: 0.8), "camera": saying(lambda _: 0.3)}
    run = started(world=api.world(environment, horizon_s=3600), behaviours=behaviours)
    run.pass_time(600)
    assert (looks_of(run), run.units) == ([], {"camera.1"})


def test_a_stream_that_loses_elements_on_the_way_is_replaced() -> None:
    """The worker drops half of what the sonar gives, once it gives more than the worker takes."""
    lossy = QualityAttribute("loss", Better.LOWER, worst=MICRO)

    def giving(label: str, upkeep_us: int, observe: str | None) -> Transformation:
        stated = Contribution("loss", QualityRule.SET, 0, observe=observe)
        return Transformation(
            label, (), (OutputPort("n", "N", (stated,)),), 1000, upkeep_us, source=f"units.py:{label}"
        )

    work = Transformation("work", (InputPort("x", "N"),), (OutputPort("y", "Y"),), 1000, 100, source="units.py:work")
    target = Target("result", "Y", "/result", quality=(Wish("loss", MICRO // 10),))
    library = giving("fast", 100, "measured.loss"), giving("slow", 1000, None), work
    environment = Environment(library=library, targets=(target,), qualities=(lossy,))
    run = started(world=api.world(environment, horizon_s=3600))
    assert {"fast.1", "work.1"} == run.units
    elements = dropped = 0
    for second in range(30):
        elements, dropped = elements + 10, dropped + (10 if second > 15 else 0)
        counts = {"x": PortCounts(elements, dropped)}
        for unit in run.units:
            if unit.startswith("work"):
                run.manager._hear(UnitStatus(unit, elements, 0, counts, {}))
        run.pass_time(1)
        assert second > 15 or "fast.1" in run.units
    assert "slow.1" in run.units
    (fast,) = (one for one in run.manager.snapshot().qualities if one.transformation == "fast")
    assert MICRO / 10 < fast.planned <= MICRO / 2  # it is replaced as soon as the mean has passed the bound


def test_a_quality_that_a_topic_tells_is_learned_for_the_running_units() -> None:
    world = watched(sensor("sonar", 0.2, 1000, observe="diagnostics.sonar.error"), sensor("camera", 0.3, 100_000))
    run = started(world=world)
    (statement,) = world.environment.told
    for _ in range(20):
        run.manager.tell_quality(statement, 0.8)
        run.pass_time(1)
    assert run.units == {"camera.1"}
    assert run.manager.snapshot().qualities_now["sonar/p error"] == "0.8 m observed, 0.2 m declared"
    run.manager.tell_quality(statement, 0.1)
    run.pass_time(5)
    assert run.units == {"camera.1"}, "nobody tells the quality of a unit that does not run"
