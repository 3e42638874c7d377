"""The report page's charts as SVG: the field from above, the error over time, and the seconds around a failure."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape
from io import StringIO
from itertools import pairwise
from types import MappingProxyType
from typing import Any

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle, Wedge

from nao_demo.listening import Sample
from nao_demo.played import FRAME_NS, Played

_NAMES = ("accent", "bad", "band", "gap", "ink", "rule", "soft", "source0", "source1", "truth")
CSS = MappingProxyType({name: f"#{number:06x}" for number, name in enumerate(_NAMES, 1)})
"""Placeholders for the page's CSS variables, so that charts follow its light and dark colours."""
_STYLE: Any = {
    "svg.fonttype": "none",
    "svg.hashsalt": "cfgplan",
    "font.family": "sans-serif",
    "font.size": 10,
    "axes.spines.left": False,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.edgecolor": CSS["rule"],
    "axes.labelcolor": CSS["soft"],
    "axes.axisbelow": True,
    "grid.color": CSS["rule"],
    "xtick.color": CSS["soft"],
    "ytick.color": CSS["soft"],
    "ytick.left": False,
}
_CARPET_M, _FIELD_M = (10.4, 7.4), (9.0, 6.0)
_AREAS_M = ((0.6, 2.2), (1.65, 4.0))
_ON_CARPET = ("#ffb14a", "#5fd0ff")
_AROUND_S = 0.7


@dataclass(frozen=True, slots=True)
class Place:
    """The pose of a robot at the end of the play."""

    name: str
    x: float
    y: float
    heading: float


def by_source(played: Sequence[Played]) -> dict[str, list[Sample]]:
    """Return all positions, by the transformation that they came from."""
    found: dict[str, list[Sample]] = {}
    source = ""
    for step in played:
        found.setdefault(source, []).extend(s for s in step.samples if s.time_ns < step.updated_ns)
        source = step.source or ""
        found.setdefault(source, []).extend(step.settled)
    return {name: samples for name, samples in found.items() if samples and name}


def field_map(played: Sequence[Played], robots: Iterable[Place]) -> str:
    """Draw the field from above with the ball's true path, the received positions and the robots. Returns SVG."""
    figure = Figure(figsize=(10.4, 7.4))
    axes = figure.add_axes((0, 0, 1, 1), xlim=(-5.2, 5.2), ylim=(-3.7, 3.7), aspect="equal")
    axes.set_axis_off()
    corner = (-_CARPET_M[0] / 2, -_CARPET_M[1] / 2)
    axes.add_patch(Rectangle(corner, *_CARPET_M, color="#23743c"))
    left, low = -_FIELD_M[0] / 2, -_FIELD_M[1] / 2
    lines = [Rectangle((left, low), *_FIELD_M), Circle((0, 0), 0.75), Rectangle((0, low), 0, _FIELD_M[1])]
    for depth, width in _AREAS_M:
        lines += [Rectangle((x, -width / 2), depth, width) for x in (left, -left - depth)]
    for line in lines:
        line.set(fill=False, edgecolor="white", alpha=0.7, linewidth=3.5)
        axes.add_patch(line)
    robots = list(robots)
    for robot in robots:
        degrees = math.degrees(robot.heading)
        axes.add_patch(Wedge((robot.x, robot.y), 2.6, degrees - 30, degrees + 30, color="white", alpha=0.12, lw=0))
    sources = by_source(played)
    every = sorted((s for samples in sources.values() for s in samples), key=lambda s: s.time_ns)
    axes.plot([s.true_x for s in every], [s.true_y for s in every], color="white", linewidth=3)
    for samples, color in zip(sources.values(), _ON_CARPET, strict=False):
        axes.scatter([s.x for s in samples], [s.y for s in samples], 26, color, edgecolor="#0b2e17", lw=0.4, zorder=3)
    for robot in robots:
        axes.add_patch(Circle((robot.x, robot.y), 0.14, facecolor="#f2f4f3", edgecolor="#10301c", lw=3, zorder=4))
        axes.text(robot.x, robot.y - 0.36, robot.name, color="white", ha="center", size=14, weight="bold", zorder=5)
    if every:
        ball = (every[-1].true_x, every[-1].true_y)
        axes.add_patch(Circle(ball, 0.09, facecolor="white", edgecolor="#10301c", lw=2, zorder=4))
    return _svg(figure, "field", "The field from above: the ball's true way and the positions on the topic")


