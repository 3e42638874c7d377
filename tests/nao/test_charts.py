"""The chart of the failure: nothing is drawn beside the axes, and what is missing begins with the first lost image."""

from __future__ import annotations

import re

import pytest
from cfgplan_runtime.lifecycle.reports import Decision, Review
from nao_demo.listening import Sample
from nao_demo.played import FRAME_NS, Played
from nao_demo.story import SECTION_V

from cfgplan.domain import Environment

BEGAN_NS = 1_700_000_000_000_000_000


def sample(frame: int, came_ms: int = 0) -> Sample:
    """The position of an image, counted from the one at the kill."""
    time_ns = BEGAN_NS + round(frame * FRAME_NS)
    return Sample(time_ns, time_ns + came_ms * 1_000_000, -2.0, 0.0, -2.0 + frame / 100, 0.0, 0.1)


def chart(repaired_s: float) -> str:
    from nao_demo.charts import failure_chart  # matplotlib

    frames = [*range(-10, 0), *range(6, 40)]
    samples = [sample(frame) for frame in frames]
    review = Review(2, 0.0, BEGAN_NS / 1e9 + 0.05, (), Decision.APPLIED, 60, 0, seconds={"apply": repaired_s})
    played = Played(
        SECTION_V[2], BEGAN_NS, BEGAN_NS + 2_000_000_000, Environment(), Environment(), review, first=sample(39, 20)
    )
    return failure_chart(played, samples)


def told(svg: str) -> dict[str, float]:
    """Where each text stands, from the left."""
    return {text: float(x) for x, text in re.findall(r'<text [^>]*?x="(-?[\d.]+)"[^>]*>([^<]+)</text>', svg)}


@pytest.mark.parametrize("repaired_s", [0.05, 1.6])
def test_what_was_done_is_told_within_the_axes_however_long_it_took(repaired_s: float) -> None:
    svg = chart(repaired_s)
    (width,) = re.findall(r'viewBox="0 0 ([\d.]+)', svg)
    places = told(svg)
    works = f"a new segmenter works +{50 + 1000 * repaired_s:.0f} ms"
    assert places["killed"] < places["the review begins +50 ms"] < places[works] < float(width)
    late = re.findall(r"text-anchor: (\w+)[^>]*>a position of a later picture is here \+2620 ms<", svg)
    assert late == ["end"], "its text is left of its line, which is near the edge"
    assert max(float(x) for x in re.findall(r'd="M (\d[\d.]*) ', svg)) < float(width)


def test_what_is_missing_begins_with_the_first_lost_image() -> None:
    svg = chart(0.05)
    (left,) = re.findall(r'd="M ([\d.]+) [^"]*?" clip-path="[^"]*" style="fill: var\(--gap\)', svg)
    (kill,) = re.findall(r'd="M ([\d.]+) [^"]*?"[^>]*style="fill: none; stroke: var\(--bad\)', svg)
    assert float(left) == pytest.approx(float(kill), abs=0.5)
