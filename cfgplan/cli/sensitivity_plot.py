"""The least cost over the horizon, or over an upkeep, as a picture with its break points."""

from __future__ import annotations

import io
from fractions import Fraction

from cfgplan.cli.sensitivity_text import headline, value_text
from cfgplan.errors import InputError
from cfgplan.explaining import Sensitivity, Span


def picture(found: Sensitivity, kind: str) -> bytes:
    """The bytes of an image of this kind (svg, png or pdf)."""
    try:
        import matplotlib
    except ImportError:
        mend = "pip install 'cfgplan[plots]'"
        raise InputError.of("a picture of the sensitivity needs matplotlib", mend=mend) from None
    from matplotlib.figure import Figure

    in_seconds = 1 if found.transformation is None else 1_000_000
    right = _right_edge(found)
    with matplotlib.rc_context({"svg.hashsalt": "cfgplan", "text.parse_math": False}):
        figure = Figure(figsize=(8, 4.5), layout="constrained")
        axes = figure.subplots()
        for span in found.spans:
            ends = [span.begin, right if span.end is None else min(span.end, right)]
            costs = [(span.line.fixed_us + span.line.each_us * end) / 1_000_000 for end in ends]
            axes.plot(
                [float(e / in_seconds) for e in ends], [float(c) for c in costs], label=_label(found, span), linewidth=2
            )
            if span.begin:
                axes.plot([float(span.begin / in_seconds)], [float(costs[0])], "ko", markersize=5)
                place = (float(span.begin / in_seconds), float(costs[0]))
                text = value_text(span.begin, found)
                axes.annotate(text, place, xytext=(6, -12), textcoords="offset points", fontsize=9)
        if found.value <= right:
            axes.axvline(found.value / in_seconds, color="grey", linestyle=":", label="now")
        axes.set_xlabel("horizon (s)" if found.transformation is None else f"upkeep of {found.transformation} (s/s)")
        axes.set_ylabel("least cost (CPU seconds)")
        axes.set_xlim(left=0, right=float(right / in_seconds))
        axes.set_ylim(bottom=0)
        axes.set_title(headline(found), fontsize=10)
        axes.legend(fontsize=9)
        image = io.BytesIO()
        figure.savefig(image, format=kind, metadata={"Date": None} if kind == "svg" else None)
    return image.getvalue()


def _right_edge(found: Sensitivity) -> Fraction:
    """The last break point has room; the present value is shown if that leaves the break points to be seen."""
    if not found.breaks:
        return max(Fraction(found.value), Fraction(1)) * 2
    return max(found.breaks[-1] * 2, min(Fraction(found.value) * Fraction(5, 4), found.breaks[-1] * 4))


def _label(found: Sensitivity, span: Span) -> str:
    """What tells a plan from the others: what it runs, and not all of them do."""
    everywhere = set(found.spans[0].runs).intersection(*(other.runs for other in found.spans))
    own = [label for label in span.runs if label not in everywhere]
    more = f" and {len(own) - 3} more" if len(own) > 3 else ""
    text = ", ".join(own[:3]) + more if own else "the same in all plans"
    return f" {text}" if text.startswith("_") else text  # a label that begins with _ is left out of a legend
