"""Facts that a run is told or observes: what may not run any more is replaced, what may again comes back at once."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from math import cos, pi
from random import Random
from typing import Any

import pytest
from cfgplan_runtime.lifecycle.basis import plan_text
from cfgplan_runtime.lifecycle.changes import Add, ApplyPlan, LoseHost, RegainHost, ReviewNow, SetFact
from cfgplan_runtime.lifecycle.perturbations import FactsChanged
from cfgplan_runtime.lifecycle.reports import Decision, FactSilent, Review
from simulated_life import Life, source, started, worker

from cfgplan import api
from cfgplan.domain import Environment, Host, RunOptions, Target, Transformation, observing
from cfgplan.errors import InputError
from cfgplan.facts import Fact, FactValue
from cfgplan.formats.plan_file import read_run_plan
from cfgplan.noise import Noise
from cfgplan.qualities import Better, Contribution, Curve, QualityAttribute, QualityRule, Wish

CLEAR = "visibility >= 3.25"


def life() -> Life:
    library = source(), worker(requires=CLEAR), worker("dear", upkeep_us=900_000)
    facts = Fact("visibility", 4_000_000, "m"), Fact("night", False)
    target = Target("result", worker().outputs[0].tag, "/result")
    environment = Environment(library=library, targets=(target,), facts=facts)
    return started(world=api.world(environment, horizon_s=60))


def test_what_may_not_run_is_replaced_and_comes_back_as_soon_as_it_may() -> None:
    run = life()
    assert run.units == {"count.1", "work.1"}
    review = run.reviewed(SetFact("visibility", "1.5"))
    assert (run.units, dict(review.avoided)) == ({"count.1", "dear.1"}, {"work": "visibility is 1.5 m"})
    assert dict(run.manager.snapshot().left_out) == {"work": "visibility is 1.5 m"}
    back = run.reviewed(SetFact("visibility", "3.25"))
    assert (run.units, back.decision) == ({"count.1", "work.1"}, Decision.APPLIED)
    assert run.perturbations(FactsChanged) == [FactsChanged(("work",)), FactsChanged((), ("work",))]


def test_a_target_that_a_fact_keeps_from_being_met_says_so_and_the_present_value() -> None:
    facts = (Fact("visibility", 4_000_000, "m"),)
    target = Target("result", worker().outputs[0].tag, "/result")
    environment = Environment(library=(source(), worker(requires=CLEAR)), targets=(target,), facts=facts)
    run = started(world=api.world(environment, horizon_s=60))
    for value in ("1.5", "1"):
        run.ask(SetFact("visibility", value))
        run.reviewed(ReviewNow())
        (seen,) = run.manager.snapshot().targets
        assert seen.reason.endswith(
            f"but needs transformations that are left out for now: work (visibility is {value} m)"
        )


def test_a_run_warns_of_two_units_that_save_one_state() -> None:
    modes = (worker(label, gives=label, run=RunOptions(state="mode")) for label in ("one", "two"))
    library = (source(), *modes)
    targets = tuple(Target(each.label, each.outputs[0].tag, f"/{each.label}") for each in library[1:])
    run = started(world=api.world(Environment(library=library, targets=targets), horizon_s=60))
    assert any("units one.1, two.1 save state mode at once" in text for text in run.reviews[-1].warnings)


@pytest.mark.parametrize(("name", "value"), [("visibility", "7"), ("night", "true")])
def test_a_value_on_the_same_side_is_known_and_makes_no_review(name: str, value: str) -> None:
    run = life()
    reviews = len(run.reviews)
    assert run.ask(SetFact(name, value)) is None
    assert (len(run.reviews), run.units) == (reviews, {"count.1", "work.1"})
    assert f"{name} is {value}" in [str(fact).removesuffix(" m") for fact in run.manager.snapshot().facts]


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [("visibilty", "1", "there is no fact"), ("visibility", "dark", "is a number"), ("night", "1", "is true or false")],
)
def test_what_can_not_be_so_is_refused(name: str, value: str, message: str) -> None:
    run = life()
    with pytest.raises(InputError, match=message):
        run.ask(SetFact(name, value))
    assert run.units == {"count.1", "work.1"}


def test_a_fact_of_an_environment_without_facts_is_refused_with_the_place_to_declare_it() -> None:
    environment = Environment(library=(source(), worker()), targets=(Target("result", worker().outputs[0].tag, "/r"),))
    run = started(world=api.world(environment, horizon_s=60))
    with pytest.raises(InputError, match=r"no fact `night` \(declare it under `facts:`"):
        run.ask(SetFact("night", "true"))


def test_a_preview_and_a_given_plan_see_the_facts_that_were_said() -> None:
    run = life()
    run.reviewed(SetFact("visibility", "1"))
    future = run.manager.preview()
    run.settle()
    assert dict(future.result(0).findings.avoided) == {"work": "visibility is 1 m"}


def observed_life(**more: Any) -> Life:
    fact = Fact("visibility", 4_000_000, "m", by="Visibility", **more)
    library = source(), worker(requires=CLEAR), worker("dear", upkeep_us=900_000), source("sensor", tag="Visibility")
    targets = Target("result", worker().outputs[0].tag, "/result"), observing(fact)
    environment = Environment(library=library, targets=tuple(filter(None, targets)), facts=(fact,))
    return started(world=api.world(environment, horizon_s=60))


def see(run: Life, *values: int, every_s: float = 1.0) -> None:
    """Let a stream say the value of visibility, again and again."""
    for value in values:
        run.manager.observe_fact("visibility", value)
        run.pass_time(every_s)


def test_what_a_stream_says_of_a_fact_changes_what_runs() -> None:
    run = observed_life()
    assert run.units == {"count.1", "sensor.1", "work.1"}
    see(run, 3_500_000, 3_250_000, 3_249_999)
    assert run.units == {"count.1", "sensor.1", "dear.1"}
    assert dict(run.manager.snapshot().left_out) == {"work": "visibility is 3.249999 m"}
    see(run, 1_000_000, 3_250_000)
    assert run.units == {"count.1", "sensor.1", "work.1"}
    assert run.perturbations(FactsChanged) == [FactsChanged(("work",)), FactsChanged((), ("work",))]


SINE_S, SWING, MIDDLE = 80.0, 1.25, 2.5
HEIGHTS = {"high": "3.25", "middle": "2.25", "low": "1.25"}


def survey(noise: Noise | None) -> Life:
    """A survey at three heights, as SUAVE has it: the higher the better, as far as the visibility allows."""
    fact = Fact("visibility", 4_000_000, "m", by="Visibility", noise=noise)
    heights = [
        source(label, tag="Path", upkeep_us=1000 * (number + 1), requires=f"visibility >= {least}")
        for number, (label, least) in enumerate(HEIGHTS.items())
    ]
    library = *heights, source("drift", tag="Path", upkeep_us=100_000), source("sensor", tag="Visibility")
    targets = Target("path", "Path", "/path"), observing(fact)
    environment = Environment(library=library, targets=tuple(filter(None, targets)), facts=(fact,))
    return started(world=api.world(environment, horizon_s=3600))


def play(run: Life, truth: Callable[[float], float], *, seconds: int, rate_hz: int, share: float) -> None:
    chance = Random(1)
    for number in range(seconds * rate_hz):
        value = truth(number / rate_hz) * (1 + share * chance.gauss(0, 1))
        see(run, round(value * 1_000_000), every_s=1 / rate_hz)


def sine(time_s: float) -> float:
    return MIDDLE + SWING * cos(2 * pi * time_s / SINE_S)


def test_noise_around_a_bound_changes_nothing_and_a_crossing_makes_one_review_that_optimises() -> None:
    run = survey(Noise(200_000, is_share=True))
    see(run, *[2_700_000] * 40, every_s=0.2)
    before = len(run.reviews)
    assert "middle.1" in run.units
    play(run, lambda _: 2.25, seconds=120, rate_hz=5, share=0.2)
    assert (len(run.reviews), "middle.1" in run.units) == (before, True)
    play(run, lambda _: 4.5, seconds=20, rate_hz=5, share=0.2)
    assert [review.decision for review in run.reviews[before:]] == [Decision.APPLIED]
    assert run.perturbations(FactsChanged)[-1] == FactsChanged((), ("high",))
    assert "high.1" in run.units


def test_noisy_values_are_followed_without_a_switch_too_many() -> None:
    """SUAVE's sine with 20 % noise at 5 Hz: 24 crossings in 480 s. Raw values make more than a thousand changes."""
    run = survey(Noise(200_000, is_share=True))
    play(run, sine, seconds=480, rate_hz=5, share=0.2)
    assert 23 <= len(run.perturbations(FactsChanged)) <= 25
    assert len(run.reviews) <= 30


