"""Noisy values: the mean that is compared, and how far beyond a bound it has to be."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from cfgplan import api
from cfgplan.cli import main
from cfgplan.domain import Environment, Transformation
from cfgplan.errors import InputError
from cfgplan.facts import Fact
from cfgplan.noise import BAND_ERRORS, HALF_LIFE_S, Noise, NoisyMean, settled_variance

BOUNDS = (1_250_000, 2_250_000, 3_250_000)
VALUES = st.integers(-5_000_000, 5_000_000)
LOUD, SIGMA = Noise(2_000_000), Noise(10_000)
RATES_HZ = st.sampled_from((0.1, 1.0, 5.0, 30.0))
ERRORS = st.floats(-2, 2)
"""Ordinary errors of single values, in standard deviations."""
CODES = st.sampled_from((0, -1_000_000, 65_535_000_000, 2**31 * 1_000_000, -(2**31) * 1_000_000))
"""Values that sensors send for "nothing seen" or "out of range"."""
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
    assert mean.after(1_000_000, HALF_LIFE_S, LOUD).mean == pytest.approx(500_000)


def test_the_first_values_count_alike() -> None:
    mean = NoisyMean(0.0, 0.0)
    for number, value in enumerate((1_000_000, 2_000_000, 6_000_000)):
        mean = mean.after(value, number * 1e-6, LOUD)
    assert mean.mean == pytest.approx(3_000_000)
    assert mean.variance == pytest.approx(1 / 3)


@pytest.mark.parametrize("rate_hz", [0.1, 1.0, 5.0, 30.0])
def test_the_variance_of_a_mean_settles(rate_hz: float) -> None:
    mean = NoisyMean(0.0, 0.0)
    for number in range(2000):
        mean = mean.after(0, number / rate_hz, LOUD)
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
        mean = mean.after(value, number * 0.2, noise)
        before, told = told, mean.planned_value(noise, told, bounds)
        for bound in bounds:
            band = noise.band(bound, mean.variance)
            if abs(mean.mean - bound) > band + 1:
                assert (told >= bound) == (mean.mean >= bound)
        crossed = [bound for bound in bounds if (before >= bound) != (told >= bound)]
        assert all(abs(mean.mean - bound) >= noise.band(bound, mean.variance) - 1 for bound in crossed)
        assert abs(told - mean.mean) <= max([noise.band(bound, mean.variance) for bound in bounds], default=0.0) + 2


class PlainMean:
    """The mean with the same half-life and band, to which every value counts."""

    def __init__(self, mean: float, variance: float, rate_hz: float) -> None:
        self.mean, self._variance, self._share = mean, variance, 1 - 0.5 ** (1 / rate_hz / HALF_LIFE_S)

    def after(self, value: float) -> PlainMean:
        self.mean += self._share * (value - self.mean)
        return self

    def is_above(self, bound: int, noise: Noise) -> bool:
        return self.mean >= bound + noise.band(bound, self._variance)


def settled(value: int, rate_hz: float) -> NoisyMean:
    return NoisyMean(value, 0.0, settled_variance(rate_hz), values=1000)


@given(
    st.lists(st.tuples(ERRORS, st.lists(CODES, max_size=2)), min_size=1, max_size=30),
    st.sampled_from((Noise(100_000), Noise(200_000, is_share=True), Noise(20_000, is_share=True))),
    RATES_HZ,
)
def test_a_spike_of_few_values_changes_nothing(
    series: list[tuple[float, list[int]]], noise: Noise, rate_hz: float
) -> None:
    """Each ordinary value comes behind up to two spikes, also the first one."""
    truth = 3_000_000
    clean = spoilt = NoisyMean(truth, 0.0)
    clean_told = spoilt_told = truth
    at_s = 0.0
    for error, spikes in series:
        for spike in spikes:
            at_s += 1 / rate_hz
            spoilt = spoilt.after(spike, at_s, noise)
            told = spoilt.planned_value(noise, spoilt_told, BOUNDS)
            assert [told >= bound for bound in BOUNDS] == [clean_told >= bound for bound in BOUNDS]
        at_s += 1 / rate_hz
        value = round(truth + error * noise.at(truth))
        clean, spoilt = (mean.after(value, at_s, noise) for mean in (clean, spoilt))
        assert spoilt == clean
        clean_told, spoilt_told = (
            mean.planned_value(noise, told, BOUNDS) for mean, told in ((clean, clean_told), (spoilt, spoilt_told))
        )


@given(st.lists(ERRORS, max_size=20), st.lists(ERRORS, min_size=3, max_size=20), st.floats(12, 1e9), RATES_HZ)
@example(before=[1.0], after=[0.0, 0.0, -2.0], size=12.0, rate_hz=5.0)
def test_a_jump_that_lasts_is_followed_at_its_third_value(
    before: list[float], after: list[float], size: float, rate_hz: float
) -> None:
    """From 12 standard deviations on, each value after the jump is an outlier, also if the mean is of one value:
    12 - 2 - 2 > OUTLIER_ERRORS * sqrt(2). A smaller jump may be an ordinary error of that value.
    """
    sigma = SIGMA.amount
    mean = NoisyMean(0, 0.0)
    for number, error in enumerate(before):
        mean = mean.after(round(error * sigma), number / rate_hz, SIGMA)
    for number, error in enumerate(after, start=len(before)):
        mean = mean.after(round((size + error) * sigma), number / rate_hz, SIGMA)
        if number >= len(before) + 2:
            assert abs(mean.mean - size * sigma) <= 2 * sigma + 1


@given(st.lists(st.one_of(ERRORS, CODES.map(float)), min_size=5, max_size=40), RATES_HZ)
def test_no_five_values_in_a_row_are_left_out(series: list[float], rate_hz: float) -> None:
    """Three of five are on one side, so that also every second value may be wrong without blinding a run for ever."""
    mean, unchanged = NoisyMean(0, 0.0), 0
    for number, error in enumerate(series):
        before, mean = mean, mean.after(round((50 + error) * SIGMA.amount), number / rate_hz, SIGMA)
        unchanged = unchanged + 1 if mean.at_s == before.at_s and mean.values == before.values else 0
        assert unchanged < 5


@pytest.mark.parametrize("spikes", [[65535.0], [65535.0, 65535.0], [0.0], [65535.0, 0.0]])
def test_a_jump_down_or_up_is_followed_among_alternating_wrong_values(spikes: list[float]) -> None:
    mean = settled(5_000_000, 5.0)
    truth = 6.0 if spikes == [0.0] else 4.0
    for number in range(1, 30):
        for value in (truth, truth, *spikes):
            mean = mean.after(round(value * 1e6), number * 0.2, SIGMA)
    assert mean.mean == truth * 1e6


@given(st.floats(0, 100), st.floats(0.05, 0.95), RATES_HZ)
def test_a_jump_of_any_size_is_noticed_as_soon_as_by_a_plain_mean_or_at_its_third_value(
    size: float, part: float, rate_hz: float
) -> None:
    level, bound = round(size * SIGMA.amount), round(part * size * SIGMA.amount)
    mean, told, plain = settled(0, rate_hz), 0, PlainMean(0.0, settled_variance(rate_hz), rate_hz)
    for number in range(1, 400):
        mean = mean.after(level, number / rate_hz, SIGMA)
        told = mean.planned_value(SIGMA, told, (bound,))
        is_noticed = plain.after(level).is_above(bound, SIGMA)
        if bound > 0 and is_noticed and number >= 3:
            assert told >= bound


@given(st.floats(0, 100), RATES_HZ)
def test_a_steady_change_is_followed_at_most_two_values_later_than_by_a_plain_mean(
    slope: float, rate_hz: float
) -> None:
    step = slope * SIGMA.amount
    mean, plain = settled(0, rate_hz), PlainMean(0.0, settled_variance(rate_hz), rate_hz)
    for number in range(1, 200):
        truth = round(number * step)
        mean, plain = mean.after(truth, number / rate_hz, SIGMA), plain.after(truth)
        assert abs(truth - mean.mean) <= abs(truth - plain.mean) + 2 * step + 1


@given(st.lists(st.floats(2.5, 3.5), min_size=3, max_size=30), st.floats(-1, 2))
def test_a_sensor_that_is_noisier_than_declared_is_followed_too(values: list[float], start: float) -> None:
    mean = NoisyMean(round(start * 1_000_000), 0.0)
    for number, value in enumerate(values):
        mean = mean.after(round(value * 1_000_000), number * 0.2, SIGMA)
        assert number < 2 or 2_500_000 <= mean.mean <= 3_500_000


def test_an_error_code_that_lasted_is_left_at_the_third_true_value() -> None:
    noise, mean = Noise(200_000, is_share=True), settled(3_000_000, 5.0)
    for number, value in enumerate([65_535_000_000] * 20 + [3_000_000] * 3):
        mean = mean.after(value, number * 0.2, noise)
    assert mean.mean == 3_000_000


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
