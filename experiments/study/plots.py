"""Plots of results with matplotlib (extra `plots`): scaling, gaps, performance profiles, anytime curves."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from pathlib import Path
from statistics import median
from textwrap import fill
from typing import TYPE_CHECKING, NamedTuple

from cfgplan.comparing import RunFailure
from cfgplan.onward import grouped
from experiments.study.invariants import by_instance, gap, references
from experiments.study.rows import SHORTEST_PROOF_S, Row, planners

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = ("#0072b2", "#d55e00", "#e69f00", "#999999", "#009e73", "#56b4e9", "#cc79a7", "#000000", "#8c564b", "#bcbd22")
"""Okabe and Ito's palette first: distinct for colour-blind eyes."""
MARKERS = "os^vDPX*<>p"
LINES = ((), (1, 1), (5, 2), (6, 2, 1, 2), (2, 2), (9, 2), (4, 1, 1, 1))
"""Dashes, so that curves that coincide can be told apart. There are fewer than colours, and the two numbers have no
divisor in common: as many planners as both together have different curves.
"""
LEAST_GAP = 1e-3
_BEYOND = 1.5
"""A logarithmic axis ends at this multiple of the largest value, so that the last steps and their levels are seen."""


def write_plots(rows: Sequence[Row], folder: Path) -> list[Path]:
    """Write every plot that the rows have data for, as PNG; returns the files. Raises ImportError.

    Rows that the judge refused are left out.
    """
    import matplotlib

    matplotlib.use("Agg")
    rows = [row for row in rows if not row.violations]
    families = dict.fromkeys(row.family for row in rows)
    figures = {
        **{f"scaling-{name}": scaling([row for row in rows if row.family == name], rows) for name in families},
        "gaps": gap_profile(rows),
        "performance": performance_profile(rows),
        "anytime": anytime(rows),
        "bounds": bounds(rows),
    }
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for name, figure in figures.items():
        if figure is not None:
            path = folder / f"{name}.png"
            figure.savefig(path, dpi=110, metadata={"Software": None})
            written.append(path)
    return written


def scaling(rows: Sequence[Row], everyone: Sequence[Row]) -> Figure | None:
    """Plot time to proof against every parameter that is varied by itself; unproven runs are hollow marks at their end.

    The styles of the planners are those in the rows of `everyone`.
    """
    from matplotlib.ticker import MaxNLocator

    panels = _series(rows)
    if not panels:
        return None
    figure, axes = _grid(len(panels), 3)
    for axis, ((title, name), points) in zip(axes, sorted(panels.items()), strict=False):
        for planner, style in styles(everyone).items():
            xs = sorted({x for x, row in points if row.planner == planner})
            at = {x: [row for value, row in points if (value, row.planner) == (x, planner)] for x in xs}
            times = {
                x: median(max(SHORTEST_PROOF_S, row.proof_s or row.total_s or row.time_limit_s) for row in at[x])
                for x in xs
            }
            axis.plot(xs, [times[x] for x in xs], color=style.color, linestyle=style.line, linewidth=1)
            for proven in (True, False):
                some = [x for x in xs if all(row.proven for row in at[x]) == proven]
                face = style.color if proven else "white"
                axis.scatter(
                    some,
                    [times[x] for x in some],
                    s=22,
                    marker=style.marker,
                    color=style.color,
                    facecolor=face,
                    zorder=3,
                )
        axis.set_yscale("log")
        axis.set_title(title, fontsize=9)
        axis.set_xlabel(name, fontsize=8)
        positive = [x for x, _ in points if x > 0]
        if max(positive, default=1) / min(positive, default=1) > 30:
            axis.set_xscale("log" if len(positive) == len(points) else "symlog")
            axis.set_xlim(left=min(x for x, _ in points))
        elif all(x == int(x) for x, _ in points):
            axis.xaxis.set_major_locator(MaxNLocator(integer=True))
    figure.supylabel("seconds to proof; hollow: to the end, none", fontsize=9)
    return _with_legend(figure, everyone)


