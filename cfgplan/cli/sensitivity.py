"""`cfgplan sensitivity`: the optimal plan of each horizon, or of each upkeep of a transformation."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from fractions import Fraction
from functools import partial
from typing import TYPE_CHECKING

from cfgplan.canonical import normal
from cfgplan.cli import options as shared
from cfgplan.cli.exits import Exit
from cfgplan.cli.plan_text import cpu, left_out_lines
from cfgplan.cli.screen import Screen
from cfgplan.cli.styled import Text
from cfgplan.explaining import Sensitivity, Span
from cfgplan.explaining.sensitivity import PERCENT_US, core_text, value_text
from cfgplan.summary import some

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def add_to(parser: argparse.ArgumentParser) -> None:
    parser.epilog = (
        "example:\n"
        "  cfgplan sensitivity models/building/office.yaml\n"
        "  cfgplan sensitivity models/building/office.yaml --upkeep-of air_flow_meter --out upkeep.svg"
    )
    shared.add_environment(parser)
    parser.add_argument(
        "--upkeep-of", type=normal, metavar="T", help="vary the upkeep of transformation T (default: vary the horizon)"
    )
    picture = "draw the least cost and where the optimal plan changes, as .svg, .png or .pdf (needs the extra `plots`)"
    parser.add_argument("--out", type=shared.plot_file, metavar="FILE", help=picture)
    shared.add_planning(parser)
    shared.add_matching(parser)
    shared.add_json(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace, screen: Screen) -> Exit:
    from cfgplan import answers

    task = shared.task(options, screen)
    with task.planned(screen):
        found = answers.sensitivity(task.problem, upkeep_of=options.upkeep_of, **task.planning)
    if screen.json:
        here = None if found.here is None else found.spans.index(found.here)
        screen.show_json({**vars(found), "breaks": found.breaks, "here": here})
    else:
        screen.show(sensitivity_text(found))
        if task.problem.max_cost_us is not None:
            screen.note("The largest cost is ignored: it can forbid plans, but makes none cheaper.")
        for line in left_out_lines(task.world.environment):
            screen.note(line)
    if not found.spans:
        return Exit.NO_PLAN if found.exact else Exit.NO_ANSWER
    if options.out:
        shared.write_plot(options.out, (8, 4.5), partial(_draw, found), screen)
    return Exit.OK if found.exact else Exit.NOT_PROVEN


def sensitivity_text(found: Sensitivity) -> Text:
    """The whole report; ends without a newline."""
    return Text("\n").join(_lines(found))


def headline(found: Sensitivity) -> str:
    """Where the plan for the present value stays optimal."""
    if found.here is None:
        return f"The present value is above {value_text(Fraction(found.last), found)}: costs are no longer exact there."
    value = value_text(Fraction(found.value), found)
    best = "optimal" if found.exact else "the best that was found"
    return f"The plan {_given(found)} of {value} is {best} {_reach(found, found.here)}."


def _lines(found: Sensitivity) -> Iterator[Text]:
    if not found.spans:
        proven = "" if found.exact else ", as far as is known"
        yield Text(f"There is no plan for any value of {found.parameter}{proven}.", style="bold red")
        return
    here = found.here
    yield Text(headline(found), style="bold")
    for place, span in enumerate(found.spans):
        mark = "  <- here" if span is here else ""
        yield Text(f"  {_reach(found, span)}: {_cost(found, span)}{mark}", style="bold" if mark else "")
        yield from _difference(found.spans[place - 1] if place else None, span)
    if found.spans[-1].end is not None:
        yield Text(f"Beyond {value_text(Fraction(found.last), found)} costs can't be computed exactly.", style="dim")
    if not found.exact:
        yield Text(
            "Not all plans were proven optimal: there may be cheaper ones and other break points.", style="yellow"
        )


def _given(found: Sensitivity) -> str:
    return "for a horizon" if found.transformation is None else f"for {found.transformation} with an upkeep"


def _reach(found: Sensitivity, span: Span) -> str:
    begin = value_text(span.begin, found)
    if span.end is None:
        return f"from {begin} on" if span.begin else f"for every value of {found.parameter}"
    return f"from {begin} to {value_text(span.end, found)}"


def _cost(found: Sensitivity, span: Span) -> str:
    if found.transformation is None:
        return f"{cpu(span.line.fixed_us)} once and {core_text(Fraction(span.line.each_us))}"
    if not span.line.each_us:
        return f"{cpu(span.line.fixed_us)}, without {found.transformation}"
    return f"{cpu(span.line.fixed_us)} and {span.line.each_us} s times its upkeep"


def _difference(before: Span | None, span: Span) -> Iterator[Text]:
    if before is None:
        yield Text(f"    {', '.join(span.runs) or 'nothing runs'}")
        return
    for sign, labels, style in (
        ("+", set(span.runs) - set(before.runs), "green"),
        ("-", set(before.runs) - set(span.runs), "red"),
    ):
        if labels:
            yield Text(f"    {sign} {', '.join(sorted(labels))}", style=style)


def _draw(found: Sensitivity, axes: Axes) -> None:
    in_units = 1 if found.transformation is None else PERCENT_US
    right = _right_edge(found)
    for span in found.spans:
        ends = [span.begin, right if span.end is None else min(span.end, right)]
        costs = [(span.line.fixed_us + span.line.each_us * end) / 1_000_000 for end in ends]
        axes.plot(
            [float(e / in_units) for e in ends], [float(c) for c in costs], label=_label(found, span), linewidth=2
        )
        if span.begin:
            axes.plot([float(span.begin / in_units)], [float(costs[0])], "ko", markersize=5)
            place = (float(span.begin / in_units), float(costs[0]))
            text = value_text(span.begin, found)
            axes.annotate(text, place, xytext=(6, -12), textcoords="offset points", fontsize=9)
    _mark_here(found, axes, right / in_units, Fraction(found.value) / in_units)
    upkeep = f"upkeep of {found.transformation} (% of a core)"
    axes.set_xlabel("horizon (s)" if found.transformation is None else upkeep)
    axes.set_ylabel("least cost (CPU seconds)")
    axes.set_xlim(left=0, right=float(right / in_units))
    axes.set_ylim(bottom=0)
    axes.set_title(headline(found), fontsize=10)
    axes.legend(fontsize=9, loc="lower right")


def _mark_here(found: Sensitivity, axes: Axes, right: Fraction, value: Fraction) -> None:
    """Where the present value is: a line, or an arrow at the edge beyond which it is."""
    text = f"you are here: {value_text(Fraction(found.value), found)}"
    if value > right:
        text = f"{text} →"
    else:
        axes.axvline(float(value), color="#57606a", linestyle=":")
    is_left = value * 2 < right
    axes.annotate(
        text,
        (float(min(value, right)), 0.5),
        xycoords=("data", "axes fraction"),
        xytext=(5 if is_left else -5, 0),
        textcoords="offset points",
        ha="left" if is_left else "right",
        color="#57606a",
        fontsize=9,
    )


def _right_edge(found: Sensitivity) -> Fraction:
    """Return the right edge: beyond the last break point, and beyond the present value if breaks stay visible."""
    if not found.breaks:
        return max(Fraction(found.value), Fraction(1)) * 2
    return max(found.breaks[-1] * 2, min(Fraction(found.value) * Fraction(5, 4), found.breaks[-1] * 4))


def _label(found: Sensitivity, span: Span) -> str:
    """Return the label of a plan: the transformations that it runs but not every plan of the series."""
    everywhere = set(found.spans[0].runs).intersection(*(other.runs for other in found.spans))
    own = [label for label in span.runs if label not in everywhere]
    text = some(own, 3) or "what all plans run, no more"
    return f" {text}" if text.startswith("_") else text  # a label that begins with _ is left out of a legend