def test_two_wrong_values_change_nothing_and_a_jump_is_followed_at_its_third_value() -> None:
    run = survey(Noise(200_000, is_share=True))
    see(run, *[2_700_000] * 40, every_s=0.2)
    before = len(run.reviews)
    see(run, 65_535_000_000, *[2_700_000] * 20, 0, 65_535_000_000, 2_700_000, 0, 0, every_s=0.2)
    assert (len(run.reviews), "middle.1" in run.units) == (before, True)
    see(run, 2_700_000, 500_000, 500_000, every_s=0.2)
    assert (len(run.reviews), "middle.1" in run.units) == (before, True)
    see(run, 500_000, every_s=0.2)
    assert [review.decision for review in run.reviews[before:]] == [Decision.APPLIED]
    assert "drift.1" in run.units


def test_values_without_noise_are_compared_as_they_come() -> None:
    run = survey(None)
    play(run, lambda time_s: sine(time_s + 0.5), seconds=480, rate_hz=1, share=0.0)
    assert len(run.perturbations(FactsChanged)) == 24
    see(run, 2_000_000, 2_250_000, 2_249_999)
    assert [tuple(each.back) for each in run.perturbations(FactsChanged)[-2:]] == [("middle",), ()]


ERROR = QualityAttribute("error", Better.LOWER, worst=5_000_000)
BY_BRIGHTNESS = Curve("brightness", ((200_000, 900_000), (1_000_000, 100_000)))


