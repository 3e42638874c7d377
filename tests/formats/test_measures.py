"""Numbers that people write with a unit of measurement are converted to the unit of their key."""

from __future__ import annotations

from decimal import Decimal

import pytest

from cfgplan.formats.measures import MEASURES


@pytest.mark.parametrize(
    ("key", "written", "number"),
    [
        ("bandwidth", "1 Mbit/s", 125_000),
        ("bandwidth", "10 Mbps", 1_250_000),
        ("bandwidth", "10 MB/s", 10_000_000),
        ("bandwidth", "64 kbit", 8_000),
        ("bandwidth", "1 MiB/s", 1_048_576),
        ("bandwidth", "1 Gb/s", 125_000_000),
        ("bandwidth", "9600 bit/s", 1_200),
        ("energy", "5 Wh", 18_000),
        ("energy", "2.5kJ", 2_500),
        ("energy", "40000 mWh", 144_000),
        ("energy", "1 MJ", 1_000_000),
        ("memory", "2 GB", 2_000),
        ("memory", "512M", 512),
        ("memory", "1 GiB", Decimal("1073.741824")),
        ("memory", "500000 bytes", Decimal("0.5")),
        ("rate", "5Hz", 5),
        ("rate", "1.5 kHz", 1_500),
        ("rate", "500 mHz", Decimal("0.5")),
        ("rate", "2 MHz", 2_000_000),
        ("size", "5 mb", 5_000_000),
        ("size", "5 MB", 5_000_000),
    ],
)
def test_a_number_with_a_unit_is_converted(key: str, written: str, number: Decimal | int) -> None:
    assert MEASURES[key].number(written) == number


@pytest.mark.parametrize(
    ("key", "written"),
    [("memory", "200"), ("memory", "much"), ("bandwidth", "5 MB"), ("rate", "5 Hz 6"), ("size", "-1 kB")],
)
def test_any_other_text_means_no_number(key: str, written: str) -> None:
    assert MEASURES[key].number(written) is None
