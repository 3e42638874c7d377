"""It gets dark on the field, and the detector finds no ball in dark pictures."""

from __future__ import annotations

import itertools
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from random import Random

import numpy as np
import pytest
from cfgplan_runtime import Manager, SimulatedRuntime
from cfgplan_runtime.children.messages import Qualities, Quality
from cfgplan_runtime.supervision.simulated_backend import Behaviour
from football import scenario
from units import ERROR_BY_LIGHT, BallDetector, Beacon, BottomCam, ExposedCam, Photometer, Segmenter, Subsampler

import cfgplan

NAO = Path(__file__).parents[2] / "models" / "nao"
BY_LOOKS = NAO / "8-night-by-looks.yaml"
DAY_S = 120.0
FRAMES = 20


def test_half_of_a_day_is_light_and_each_day_is_like_the_one_before() -> None:
    lights = [scenario.light(second * 10**9, DAY_S) for second in range(120)]
    assert (min(lights), max(lights)) == (pytest.approx(0.05), 1.0)
    assert sum(light >= 0.8 for light in lights) == pytest.approx(60, abs=2)
    assert scenario.light(17 * 10**9, DAY_S) == scenario.light((17 + 120) * 10**9, DAY_S)
    assert scenario.light(90 * 10**9, None) == 1.0


@pytest.mark.parametrize(("least", "most", "finds_it"), [(0.85, 1.0, True), (0.0, 0.5, False)])
def test_a_ball_is_found_in_pictures_that_are_light_enough(least: float, most: float, *, finds_it: bool) -> None:
    camera, subsampler, segmenter, detector = BottomCam("piff", DAY_S), Subsampler(), Segmenter(), BallDetector()
    times = (scenario.time_of_frame(number * 11) for number in itertools.count(1000))
    chosen = itertools.islice((time for time in times if least <= scenario.light(time, DAY_S) <= most), FRAMES)
    found = 0
    for time_ns in chosen:
        images = subsampler(camera.picture(time_ns))
        hull = segmenter(images["y80"], images["v80"])
        found += hull is not None and detector(hull, images["y640"], images["y320"]) is not None
    assert found >= FRAMES - 1 if finds_it else found <= 1


def error_at(light: float) -> float:
    return float(np.interp(light, *zip(*ERROR_BY_LIGHT, strict=True)))


def test_a_camera_says_how_far_its_dark_pictures_mislead() -> None:
    camera = ExposedCam("piff", DAY_S)
    for time_ns in (scenario.time_of_frame(number * 90) for number in range(1000, 1020)):
        said = camera.measured(time_ns)
        light = scenario.light(time_ns, DAY_S)
        assert said.quality["error"] == pytest.approx(error_at(light), abs=0.08)
        assert np.asarray(said.value).shape == (480, 640, 2)


def test_at_night_the_camera_is_looked_at_until_it_is_day_again() -> None:
    """Two nights: two switches each, over the bound for at most 2 % of the time, and looks at the camera alone."""
    loaded, chance = cfgplan.load(BY_LOOKS), Random(1)
    world = replace(loaded, environment=replace(loaded.environment, units=()))
    day_s = float(world.environment.transformation["bottom_cam(piff)"].params["day_s"])

    def truth(at_s: float) -> float:
        return error_at(scenario.light(round(at_s * 1e9), day_s))

    def says(at_s: float) -> Qualities:
        light = scenario.light(round(at_s * 1e9), day_s)
        errors = [error_at(light * chance.gauss(1, 0.005)) for _ in range(15)]
        mean = float(np.mean(errors))
        return {"image": {"error": Quality(15, mean, 15 * float(np.var(errors)))}}

    runtime = SimulatedRuntime(behaviours={"bottom_cam(piff)": Behaviour(says=says)})
    manager = Manager(world, runtime, clock=runtime.clock)
    seen = list[tuple[bool, bool, bool]]()
    for _ in range(round(2.4 * day_s)):
        manager.run(1.0)
        labels = {unit.transformation for unit in runtime.environment.units}
        by_camera = any(unit.publications for unit in runtime.environment.units if unit.transformation != "beacon")
        assert by_camera or labels <= {"beacon", "bottom_cam(piff)"}
        seen.append((by_camera, "bottom_cam(piff)" in labels, truth(runtime.clock.now()) > 0.4))
    assert sum(before[0] != after[0] for before, after in pairwise(seen)) == 4
    assert sum(by_camera and is_bad for by_camera, _, is_bad in seen) <= 0.02 * len(seen)
    assert sum(after[1] and not after[0] and not before[1] for before, after in pairwise(seen)) >= 4  # looks


def test_by_a_fact_the_camera_is_used_for_at_most_four_seconds_of_each_night() -> None:
    """Smoothing takes 1.44 times its half-life of 2 s, and the band 0.6 s: 3 % of a day of 120 s."""
    loaded, chance = cfgplan.load(NAO / "8-night.yaml"), Random(1)
    runtime = SimulatedRuntime()
    world = replace(loaded, environment=replace(loaded.environment, units=()))
    manager = Manager(world, runtime, clock=runtime.clock)
    seen = list[tuple[bool, bool]]()
    for _ in range(round(2.2 * DAY_S / 0.2)):
        light = scenario.light(round(runtime.clock.now() * 1e9), DAY_S)
        manager.observe_fact("brightness", round(light * chance.gauss(1, 0.05) * 1e6))
        manager.run(0.2)
        by_camera = any(unit.transformation == "bottom_cam(piff)" for unit in runtime.environment.units)
        seen.append((by_camera, error_at(scenario.light(round(runtime.clock.now() * 1e9), DAY_S)) > 0.4))
    assert sum(before[0] != after[0] for before, after in pairwise(seen)) == 4
    assert sum(before[1] != after[1] for before, after in pairwise(seen)) == 4
    assert 2 * 2.5 <= 0.2 * sum(by_camera and is_bad for by_camera, is_bad in seen) <= 2 * 4


def test_a_photometer_says_how_light_it_is_about(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("units.time.time_ns", lambda: 90 * 10**9)
    said = [value["light"] for value in itertools.islice(Photometer(DAY_S), 400)]
    assert float(np.mean(said)) == pytest.approx(scenario.light(90 * 10**9, DAY_S), rel=0.02)
    assert float(np.std(said)) == pytest.approx(0.05 * float(np.mean(said)), rel=0.2)


def test_a_beacon_is_as_far_off_as_it_says() -> None:
    beacon, time_ns = Beacon(), 10**18
    positions = [beacon.position(time_ns) for _ in range(400)]
    x, y = scenario.ball(time_ns)
    off = np.array([(position["x"] - x, position["y"] - y) for position in positions])
    assert off.std(axis=0) == pytest.approx(np.sqrt(positions[0]["covariance"][0]), rel=0.15)
