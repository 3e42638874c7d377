"""Forecasts and forecasters, as numbers."""

from __future__ import annotations

import random

import pytest
from cfgplan_runtime.estimating.forecasters import FORECASTERS, Average, Damped, Forecast, Latest, Trend, damped
from cfgplan_runtime.estimating.history import CostSample, History
from hypothesis import given
from hypothesis import strategies as st

from experiments.estimating.holt import Holt

MEMORY_S = 60.0
values = st.floats(0, 1e7)
histories = st.lists(st.tuples(st.floats(0.01, 500), values, st.floats(0.01, 100)), min_size=1, max_size=40)


def samples(*values_us: float, every_s: float = 5.0) -> list[CostSample]:
    return [CostSample(n * every_s, (n + 1) * every_s, value, every_s) for n, value in enumerate(values_us)]


def read(history: list[tuple[float, float, float]]) -> list[CostSample]:
    now, found = 0.0, []
    for gap, value, weight in history:
        found.append(CostSample(now, now + gap, value, weight))
        now += gap
    return found


@pytest.mark.parametrize("name", FORECASTERS)
@given(history=histories)
def test_a_level_stays_within_what_was_observed(name: str, history: list[tuple[float, float, float]]) -> None:
    found = read(history)
    level = Damped(FORECASTERS[name](MEMORY_S))(found).level
    seen = [one.value for one in found]
    assert min(seen) * (1 - 1e-12) <= level <= max(seen) * (1 + 1e-12)


@pytest.mark.parametrize("name", FORECASTERS)
@given(value=values, number=st.integers(1, 40))
def test_what_is_constant_is_forecast_to_stay(name: str, value: float, number: int) -> None:
    forecast = Damped(FORECASTERS[name](MEMORY_S))(samples(*[value] * number))
    assert forecast.mean(600) == pytest.approx(value)


@pytest.mark.parametrize("name", FORECASTERS)
@given(history=histories, horizon_s=st.integers(0, 3000))
def test_no_forecast_is_negative_or_further_off_than_the_observations_range(
    name: str, history: list[tuple[float, float, float]], horizon_s: int
) -> None:
    found = read(history)
    seen = [one.value for one in found]
    slack = 1e-6 * (1 + max(seen))
    mean = FORECASTERS[name](MEMORY_S)(found).mean(horizon_s)
    assert max(0, 2 * min(seen) - max(seen)) - slack <= mean <= 2 * max(seen) - min(seen) + slack


@given(
    level=st.floats(0, 1e6),
    slope=st.floats(-1e4, 1e4),
    reach_s=st.floats(1, 1000),
    span=st.floats(0, 1e5),
    horizon_s=st.integers(1, 500),
)
def test_the_mean_is_that_of_the_forecast_at_each_second(
    level: float, slope: float, reach_s: float, span: float, horizon_s: int
) -> None:
    forecast = Forecast(level, 0.0, slope, reach_s, max(0.0, level - span), level + span)
    by_hand = sum(forecast.value(t) for t in range(1, horizon_s + 1)) / horizon_s
    assert forecast.mean(horizon_s) == pytest.approx(by_hand, rel=1e-6, abs=1e-3)


def test_a_forecast_over_no_time_is_the_level() -> None:
    assert Forecast(7.0, 0.0, slope=3.0, reach_s=10).mean(0) == 7.0


def test_what_is_a_memory_old_counts_half_as_much() -> None:
    old, new = CostSample(0, 1, 0.0, 1.0), CostSample(60, 61, 300.0, 1.0)
    assert Average(MEMORY_S)([old, new]).level == pytest.approx(200.0)


def test_the_latest_forgets_everything_else() -> None:
    assert Latest()(samples(1, 2, 9)).level == 9


@pytest.mark.parametrize("forecaster", [Trend(MEMORY_S), Holt(MEMORY_S)])
def test_a_drift_is_forecast_to_go_on(forecaster: Trend | Holt) -> None:
    drift = [10_000 + 50 * 5 * n for n in range(40)]
    forecast = forecaster(samples(*drift))
    assert forecast.slope == pytest.approx(50, rel=0.2)
    assert forecast.level == pytest.approx(drift[-1], rel=0.1)
    assert forecast.mean(60) > forecast.level


def test_an_average_lags_behind_a_drift_and_a_trend_does_not() -> None:
    drift = samples(*[10_000 + 250 * n for n in range(40)])
    assert Average(MEMORY_S)(drift).level < 0.9 * drift[-1].value
    assert Trend(MEMORY_S)(drift).level == pytest.approx(drift[-1].value, rel=0.02)


def test_noise_is_not_taken_for_a_trend() -> None:
    dice = random.Random(3)
    believed = [Trend(MEMORY_S)(samples(*[dice.gauss(100, 20) for _ in range(60)])).slope for _ in range(50)]
    assert sum(slope == 0 for slope in believed) >= 40


def test_an_outlier_is_drawn_in() -> None:
    quiet = [100.0, 102, 99, 101, 100, 98, 101, 100]
    assert Average(MEMORY_S)(samples(*quiet, 10_000)).level > 1000
    assert Damped(Average(MEMORY_S))(samples(*quiet, 10_000)).level == pytest.approx(100, abs=5)


def test_a_change_that_lasts_is_no_outlier() -> None:
    assert [one.value for one in damped(samples(*[100] * 20, *[900] * 5), 9)][-1] == 900


def test_looks_within_one_grain_are_one_sample() -> None:
    history = History(5.0, 3)
    for second in range(12):
        history.add(second, second + 1, float(second), 1.0)
    assert [(one.since, one.until, one.value) for one in history.samples] == [(0, 5, 2.0), (5, 10, 7.0), (10, 12, 10.5)]


def test_a_history_keeps_the_newest() -> None:
    history = History(0.0, 3)
    for number in range(5):
        history.add(number, number + 1, float(number), 1.0)
    assert [one.value for one in history.samples] == [2, 3, 4]