def gap_profile(rows: Sequence[Row]) -> Figure | None:
    """Plot the share of instances on which each planner's plan is within a factor of the least known cost."""
    import matplotlib.pyplot as plt

    reference = references(rows)
    if not reference:
        return None
    figure, axis = plt.subplots(figsize=(7.5, 4.8), layout="constrained")
    known = ((row, g) for row in rows if (g := gap(row, reference)) is not None)
    gaps = grouped((row.planner, max(LEAST_GAP, g)) for row, g in known)
    end = _BEYOND * max(map(max, gaps.values()), default=LEAST_GAP)
    for planner, style in styles(rows).items():
        xs, tried, found = sorted(gaps[planner]), len(_tried(rows, planner)), len(gaps[planner])
        if tried:
            ys = [0, *((i + 1) / tried for i in range(found)), found / tried]
            axis.step([LEAST_GAP, *xs, end], ys, where="post", color=style.color, linestyle=style.line)
    axis.set_xscale("log")
    axis.set_xticks([0.001, 0.01, 0.1, 1, 10, 100], ["0.1 %\nor none", "1 %", "10 %", "100 %", "1,000 %", "10,000 %"])
    axis.set_xlim(LEAST_GAP, end)  # the ticks beyond it would widen the axis
    axis.set_ylim(0, 1.02)
    axis.set_xlabel("gap to the least known cost")
    axis.set_ylabel("share of the instances that it did not refuse")
    axis.grid(alpha=0.3)
    return _with_legend(figure, rows)


def performance_profile(rows: Sequence[Row]) -> Figure | None:
    """The share of instances that each planner proves within a multiple of the fastest's time (Dolan and More 2002)."""
    import matplotlib.pyplot as plt

    groups = by_instance(rows).values()
    fastest = [
        min((max(SHORTEST_PROOF_S, r.proof_s) for r in group if r.proof_s is not None), default=None)
        for group in groups
    ]
    counted = sum(best is not None for best in fastest)
    if not counted:
        return None
    figure, axis = plt.subplots(figsize=(7.5, 4.8), layout="constrained")
    ratios: dict[str, list[float]] = defaultdict(list)
    for group, best in zip(groups, fastest, strict=True):
        for row in group:
            if row.proof_s is not None and best is not None:
                ratios[row.planner].append(max(SHORTEST_PROOF_S, row.proof_s) / best)
    end = _BEYOND * max(map(max, ratios.values()))
    for planner, style in styles(rows).items():
        xs, proven = sorted(ratios[planner]), len(ratios[planner])
        if xs:
            ys = [0, *((i + 1) / counted for i in range(proven)), proven / counted]
            axis.step([1.0, *xs, end], ys, where="post", color=style.color, linestyle=style.line)
    axis.set_xscale("log")
    axis.set_xlim(1, end)
    axis.set_ylim(0, 1.02)
    axis.set_xlabel("time to proof as a multiple of the fastest planner's")
    axis.set_ylabel(f"share of {counted} instances that anyone proved")
    axis.grid(alpha=0.3)
    return _with_legend(figure, rows)


Curve = Callable[[Row, int], list[tuple[float, float]]]
"""What a row has at which second, given the least cost of its instance."""


def anytime(rows: Sequence[Row]) -> Figure | None:
    """How far each planner's best plan was from the least cost over time, on the instances that were proven last."""

    def gaps(row: Row, least_us: int) -> list[tuple[float, float]]:
        costs = [(when, cost) for when, cost, _ in row.trace if cost is not None]
        if row.has_plan and row.cost_us is not None:
            costs.append((row.best_s or 0.0, row.cost_us))
        return [(when, max(LEAST_GAP, cost / least_us - 1)) for when, cost in costs]

    figure, axes = _over_time(rows, gaps, "gap to the least known cost (0.001: at most that)")
    for axis in axes:
        axis.set_yscale("log")
        axis.set_ylim(LEAST_GAP * 0.8)
    return figure


def bounds(rows: Sequence[Row]) -> Figure | None:
    """The proven bound of each planner over time, as a share of the least cost, on the same instances."""

    def shares(row: Row, least_us: int) -> list[tuple[float, float]]:
        found = [(when, bound) for when, _, bound in row.trace if bound > 0]
        if row.total_s is not None and row.bound_us > 0:
            found.append((row.proof_s or row.total_s, row.bound_us))
        return [(when, bound / least_us) for when, bound in found]

    figure, axes = _over_time(rows, shares, "proven bound / least known cost")
    for axis in axes:
        axis.set_ylim(0, 1.05)
    return figure


