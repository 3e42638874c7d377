"""Sensitivity as text: where the plan stays optimal, and every span with its cost."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction

from rich.text import Text

from cfgplan.cli.update_text import cpu
from cfgplan.explaining import Sensitivity, Span


def sensitivity_text(found: Sensitivity) -> Text:
    """The whole report; ends without a newline."""
    return Text("\n").join(_lines(found))


def value_text(value: Fraction, found: Sensitivity) -> str:
    """A value of the parameter for people: `12.5 s`, or `0.08 s/s` of upkeep; rounded if it is no short decimal."""
    if found.transformation is None:
        return f"{_decimal(value)} s"
    return f"{_decimal(value / 1_000_000)} s/s"


def what_varies(found: Sensitivity) -> str:
    return "the horizon" if found.transformation is None else f"the upkeep of {found.transformation}"


def headline(found: Sensitivity) -> str:
    """Where the plan for the present value stays optimal."""
    if found.here is None:
        return f"The present value is beyond {value_text(Fraction(found.last), found)}, where costs end to be exact."
    value = value_text(Fraction(found.value), found)
    best = "optimal" if found.exact else "the best that was found"
    return f"The plan {_given(found)} of {value} is {best} {_reach(found, found.here)}."


def _lines(found: Sensitivity) -> Iterator[Text]:
    if not found.spans:
        proven = "" if found.exact else ", as far as is known"
        yield Text(f"There is no plan for any value of {what_varies(found)}{proven}.", style="bold red")
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
        return f"from {begin} on" if span.begin else f"whatever {what_varies(found)} is"
    return f"from {begin} to {value_text(span.end, found)}"


def _cost(found: Sensitivity, span: Span) -> str:
    if found.transformation is None:
        return f"{cpu(span.line.fixed_us)} once and {cpu(span.line.each_us)}/s"
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


def _decimal(value: Fraction) -> str:
    rounded = round(value, 6)
    text = f"{float(rounded):.6f}".rstrip("0").rstrip(".")
    return text if rounded == value else f"about {text}"