def night(noise: Noise | None) -> Life:
    """A camera whose error rises as it gets dark, and a sonar that costs more; an error of 0.5 at most is wanted."""

    def stating(transformation: Transformation, value: int, by: Curve | None = None) -> Transformation:
        (port,) = transformation.outputs
        stated = Contribution("error", QualityRule.SET if transformation.label != "detect" else QualityRule.ADD, value)
        return replace(transformation, outputs=(replace(port, quality=(replace(stated, by=by),)),))

    fact = Fact("brightness", 1_000_000, by="Brightness", noise=noise)
    library = (
        stating(source("camera", tag="Image", upkeep_us=20_000), 100_000, BY_BRIGHTNESS),
        stating(worker("detect", needs="Image", gives="Ball", upkeep_us=50_000), 100_000),
        stating(source("sonar", tag="Ball", upkeep_us=300_000), 400_000),
        source("photometer", tag="Brightness", upkeep_us=1000),
    )
    ball = Target("ball", "Ball", "/ball", quality=(Wish("error", bound=500_000),))
    targets = tuple(filter(None, (ball, observing(fact))))
    environment = Environment(library=library, targets=targets, qualities=(ERROR,), facts=(fact,))
    return started(world=api.world(environment, horizon_s=60))


def test_a_quality_follows_a_fact_away_at_night_and_back_at_dawn() -> None:
    """It gets dark from 100 to 130 s and light again from 300 to 330 s; the camera needs 0.7 of the light."""
    run, chance = night(Noise(200_000, is_share=True)), Random(2)
    begun_s, switches, too_bad_s, runs_camera = run.now, list[float](), 0.0, True
    while (time_s := run.now - begun_s) < 500:
        light = 1 - 0.95 * (min(1, max(0, (time_s - 100) / 30)) - min(1, max(0, (time_s - 300) / 30)))
        run.manager.observe_fact("brightness", round(light * (1 + 0.2 * chance.gauss(0, 1)) * 1_000_000))
        run.pass_time(0.2)
        if ("camera.1" in run.units) != runs_camera:
            runs_camera = not runs_camera
            switches.append(time_s)
        too_bad_s += 0.2 * (runs_camera and BY_BRIGHTNESS.at(round(light * 1_000_000)) > 400_000)
    assert [round(at_s, -2) for at_s in switches] == [100, 300]
    assert too_bad_s / 500 < 0.02
    assert dict(run.manager.snapshot().qualities_now).keys() == {"camera/n error"}
    assert {each.requalified for each in run.perturbations(FactsChanged)} == {("camera",)}