def _over_time(rows: Sequence[Row], curve: Curve, name: str) -> tuple[Figure | None, list[Axes]]:
    """A picture of each of the hardest instances, with a curve for each planner."""
    hardest = _hardest(rows)
    if not hardest:
        return None, []
    figure, axes = _grid(len(hardest), 3)
    for axis, (title, least_us, group) in zip(axes, hardest, strict=False):
        absent = []
        for row in group:
            points = [(max(SHORTEST_PROOF_S, when), value) for when, value in curve(row, least_us)]
            _steps(axis, row, points, rows)
            absent += [] if points else [row.planner]
        axis.set_xscale("log")
        axis.set_xlabel(fill(f"without: {', '.join(absent)}", 70) if absent else "", fontsize=6)
        axis.set_title(title, fontsize=7)
    figure.supxlabel("seconds", fontsize=9)
    figure.supylabel(name, fontsize=9)
    return _with_legend(figure, rows), axes[: len(hardest)]


def _hardest(rows: Sequence[Row], most: int = 6) -> list[tuple[str, int, list[Row]]]:
    """Name, least cost and rows of the instances that took the fastest prover longest."""
    reference = references(rows)
    groups = {key: group for key, group in by_instance(rows).items() if key in reference}

    def hardness(key: tuple[str, str]) -> float:
        return min((row.proof_s for row in groups[key] if row.proof_s is not None), default=float("inf"))

    hardest = sorted(groups, key=lambda key: (-hardness(key), key))[:most]
    return [(key[0].replace("#", " #"), max(1, reference[key].cost_us), groups[key]) for key in hardest]


def _steps(axis: Axes, row: Row, points: list[tuple[float, float]], rows: Sequence[Row]) -> None:
    """A row's curve, carried on to the time limit; the later ones are thinner, so that they hide none below them."""
    if points:
        style = styles(rows)[row.planner]
        points = sorted(points)
        xs = [*(x for x, _ in points), max(row.time_limit_s, points[-1][0])]
        ys = [*(y for _, y in points), points[-1][1]]
        axis.step(xs, ys, where="post", color=style.color, linestyle=style.line, linewidth=style.width)
        axis.scatter(xs[0], ys[0], s=18, marker=style.marker, color=style.color, zorder=3, clip_on=False)


def _series(rows: Sequence[Row]) -> dict[tuple[str, str], list[tuple[float, Row]]]:
    """Rows by (what stays the same, which parameter varies), for each number that takes three values or more."""
    found: dict[tuple[str, str], list[tuple[float, Row]]] = defaultdict(list)
    for row in rows:
        for name, value in row.parameters.items():
            if isinstance(value, int | float) and row.outcome not in (RunFailure.REFUSED, RunFailure.UNAVAILABLE):
                same = ", ".join(f"{k}={v}" for k, v in row.parameters.items() if k != name)
                found[f"{row.family}{f' ({same})' if same else ''}", name].append((float(value), row))
    return {key: points for key, points in found.items() if len({x for x, _ in points}) >= 3}


def _tried(rows: Sequence[Row], planner: str) -> list[Row]:
    refused = (RunFailure.REFUSED, RunFailure.UNAVAILABLE)
    solvable = references(rows)
    return [
        row
        for row in rows
        if row.planner == planner and row.outcome not in refused and (row.instance, row.digest) in solvable
    ]


class Style(NamedTuple):
    color: str
    marker: str
    line: tuple[float, Sequence[float]]
    width: float


def styles(rows: Sequence[Row]) -> dict[str, Style]:
    """The style of each planner of the rows, another one for each."""
    names = planners(rows)
    return {
        planner: Style(
            COLOURS[i % len(COLOURS)],
            MARKERS[i % len(MARKERS)],
            (0, LINES[i % len(LINES)]),
            1.2 + 2.8 * (len(names) - 1 - i) / len(names),
        )
        for i, planner in enumerate(names)
    }


def _grid(count: int, width: int) -> tuple[Figure, list[Axes]]:
    import matplotlib.pyplot as plt

    columns = min(count, width)
    lines = -(-count // columns)
    figure, axes = plt.subplots(
        lines, columns, figsize=(3.8 * columns, 2.7 * lines + 0.7), layout="constrained", squeeze=False
    )
    flat = [axis for line in axes for axis in line]
    for axis in flat[count:]:
        axis.set_visible(False)
    for axis in flat:
        axis.grid(alpha=0.3)
        axis.tick_params(labelsize=7)
        axis.tick_params(which="minor", labelbottom=False)
    return figure, flat


def _with_legend(figure: Figure, rows: Sequence[Row]) -> Figure:
    from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], color=style.color, marker=style.marker, linestyle=style.line, markersize=5, label=planner)
        for planner, style in styles(rows).items()
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=5, fontsize=8, frameon=False)
    return figure
