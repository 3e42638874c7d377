"""It gets dark on the field, and the detector finds no ball in dark pictures."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from football import scenario
from units import BallDetector, Beacon, BottomCam, Photometer, Segmenter, Subsampler

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