def test_a_quality_that_a_fact_hardly_changes_makes_no_review() -> None:
    run = night(None)
    before = len(run.reviews)
    for value in (1_000_000, 995_001, 1_200_000):
        run.manager.observe_fact("brightness", value)
        run.pass_time(1)
    assert len(run.reviews) == before
    run.manager.observe_fact("brightness", 994_999)
    run.pass_time(1)
    assert [review.decision for review in run.reviews[before:]] == [Decision.KEPT]


def test_a_fact_that_is_said_changes_what_follows_it_at_once() -> None:
    run = night(Noise(100_000))
    assert run.reviewed(SetFact("brightness", "0.5")).perturbations == (FactsChanged(requalified=("camera",)),)
    assert "sonar.1" in run.units
    run.reviewed(SetFact("brightness", "1"))
    assert "camera.1" in run.units


def test_a_value_that_is_said_begins_a_new_mean() -> None:
    run = survey(Noise(100_000))
    see(run, *[4_000_000] * 50, every_s=0.2)
    run.reviewed(SetFact("visibility", "2.5"))
    assert "middle.1" in run.units
    see(run, *[2_500_000] * 5, every_s=0.2)
    assert "middle.1" in run.units


def test_a_fact_that_falls_silent_is_what_is_declared_again_and_that_is_told_once() -> None:
    run = observed_life(silent_us=5_000_000)
    see(run, 1_000_000)
    assert "dear.1" in run.units
    run.pass_time(3.9)
    assert "dear.1" in run.units
    run.pass_time(0.2)
    run.settle()
    assert "work.1" in run.units
    run.pass_time(30)
    assert [report for report in run.reports if isinstance(report, FactSilent)] == [FactSilent("visibility", 5.0, "4")]


def test_a_fact_without_a_limit_is_what_was_said_last() -> None:
    run = observed_life()
    see(run, 1_000_000)
    run.pass_time(3600)
    assert "dear.1" in run.units


@pytest.mark.parametrize(("name", "value"), [("visibility", True), ("depth", 1_000_000)])
def test_what_a_stream_says_of_another_fact_or_of_another_kind_is_ignored(name: str, value: FactValue) -> None:
    run = observed_life()
    run.manager.observe_fact(name, value)
    run.pass_time(1)
    assert run.perturbations(FactsChanged) == []
    assert "work.1" in run.units


def test_what_would_require_the_fact_that_it_observes_is_refused_in_a_run_too() -> None:
    run = observed_life()
    with pytest.raises(InputError, match="sensor requires visibility, and observes it"):
        run.ask(Add(transformations=(source("sensor", tag="Visibility", requires=CLEAR),)))
    assert run.units == {"count.1", "sensor.1", "work.1"}
    see(run, 1_000_000)
    assert "dear.1" in run.units


def written_plan(run: Life) -> dict[str, Any]:
    future = run.manager.preview()
    run.settle()
    plan: dict[str, Any] = json.loads(plan_text(future.result(timeout=0)))
    return plan


def apply(run: Life, written: dict[str, Any]) -> Review:
    plan, basis = read_run_plan(json.dumps(written), "plan.json")
    assert plan.change_set is not None
    return run.reviewed(ApplyPlan(plan.change_set, basis, "plan.json"))


