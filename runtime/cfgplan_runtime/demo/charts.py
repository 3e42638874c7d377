"""The page's charts as SVG: the field from above, the error over time, and the moments around a failure.

Colours are CSS classes of the page, so that charts follow its light and dark looks.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from html import escape
from itertools import pairwise

from cfgplan_runtime.demo.listening import Sample
from cfgplan_runtime.demo.played import FRAME_NS, Played

_NS = 1e9
_PX_PER_M = 100
_FIELD_M = (9.0, 6.0)
_CARPET_M = (10.4, 7.4)
_AREAS_M = ((0.6, 2.2), (1.65, 4.0))
_AROUND_S = 0.7


@dataclass(frozen=True, slots=True)
class Place:
    """Where a robot stands and looks at the end."""

    name: str
    x: float
    y: float
    heading: float


def by_source(played: Sequence[Played]) -> dict[str, list[Sample]]:
    """All positions, by the transformation that they came from."""
    found: dict[str, list[Sample]] = {}
    source = ""
    for step in played:
        found.setdefault(source, []).extend(s for s in step.samples if s.time_ns < step.updated_ns)
        source = step.source or ""
        found.setdefault(source, []).extend(step.settled)
    return {name: samples for name, samples in found.items() if samples and name}


def field_map(played: Sequence[Played], robots: Iterable[Place]) -> str:
    """The field from above with the ball's true way and the positions that came."""
    sources = by_source(played)
    half = (_CARPET_M[0] / 2, _CARPET_M[1] / 2)
    parts = [_rectangle("carpet", -half[0], -half[1], *_CARPET_M, radius=14)]
    left, low = -_FIELD_M[0] / 2, -_FIELD_M[1] / 2
    parts += [
        _rectangle("line", left, low, *_FIELD_M),
        _path("line", [(0, low), (0, -low)]),
        _circle("line", 0, 0, 0.75),
    ]
    for depth, width in _AREAS_M:
        parts += [
            _rectangle("line", left, -width / 2, depth, width),
            _rectangle("line", -left - depth, -width / 2, depth, width),
        ]
    robots = list(robots)
    parts += [_view(robot) for robot in robots]
    every = sorted((s for samples in sources.values() for s in samples), key=lambda s: s.time_ns)
    parts.append(_path("truth", [(s.true_x, s.true_y) for s in every]))
    for number, samples in enumerate(sources.values()):
        dots = "".join(f'<circle cx="{s.x * _PX_PER_M:.1f}" cy="{-s.y * _PX_PER_M:.1f}" r="3.2"/>' for s in samples)
        parts.append(f'<g class="dots source{number}">{dots}</g>')
    for robot in robots:
        parts.append(_circle("robot", robot.x, robot.y, 0.14))
        parts.append(_text("robot-name", robot.x * _PX_PER_M, -robot.y * _PX_PER_M + 34, robot.name))
    if every:
        parts.append(_circle("ball", every[-1].true_x, every[-1].true_y, 0.09))
    box = f"{-half[0] * _PX_PER_M} {-half[1] * _PX_PER_M} {_CARPET_M[0] * _PX_PER_M} {_CARPET_M[1] * _PX_PER_M}"
    return _svg("field", box, parts, "The field from above: the ball's true way and the positions on the topic")


def _view(robot: Place) -> str:
    """The cone that a robot's camera sees."""
    reach, wide = 2.4, math.radians(30)
    ends = [
        (robot.x + reach * math.cos(robot.heading + a), robot.y + reach * math.sin(robot.heading + a))
        for a in (wide, -wide)
    ]
    return _path("view", [(robot.x, robot.y), *ends], closed=True)


def error_chart(played: Sequence[Played]) -> str:
    """How far each position was off over the whole play, and how far it expected to be."""
    width, height, left, right, top, bottom = 1000, 300, 46, 10, 34, 34
    start_ns, end_ns = played[0].began_ns, played[-1].ended_ns
    sources = by_source(played)
    most_cm = max([30.0, *(100 * s.error_m for samples in sources.values() for s in samples)])

    def at(time_ns: float, centimetres: float) -> tuple[float, float]:
        share = (time_ns - start_ns) / (end_ns - start_ns)
        return left + share * (width - left - right), height - bottom - centimetres / most_cm * (height - top - bottom)

    parts = []
    for number, step in enumerate(played):
        x, until = at(step.began_ns, 0)[0], at(step.ended_ns, 0)[0]
        parts.append(_box(f"band{number % 2}", x, until, top, height - bottom))
        parts.append(_text("step", x + 4, top - 10, str(number), anchor="start"))
    for centimetres in range(0, int(most_cm) + 1, 10):
        y = at(start_ns, centimetres)[1]
        parts.append(f'<line class="grid" x1="{left}" x2="{width - right}" y1="{y:.1f}" y2="{y:.1f}"/>')
        parts.append(_text("tick", left - 8, y + 4, f"{centimetres}", anchor="end"))
    seconds = (end_ns - start_ns) / _NS
    parts += [
        _text("tick", at(start_ns + tick * _NS, 0)[0], height - bottom + 18, f"{tick} s")
        for tick in range(0, int(seconds) + 1, 5 if seconds < 70 else 20)
    ]
    parts.append(_text("tick", left - 8, top - 10, "cm", anchor="end"))
    for number, samples in enumerate(sources.values()):
        dots = "".join(
            '<circle cx="{:.1f}" cy="{:.1f}" r="2.4"/>'.format(*at(s.time_ns, 100 * s.error_m)) for s in samples
        )
        parts.append(f'<g class="dots source{number}">{dots}</g>')
        parts += [
            _line(f"expected source{number}", run)
            for run in _runs(samples, lambda s: at(s.time_ns, 100 * s.expected_m))
        ]
    return _svg("chart", f"0 0 {width} {height}", parts, "The error of each position over time")


