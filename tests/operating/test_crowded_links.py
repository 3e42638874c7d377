"""A link that takes less than its streams need is told of, with both rates."""

from __future__ import annotations

import pytest
from cfgplan_runtime.children.messages import CrossingCounts
from cfgplan_runtime.lifecycle.link_rates import MEASURED_S
from cfgplan_runtime.operating.crowded_links import CrowdedLinks

CAMERA, POSE, BACK = ("camera.1/image", "r1", "r2"), ("pose.1/pose", "r1", "r2"), ("camera.1/image", "r2", "r1")


def counts(elements: int, crowded: int, offered: int, arrived: int) -> CrossingCounts:
    return CrossingCounts(elements, crowded, 0, crowded, offered, arrived)


def told(*steps: dict[tuple[str, str, str], CrossingCounts]) -> list[str]:
    links = CrowdedLinks()
    return [text for number, step in enumerate(steps) for text in links.warnings(step, number * MEASURED_S)]


NONE = {CAMERA: CrossingCounts(), POSE: CrossingCounts(), BACK: CrossingCounts()}
FULL = {
    CAMERA: counts(20, 8, 50_000_000, 30_000_000),
    POSE: counts(250, 0, 25_000, 25_000),
    BACK: counts(20, 0, 50_000_000, 50_000_000),
}


def test_a_crowded_link_is_told_of_once_with_what_its_streams_need_and_what_it_gives() -> None:
    (said,) = told(NONE, FULL, {one: count + FULL[one] for one, count in FULL.items()})
    assert said == (
        "the link from r1 to r2 takes less than its streams need: they need 80 Mbit/s, it gives 48 Mbit/s; in 5 s it "
        "had no room for 8 of 20 of camera.1/image"
    )


def test_a_link_that_was_free_in_between_is_told_of_again() -> None:
    again = {one: count + FULL[one] for one, count in FULL.items()}
    assert len(told(NONE, FULL, FULL, again)) == 2


@pytest.mark.parametrize(
    "full",
    [
        {CAMERA: counts(20, 0, 50_000_000, 50_000_000)},
        {CAMERA: CrossingCounts(20, 8, 0, 0, 50_000_000, 30_000_000)},
        {CAMERA: counts(20, 8, 50_000_000, 0)},
        {("", "r1", "r2"): counts(20, 8, 50_000_000, 30_000_000)},
    ],
    ids=["all arrives", "the receiver has no room", "a cut", "units that are gone"],
)
def test_no_other_link_is_told_of(full: dict[tuple[str, str, str], CrossingCounts]) -> None:
    assert told({}, full) == []


def test_rates_below_ten_have_two_digits() -> None:
    (said,) = told({}, {CAMERA: counts(20, 8, 5_000_000, 343_750)})
    assert "they need 8 Mbit/s, it gives 0.55 Mbit/s" in said
