"""Figures as people say them."""

from __future__ import annotations

import pytest

from cfgplan.amounts import clock_time, core_share, exact_clock_time, rate, span


@pytest.mark.parametrize(
    ("seconds", "said"),
    [
        (0, "0 s"),
        (0.000828, "0.83 ms"),
        (0.0008, "0.8 ms"),
        (0.0124, "12 ms"),
        (0.9994, "999 ms"),
        (0.9996, "1 s"),
        (4.24, "4.2 s"),
        (9.96, "10 s"),
        (45, "45 s"),
        (180, "3 min"),
        (7500, "2 h 5 min"),
        (7200, "2 h"),
        (273600, "3 d 4 h"),
        (-0.002, "-2 ms"),
    ],
)
def test_times(seconds: float, said: str) -> None:
    assert span(seconds) == said


@pytest.mark.parametrize(
    ("hertz", "said"),
    [
        (0, "never"),
        (100.2, "100 Hz"),
        (2.5, "2.5 Hz"),
        (0.98, "0.98 Hz"),
        (0.125, "every 8 s"),
        (1 / 600, "every 10 min"),
    ],
)
def test_rates(hertz: float, said: str) -> None:
    assert rate(hertz) == said


@pytest.mark.parametrize(
    ("cpu_us_per_s", "said"),
    [
        (0, "0 % of a core"),
        (50_000, "5 % of a core"),
        (764, "0.0764 % of a core"),
        (123_456, "12.3 % of a core"),
        (1_500_000, "150 % of a core"),
        (2_350_000, "2.35 cores"),
        (1, "0.0001 % of a core"),
    ],
)
def test_shares_of_a_core(cpu_us_per_s: float, said: str) -> None:
    assert core_share(cpu_us_per_s) == said


def test_hours_are_local(monkeypatch: pytest.MonkeyPatch) -> None:
    import time

    monkeypatch.setenv("TZ", "UTC-2")
    time.tzset()
    try:
        assert (clock_time(3600.5), exact_clock_time(3600_042_000_000)) == ("03:00:00", "03:00:00.042")
    finally:
        monkeypatch.undo()
        time.tzset()