def test_a_plan_is_stale_once_a_comparison_is_the_other_way_round_not_before() -> None:
    run = life()
    written = written_plan(run)
    assert written["facts"]["visibility"] == {"declared": 4.0, "used": 4.0}
    run.ask(SetFact("visibility", "3.5"))
    assert written_plan(run)["facts"]["visibility"] == {"declared": 4.0, "used": 3.5}
    assert written_plan(run)["basis"] == written["basis"]
    apply(run, written)
    run.reviewed(SetFact("visibility", "1"))
    with pytest.raises(InputError) as refused:
        apply(run, written)
    assert "the plan is stale: fact visibility >= 3.25 is not as it was" in str(refused.value)


def test_a_plan_is_not_stale_because_a_quality_has_followed_a_fact() -> None:
    run = night(None)
    written = written_plan(run)
    run.reviewed(SetFact("brightness", "0.8"))
    assert "camera.1" in run.units
    assert apply(run, written).decision is Decision.APPLIED


def life_on_hosts(fact: Fact | None = None) -> Life:
    """A worker that may run on hosts with a good battery; `b` is slower than `a`."""
    facts = (fact or Fact("battery", 100_000_000, "%", of="host"),)
    hosts = Host("a", 1_000_000), Host("b", 1_000_000, speed=500_000)
    library = source(), worker(requires="battery > 20")
    target = Target("result", worker().outputs[0].tag, "/result")
    environment = Environment((), library, (target,), hosts, facts=facts)
    return started(world=api.world(environment, horizon_s=60))


def placed(run: Life) -> dict[str, str | None]:
    return {unit.transformation: unit.host for unit in run.runtime.environment.units}


def test_a_unit_leaves_a_host_whose_fact_forbids_it_and_comes_back() -> None:
    run = life_on_hosts()
    assert placed(run)["work"] == "a"
    review = run.reviewed(SetFact("a.battery", "15"))
    assert (placed(run)["work"], review.decision) == ("b", Decision.APPLIED)
    assert run.manager.snapshot().barred == {"work": {"a": "needs battery > 20, battery is 15 % on a"}}
    assert run.ask(SetFact("a.battery", "16")) is None, "on the same side of the bound"
    gone = run.reviewed(SetFact("b.battery", "3"))
    assert dict(gone.avoided) == {"work": "battery is 16 % on a and battery is 3 % on b"}
    run.reviewed(SetFact("a.battery", "21"))
    assert placed(run)["work"] == "a"
    assert run.perturbations(FactsChanged) == [
        FactsChanged(("work on a",)),
        FactsChanged(("work",)),
        FactsChanged((), ("work",)),
    ]


def test_facts_of_a_host_outlast_its_absence() -> None:
    run = life_on_hosts()
    run.reviewed(SetFact("a.battery", "15"))
    lost = run.reviewed(LoseHost("b"))
    assert dict(lost.avoided) == {"work": "host b is gone"}
    run.reviewed(RegainHost("b"))
    assert placed(run)["work"] == "b"


def test_values_that_streams_say_of_a_host_are_filtered_and_fall_silent_on_their_own() -> None:
    more: dict[str, Any] = {"by": "Battery_{host}", "noise": Noise(200_000, is_share=True), "silent_us": 5_000_000}
    run = life_on_hosts(Fact("battery", 100_000_000, "%", of="host", **more))
    run.manager.observe_fact("a.battery", 19_000_000)
    run.pass_time(0.1)
    assert placed(run)["work"] == "a", "one noisy value is no news"
    for _ in range(40):
        run.manager.observe_fact("a.battery", 5_000_000)
        run.pass_time(0.2)
    assert placed(run)["work"] == "b"
    run.pass_time(6)
    assert [report.fact for report in run.reports if isinstance(report, FactSilent)] == ["a.battery"]
    assert placed(run)["work"] == "a"


def test_a_plan_is_stale_once_a_fact_of_a_host_is_on_the_other_side() -> None:
    run = life_on_hosts()
    written = written_plan(run)
    assert written["facts"]["b.battery"] == {"declared": 100.0, "used": 100.0}
    run.reviewed(SetFact("a.battery", "15"))
    with pytest.raises(InputError) as refused:
        apply(run, written)
    assert "the plan is stale: fact a.battery > 20 is not as it was" in str(refused.value)