def error_chart(played: Sequence[Played]) -> str:
    """Draw the true and the expected error of each position over the whole play. Returns SVG."""
    start_ns, end_s = played[0].began_ns, (played[-1].ended_ns - played[0].began_ns) / 1e9
    with rc_context(_STYLE):
        figure, axes = _chart(3.2)
        for number, step in enumerate(played):
            began_s, ended_s = ((time_ns - start_ns) / 1e9 for time_ns in (step.began_ns, step.ended_ns))
            if number % 2 == 0:
                axes.axvspan(began_s, ended_s, color=CSS["band"], lw=0)
            axes.text(
                began_s, 1.02, f" {number}", color=CSS["accent"], weight="bold", transform=axes.get_xaxis_transform()
            )
        for number, samples in enumerate(by_source(played).values()):
            color = CSS[f"source{number}"]
            times_s = [(sample.time_ns - start_ns) / 1e9 for sample in samples]
            axes.scatter(times_s, [100 * s.error_m for s in samples], 12, color, alpha=0.75, lw=0)
            silent = [math.nan if after - before > 0.3 else 0.0 for before, after in pairwise([times_s[0], *times_s])]
            expected = [100 * s.expected_m + gap for s, gap in zip(samples, silent, strict=True)]
            axes.plot(times_s, expected, color=color, linewidth=1.8)
        axes.set(xlim=(0, end_s), ylim=(0, None), xlabel="seconds", ylabel="cm")
        axes.grid(axis="y")
        return _svg(figure, "chart", "The error of each position over time")


def failure_chart(step: Played, samples: Sequence[Sample]) -> str:
    """Draw the ball's x around a failure as SVG: the truth, each picture's position, and the times of the repair."""
    came_ns = step.first.came_ns if step.first is not None else step.ended_ns
    events = (
        ("killed", step.began_ns),
        ("the review begins", round(step.review.time_s * 1e9)),
        ("a new segmenter works", step.updated_ns),
        ("a position of a later picture is here", came_ns),
    )

    until_ns = max(time_ns for _, time_ns in events)
    end_ns = max(step.began_ns + round(_AROUND_S * 1e9), until_ns + (until_ns - step.began_ns) // 8)
    near = [s for s in samples if step.began_ns - _AROUND_S * 1e9 <= s.time_ns <= end_ns]

    def at_ms(time_ns: float) -> float:
        return (time_ns - step.began_ns) / 1e6

    with rc_context(_STYLE):
        figure, axes = _chart(3.8)
        for last, first in pairwise(near):
            if first.time_ns - last.time_ns > 1.5 * FRAME_NS:
                begin_ns, over_ns = last.time_ns + FRAME_NS, first.time_ns - FRAME_NS
                axes.axvspan(at_ms(begin_ns), at_ms(over_ns), color=CSS["gap"], lw=3)
        for number, (what, time_ns) in enumerate(events):
            color = CSS["ink"] if number else CSS["bad"]
            axes.axvline(at_ms(time_ns), 0, 1.32 - 0.08 * number, color=color, lw=1, clip_on=False)
            after = f" {at_ms(time_ns):+.0f} ms" if number else ""
            is_late = at_ms(time_ns) > at_ms(end_ns) / 2
            axes.annotate(
                what + after,
                (at_ms(time_ns), 1.26 - 0.08 * number),
                xycoords=axes.get_xaxis_transform(),
                xytext=(-4 if is_late else 4, 0),
                textcoords="offset points",
                ha="right" if is_late else "left",
                color=color,
                weight="bold",
                annotation_clip=False,
            )
        axes.plot([at_ms(s.time_ns) for s in near], [s.true_x for s in near], color=CSS["truth"], linewidth=1.4)
        axes.scatter([at_ms(s.time_ns) for s in near], [s.x for s in near], 50, CSS["source0"], alpha=0.75, lw=0)
        axes.set(xlim=(-1000 * _AROUND_S, at_ms(end_ns)), xlabel="ms", ylabel="x in m")
        axes.grid(axis="y")
        return _svg(figure, "chart", "The ball's x coordinate around the failure")


def _chart(height: float) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(10.4, height), layout="constrained")
    return figure, figure.subplots()


def _svg(figure: Figure, name: str, title: str) -> str:
    """The figure for a page: scaled by it, and coloured by its CSS variables."""
    file = StringIO()
    with rc_context(_STYLE):
        figure.savefig(file, format="svg", transparent=True, metadata={"Date": None})
    text = file.getvalue()
    for variable, color in CSS.items():
        text = text.replace(color, f"var(--{variable})")
    box = re.search(r'viewBox="[^"]*"', text)
    assert box is not None
    body = re.sub(r"<metadata>.*?</metadata>", "", text[text.index(">", box.end()) + 1 :], flags=re.S)
    names = 'xmlns:xlink="http://www.w3.org/1999/xlink"'
    return f'<svg class="{name}" {box[0]} {names} role="img" aria-label="{escape(title)}">{body}'
