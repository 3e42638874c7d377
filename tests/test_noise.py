"""Noisy values: the mean that is compared, and how far beyond a bound it has to be."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cfgplan import api
from cfgplan.cli import main
from cfgplan.domain import Environment, Transformation
from cfgplan.errors import InputError
from cfgplan.facts import Fact
from cfgplan.noise import BAND_ERRORS, HALF_LIFE_S, Noise, NoisyMean, settled_variance

BOUNDS = (1_250_000, 2_250_000, 3_250_000)
VALUES = st.integers(-5_000_000, 5_000_000)
WORLD = """
format: cfgplan/1
facts: {visibility: {declared: 3, by: Visibility, noise: 20 %}}
transformations:
  - {label: sensor, run: {rate: 1}, outputs: {v: Visibility}}
  - {label: high, requires: visibility >= 3.25, outputs: {p: Path}}
  - {label: middle, requires: not visibility < 2.25, outputs: {p: Path}}
targets: [{label: path, topic: /path, tag: Path}]
"""


def test_after_half_a_life_a_mean_is_half_way() -> None:
    mean = NoisyMean(0.0, 0.0, variance=0.1, values=100)
    assert mean.after(1_000_000, HALF_LIFE_S).mean == pytest.approx(500_000)


def test_the_first_values_count_alike() -> None:
    mean = NoisyMean(1_000_000, 0.0)
    for number, value in enumerate((2_000_000, 6_000_000), start=1):
        mean = mean.after(value, number * 1e-6)
    assert mean.mean == pytest.approx(3_000_000)
    assert mean.variance == pytest.approx(1 / 3)


@pytest.mark.parametrize("rate_hz", [0.1, 1.0, 5.0, 30.0])
def test_the_variance_of_a_mean_settles(rate_hz: float) -> None:
    mean = NoisyMean(0.0, 0.0)
    for number in range(2000):
        mean = mean.after(0, number / rate_hz)
    assert mean.variance == pytest.approx(settled_variance(rate_hz))


def test_a_value_changes_sides_only_beyond_the_band_whichever_way_it_goes() -> None:
    noise, variance = Noise(100_000), 0.01
    band = BAND_ERRORS * 10_000

    def told(mean: int, before: int) -> int:
        return NoisyMean(mean, 0.0, variance).planned_value(noise, before, BOUNDS)

    assert told(2_250_000 - band, before=2_250_000) == 2_250_000
    assert told(2_250_000 - band - 1, before=2_250_000) == 2_250_000 - band - 1
    assert told(2_250_000 + band - 1, before=2_249_999) == 2_249_999
    assert told(2_250_000 + band, before=2_249_999) == 2_250_000 + band
    assert told(2_700_000, before=2_300_000) == 2_700_000


@given(st.lists(VALUES, min_size=1), st.lists(VALUES, max_size=4, unique=True), st.integers(1, 300_000), st.booleans())
def test_a_value_is_on_one_side_of_each_bound_and_at_most_a_band_from_the_mean(
    values: list[int], bounds: list[int], amount: int, is_share: bool
) -> None:
    noise, bounds = Noise(amount, is_share), sorted(bounds)
    mean, told = NoisyMean(values[0], 0.0), values[0]
    for number, value in enumerate(values):
        mean = mean if number == 0 else mean.after(value, number * 0.2)
        before, told = told, mean.planned_value(noise, told, bounds)
        for bound in bounds:
            band = noise.band(bound, mean.variance)
            if abs(mean.mean - bound) > band + 1:
                assert (told >= bound) == (mean.mean >= bound)
        crossed = [bound for bound in bounds if (before >= bound) != (told >= bound)]
        assert all(abs(mean.mean - bound) >= noise.band(bound, mean.variance) - 1 for bound in crossed)
        assert abs(told - mean.mean) <= max([noise.band(bound, mean.variance) for bound in bounds], default=0.0) + 2


@pytest.mark.parametrize(
    ("text", "noise"), [("0.1", Noise(100_000)), ("20 %", Noise(200_000, True)), ("2.5%", Noise(25_000, True))]
)
def test_a_noise_is_a_number_or_a_percentage(tmp_path: Path, text: str, noise: Noise) -> None:
    path = tmp_path / "env.yaml"
    path.write_text(WORLD.replace("20 %", text), encoding="utf-8")
    assert api.load(path).environment.fact["visibility"].noise == noise


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("20 %", "0", "this can't be a noise"),
        ("20 %", "0.0 %", "this can't be a noise"),
        ("20 %", "101 %", "this can't be a noise"),
        ("20 %", "loud", "this can't be a noise"),
        ("declared: 3", "declared: clear", "`noise` is only for facts that are numbers"),
        ("by: Visibility, ", "", "`noise` is only for facts with `by` or `topic`"),
        (">= 3.25", "== 3.25", "fact `visibility` has noise, so it can't be compared by `==`"),
    ],
)
def test_a_noise_that_means_nothing_is_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = tmp_path / "env.yaml"
    path.write_text(WORLD.replace(old, new), encoding="utf-8")
    with pytest.raises(InputError) as refused:
        api.load(path)
    assert message in refused.value.faults[0].message
    assert (refused.value.faults[0].line or 0) > 2


@pytest.mark.parametrize(
    ("rate", "noise", "told"), [("1", "20 %", True), ("5", "20 %", False), ("1", "0.01", False), ("0.2", "0.2", True)]
)
def test_check_names_bounds_that_noise_blurs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], rate: str, noise: str, told: bool
) -> None:
    path = tmp_path / "env.yaml"
    path.write_text(WORLD.replace("rate: 1", f"rate: {rate}").replace("20 %", noise), encoding="utf-8")
    assert main(["check", str(path)]) == 0
    assert ("visibility is too noisy to tell 2.25 from 3.25 in time" in capsys.readouterr().err) == told


def test_bounds_are_those_of_all_comparisons() -> None:
    text = "v > 1 or not (v <= 2) and v < -1 or v >= 0 or v == 7"
    environment = Environment(library=(Transformation("t", requires=text),), facts=(Fact("v", 0),))
    assert environment.bounds == {"v": (-1_000_000, 0, 1_000_001, 2_000_001)}