def failure_chart(step: Played, samples: Sequence[Sample]) -> str:
    """The ball's x around a failure: the truth, each picture's position, and what was done when."""
    width, height, left, right, top, bottom = 1000, 360, 52, 10, 92, 34
    begin_ns, end_ns = step.began_ns - _AROUND_S * _NS, step.began_ns + _AROUND_S * _NS
    near = [s for s in samples if begin_ns <= s.time_ns <= end_ns]
    values = [value for s in near for value in (s.x, s.true_x)] or [0.0]
    low, high = min(values) - 0.05, max(values) + 0.05

    def at(time_ns: float, metres: float) -> tuple[float, float]:
        share = (time_ns - begin_ns) / (end_ns - begin_ns)
        return left + share * (width - left - right), height - bottom - (metres - low) / (high - low) * (
            height - top - bottom
        )

    parts = []
    for last, first in pairwise(near):
        if first.time_ns - last.time_ns > 1.5 * FRAME_NS:
            x, until = at(last.time_ns, low)[0], at(first.time_ns, low)[0]
            parts.append(_box("gap", x, until, top, height - bottom))
    for number in range(1, 4):
        metres = low + (high - low) * number / 4
        y = at(begin_ns, metres)[1]
        parts.append(f'<line class="grid" x1="{left}" x2="{width - right}" y1="{y:.1f}" y2="{y:.1f}"/>')
        parts.append(_text("tick", left - 8, y + 4, f"{metres:.2f}", anchor="end"))
    parts.append(_text("tick", left - 8, height - bottom + 4, "x in m", anchor="end"))
    parts += [
        _text("tick", at(step.began_ns + tick * 1e8, low)[0], height - bottom + 18, f"{tick * 100:+d} ms")
        for tick in range(-6, 7, 2)
    ]
    noticed_ns = step.review.time_s * _NS
    came_ns = step.first.came_ns if step.first is not None else end_ns
    events = (
        ("killed", step.began_ns),
        ("noticed", noticed_ns),
        ("a new segmenter works", step.updated_ns),
        ("a position of a later picture is here", came_ns),
    )
    for number, (what, time_ns) in enumerate(events):
        x, y = at(time_ns, low)[0], 16 + 19 * number
        parts.append(
            f'<line class="event event{number}" x1="{x:.1f}" x2="{x:.1f}" y1="{y + 4}" y2="{height - bottom}"/>'
        )
        after = "" if time_ns == step.began_ns else f" {(time_ns - step.began_ns) / 1e6:+.0f} ms"
        parts.append(_text(f"event-name event{number}", x + 6, y, what + after, anchor="start"))
    parts.append(_line("truth", [at(s.time_ns, s.true_x) for s in near]))
    dots = "".join('<circle cx="{:.1f}" cy="{:.1f}" r="5"/>'.format(*at(s.time_ns, s.x)) for s in near)
    parts.append(f'<g class="dots source0">{dots}</g>')
    return _svg("chart", f"0 0 {width} {height}", parts, "The ball's x coordinate around the failure")


def _runs(samples: Sequence[Sample], at: Callable[[Sample], tuple[float, float]]) -> list[list[tuple[float, float]]]:
    """The samples as lines that are broken where nothing came for more than 0.3 s."""
    runs: list[list[tuple[float, float]]] = []
    last_ns = -math.inf
    for sample in samples:
        if sample.time_ns - last_ns > 0.3 * _NS:
            runs.append([])
        runs[-1].append(at(sample))
        last_ns = sample.time_ns
    return runs


def _svg(name: str, box: str, parts: Iterable[str], title: str) -> str:
    body = "".join(parts)
    return f'<svg class="{name}" viewBox="{box}" role="img" aria-label="{escape(title)}">{body}</svg>'


def _box(name: str, left: float, right: float, top: float, bottom: float) -> str:
    size = f'width="{right - left:.1f}" height="{bottom - top:.1f}"'
    return f'<rect class="{name}" x="{left:.1f}" y="{top:.1f}" {size}/>'


def _rectangle(name: str, x: float, y: float, width: float, height: float, *, radius: float = 0) -> str:
    left, top = x * _PX_PER_M, (-y - height) * _PX_PER_M
    size = f'width="{width * _PX_PER_M:.1f}" height="{height * _PX_PER_M:.1f}"'
    return f'<rect class="{name}" x="{left:.1f}" y="{top:.1f}" {size} rx="{radius}"/>'


def _circle(name: str, x: float, y: float, radius: float) -> str:
    place = f'cx="{x * _PX_PER_M:.1f}" cy="{-y * _PX_PER_M:.1f}"'
    return f'<circle class="{name}" {place} r="{radius * _PX_PER_M:.1f}"/>'


def _path(name: str, points: Sequence[tuple[float, float]], *, closed: bool = False) -> str:
    return _line(name, [(x * _PX_PER_M, -y * _PX_PER_M) for x, y in points], closed=closed)


def _line(name: str, points: Sequence[tuple[float, float]], *, closed: bool = False) -> str:
    shape = "polygon" if closed else "polyline"
    return f'<{shape} class="{name}" points="{" ".join(f"{x:.1f},{y:.1f}" for x, y in points)}"/>'


def _text(name: str, x: float, y: float, text: str, *, anchor: str = "middle") -> str:
    return f'<text class="{name}" x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{escape(text)}</text>'
