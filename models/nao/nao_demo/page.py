"""The report page of a play: one HTML file that loads no other file."""

from __future__ import annotations

import re
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from football import scenario
from jinja2 import Environment as Templates
from jinja2 import FileSystemLoader, select_autoescape
from markupsafe import Markup

from cfgplan.domain import ChangeSet, Environment
from cfgplan.drawing import picture
from nao_demo import charts, telling
from nao_demo.played import Played
from nao_demo.rehearsing import Comparison, Robot, compare, view
from nao_demo.story import Kill

_COMPARED_NS = 600_000_000_000
_MOMENTS = 100


@dataclass(frozen=True, slots=True)
class Bar:
    """A bar with the cost of a plan; `share` is its length in percent of the largest cost on the page."""

    what: str
    cost: str
    share: float
    more: str = ""
    """How much more it costs than what was done; empty for that."""

    @property
    def is_chosen(self) -> bool:
        return not self.more


def page(played: Sequence[Played], version: str) -> str:
    """Return the report of a play as HTML."""
    templates = Templates(
        loader=FileSystemLoader(Path(__file__).parent),
        autoescape=select_autoescape(),
        trim_blocks=True,
        lstrip_blocks=True,
    )
    failure = next((step for step in played if isinstance(step.step.act, Kill)), None)
    samples = [sample for step in played for sample in step.samples]
    hosts = sorted({t.host for t in played[-1].after.library if t.host is not None})
    robots = [Robot(host) for host in hosts]
    comparison = _comparison(robots, played)
    values: dict[str, Any] = {
        "version": version,
        "date": time.strftime("%d %B %Y, %H:%M", time.localtime(played[0].began_ns / 1e9)),
        "seconds": round((played[-1].ended_ns - played[0].began_ns) / 1e9),
        "sources": list(charts.by_source(played)),
        "field": Markup(charts.field_map(played, [_stands(robot, played) for robot in robots])),
        "errors": Markup(charts.error_chart(played)),
        "failure": None if failure is None else Markup(charts.failure_chart(failure, samples)),
        "figures": _figures(played, failure, comparison),
        "comparison": comparison,
        "is_proven": _is_proven(played),
        "steps": [_section(number, step, played) for number, step in enumerate(played)],
        "units": _units(played),
        "views": [view(robot, samples[-1].time_ns) for robot in robots] if samples else [],
    }
    return templates.get_template("report.html.j2").render(values)


def _stands(robot: Robot, played: Sequence[Played]) -> charts.Place:
    """Where a robot stood at the end."""
    pose = scenario.pose(robot.name, played[-1].ended_ns)
    return charts.Place(robot.name, pose.x, pose.y, pose.heading)


def _comparison(robots: Sequence[Robot], played: Sequence[Played]) -> Comparison | None:
    """Robots and fusion at the same moments, spread over ten minutes: a play is too short to compare its steps."""
    if len(robots) != 2:
        return None
    begin_ns = played[0].began_ns
    return compare(robots, range(begin_ns, begin_ns + _COMPARED_NS, _COMPARED_NS // _MOMENTS))


def _figures(played: Sequence[Played], failure: Played | None, comparison: Comparison | None) -> list[tuple[str, str]]:
    """Return the figures at the top of the page, each with its caption."""
    figures = []
    if failure is not None:
        figures.append(
            (telling.span((failure.updated_ns - failure.began_ns) / 1e9), "from kill -9 to a repaired pipeline")
        )
        lost = telling.lost_frames(failure)
        figures.append((str(lost), "frame without a position" if lost == 1 else "frames without a position"))
    if comparison is not None:
        robot, alone_m = min(comparison.alone_m.items(), key=lambda item: item[1])
        figures.append((f"{100 * alone_m:.1f} cm", f"off with {robot.capitalize()} alone (RMS over ten minutes)"))
        figures.append((f"{100 * comparison.fused_m:.1f} cm", "off with both fused, at the same moments"))
    slowest = max(step.review.seconds.get("plan", 0.0) for step in played)
    proven = ", proven cheapest" if _is_proven(played) else ""
    figures.append((telling.span(slowest), f"for the slowest plan{proven}"))
    return figures


def _is_proven(played: Sequence[Played]) -> bool:
    return all(step.review.is_proven for step in played if step.review.met)


def _section(number: int, played: Played, every: Sequence[Played]) -> dict[str, Any]:
    largest_us = max(
        [1, *(step.review.cost_us or 0 for step in every), *(o.cost_us for step in every for o in step.others)]
    )
    chosen_us = played.review.cost_us or 0
    bars = [Bar("what was done", telling.cpu(chosen_us), 100 * chosen_us / largest_us)]
    for other in played.others:
        more = telling.cpu(other.cost_us - chosen_us)
        bars.append(Bar(other.what, telling.cpu(other.cost_us), 100 * other.cost_us / largest_us, more))
    before, after = _graphs(played)
    times = telling.times(played)
    return {
        "number": number,
        "title": played.step.title,
        "section": played.step.section,
        "happens": played.step.happens,
        "noticed": telling.noticed(played),
        "decided": telling.decided(played),
        "cost": telling.cost(played),
        "seen": telling.seen(played),
        "bars": bars,
        "times": [(word, telling.span(took), took) for word, took in times],
        "total": telling.span(sum(took for _, took in times)),
        "before": Markup(before) if before else None,
        "after": Markup(after),
        "is_changed": bool(played.changes),
    }


def _graphs(played: Played) -> tuple[str | None, str]:
    """Return pictures of the previous configuration with its dead units (None if it was empty), and of the update."""
    before = _svg(played.before, ChangeSet(stopped=played.gone)) if played.before.units else None
    return before, _svg(played.left, played.changes)


def _svg(environment: Environment, changes: ChangeSet) -> str:
    """The drawing without what only a file needs, and without ids, which several drawings would share."""
    text = picture(environment, changes).render("svg").decode()
    text = text[text.index("<svg") :]
    text = re.sub(r"<text[^>]*>(?:[^<]*■[^<]*|\s*)</text>\n?", "", text)
    text = re.sub(r"<!--.*?-->\n?|<title>.*?</title>\n?| id=\"[^\"]*\"", "", text, flags=re.S)
    return re.sub(r'<svg width="(\d+)pt" height="\d+pt"', r'<svg class="wiring" style="max-width:\1pt"', text, count=1)


def _units(played: Sequence[Played]) -> list[dict[str, str]]:
    """Return a table row for each unit of the last step: its declared and its measured cost."""
    last = played[-1]
    library = last.after.transformation
    rows = []
    for seen in last.observed:
        declared = library[seen.transformation]
        rows.append(
            {
                "unit": seen.unit,
                "labor": f"{declared.labor_us / 1e6:.2f} s",
                "labor_seen": f"{seen.labor_us / 1e6:.3f} s",
                "upkeep": f"{declared.upkeep_us / 1e6:.2f}",
                "upkeep_seen": "" if seen.upkeep_us is None else f"{seen.upkeep_us / 1e6:.3f}",
                "memory": f"{seen.memory_bytes >> 20} MB",
                "steps": f"{seen.steps:,}",
                "dropped": f"{seen.dropped:,}",
            }
        )
    return rows
