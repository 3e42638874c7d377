"""`cfgplan compare`: planners side by side on the user's own files."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import partial
from typing import TYPE_CHECKING

from cfgplan.amounts import span
from cfgplan.cli import options as shared
from cfgplan.cli.exits import Exit
from cfgplan.cli.screen import Screen

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from rich.table import Table

    from cfgplan.comparing import Run


_NARROW_RANGE = 100.0
_ROW_HEIGHT = 3.5
"""Inches that the plot of an environment is high."""
_LONGEST_WAIT_S = 1_000_000.0
"""The greatest time limit in seconds: operating systems wait little longer for a process."""


def add_to(parser: argparse.ArgumentParser) -> None:
    parser.epilog = (
        "example:\n"
        "  cfgplan compare models/nao/2-segmenter-lost.yaml models/building/office.yaml\n"
        "  cfgplan compare env.yaml --planner cpsat --planner my_planners:greedy --timeout 2\n"
        "  cfgplan compare env.yaml --plot planners.svg"
    )
    parser.add_argument("envs", metavar="ENV", nargs="+", help="environment files; each planner plans for each of them")
    parser.add_argument(
        "--planner",
        action="append",
        metavar="NAME",
        help="compare only this planner, or your own as module:function; may be repeated (default: all)",
    )
    parser.add_argument(
        "--timeout",
        type=shared.positive,
        default=10.0,
        metavar="S",
        help="time limit of each run in seconds (default: 10)",
    )
    parser.add_argument(
        "--memory", type=shared.count, metavar="MB", help="limit of a run's address space in megabytes (default: none)"
    )
    plot = "draw each planner's best cost and bound over time, as .svg, .png or .pdf (needs the extra `plots`)"
    parser.add_argument("--plot", type=shared.plot_file, metavar="FILE", help=plot)
    parser.add_argument("--traceback", action="store_true", help="print the traceback of a planner that crashed")
    shared.add_what_if(parser)
    shared.add_matching(parser)
    shared.add_json(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace, screen: Screen) -> Exit:
    from cfgplan import __version__, comparing
    from cfgplan.cli.styled import Text

    for name in options.planner or ():
        shared.planner(name)

    entrants = [comparing.entrant(name) for name in options.planner or comparing.REGISTERED]
    limits = comparing.Limits(time_limit_s=min(options.timeout, _LONGEST_WAIT_S), memory_mb=options.memory)
    runs, contradictions = [], []
    plotted: dict[str, list[Run]] = {}
    for env in options.envs:
        world = shared.load(options, screen, env)
        problem = shared.problem(options, screen, world)
        found: list[Run] = []
        with screen.phase("plan") as work:
            for planner in entrants:
                work.best = f"{env}: {planner.name}, {len(found) + 1} of {len(entrants)}"
                found.append(comparing.run_one(problem, planner, limits))
        plotted[env] = found
        runs += [{"environment": env, "environment_digest": world.digest, **asdict(each)} for each in found]
        contradictions += [f"{env}: {text}" for text in comparing.contradictions(found)]
        if not screen.json:
            screen.show(_table(env, found))
    if options.plot:
        size = (7, _ROW_HEIGHT * len(plotted))
        shared.write_plots(options.plot, size, len(plotted), partial(_draw, plotted), screen)
    crashes = [each for each in runs if each["outcome"] == comparing.RunFailure.CRASHED]
    if screen.json:
        told = {"cfgplan": __version__, "time_limit_s": limits.time_limit_s, "memory_mb": limits.memory_mb}
        screen.show_json({**told, "runs": runs, "contradictions": contradictions})
    elif contradictions or crashes:
        said = [f"contradiction: {text}" for text in contradictions]
        said += [f"{each['environment']}: {each['planner']} crashed: {each['message']}" for each in crashes]
        screen.show(Text("\n".join(said), style="bold red"))
        if options.traceback:
            screen.show(Text("\n".join(each["traceback"] for each in crashes if each["traceback"])))
        elif any(each["traceback"] for each in crashes):
            screen.note("Add --traceback to see where.")
    elif any(each["proof_s"] is not None for each in runs):
        screen.show(Text("All proofs agree, and every plan passes the judge.", style="bold green"))
    return Exit.INVALID if contradictions or crashes else Exit.OK


def _table(env: str, runs: Sequence[Run]) -> Table:
    """Return a table with a row for each planner: its answer, cost, proven bound, and times."""
    from rich import box
    from rich.table import Table

    from cfgplan.cli.plan_text import cpu

    table = Table(title=env, title_justify="left", box=box.SIMPLE)
    for head in ("planner", "answer", "cost", "at least", "first plan", "best plan", "proof", "ended", "memory"):
        table.add_column(head, overflow="fold")
    for each in runs:
        times = (each.first_s, each.best_s, each.proof_s, each.total_s)
        table.add_row(
            each.planner,
            "wrong plan" if each.violations else f"{each.outcome}: {each.message}" if each.message else each.outcome,
            "" if each.cost_us is None else cpu(each.cost_us),
            cpu(each.bound_us),
            *("" if time_s is None else span(time_s) for time_s in times),
            "" if each.peak_mb is None else f"{each.peak_mb:.0f} MB",
        )
    return table


def _draw(found: Mapping[str, Sequence[Run]], rows: Sequence[Axes]) -> None:
    """For each environment the best cost (a line) and the bound (dotted) of each planner over time.

    A cross marks the first plan, a circle a proof; the legend has the outcomes, those without a plan too.
    """
    from matplotlib.ticker import LogLocator

    for axis, (env, runs) in zip(rows, found.items(), strict=True):
        for number, one in enumerate(runs):
            colour = f"C{number % 10}"
            end_s = max([one.total_s or 0.0, *(time_s for time_s, _, _ in one.trace)])
            costs = [(time_s, cost_us / 1e6) for time_s, cost_us, _ in one.trace if cost_us is not None]
            if one.has_plan and one.cost_us is not None and one.best_s is not None:
                costs = [*costs, (one.best_s, one.cost_us / 1e6), (max(end_s, one.best_s), one.cost_us / 1e6)]
            bounds = [(time_s, bound_us / 1e6) for time_s, _, bound_us in one.trace if bound_us]
            axis.step(*_columns(sorted(costs)), where="post", color=colour, label=f"{one.planner}: {one.outcome}")
            axis.step(*_columns(bounds), where="post", color=colour, linestyle=":", linewidth=1)
            for at_s, mark in ((one.first_s, "x"), (one.proof_s, "o")):
                if at_s is not None and one.cost_us is not None:
                    first_us = next((cost_us for _, cost_us, _ in one.trace if cost_us is not None), one.cost_us)
                    axis.plot([at_s], [(first_us if mark == "x" else one.cost_us) / 1e6], mark, color=colour)
        axis.set_xscale("log")
        axis.xaxis.set_major_formatter(lambda seconds, _: span(seconds))
        low, high = axis.get_xlim()
        if high < _NARROW_RANGE * low:  # powers of ten alone would be one tick, or none
            axis.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axis.xaxis.set_minor_formatter(lambda *_: "")
        axis.set_title(env, fontsize=10)
        axis.set_xlabel("time since the call of the planner (× first plan, ● proof; solid: best cost, dotted: bound)")
        axis.set_ylabel("cost over the horizon (CPU seconds)")
        axis.grid(alpha=0.3)
        axis.legend(fontsize=8)


def _columns(points: Sequence[tuple[float, float]]) -> tuple[list[float], list[float]]:
    return [time_s for time_s, _ in points], [value for _, value in points]
