"""`cfgplan solve --front`: the price of better quality, as a table, JSON or a plot."""

from __future__ import annotations

import argparse
from collections import Counter
from functools import partial
from typing import TYPE_CHECKING

from cfgplan.cli import options as shared
from cfgplan.cli.exits import OF_STATUS, Exit
from cfgplan.cli.screen import Screen, counted
from cfgplan.domain import ChangeSet, Environment
from cfgplan.errors import InputError
from cfgplan.planning import Problem, Status
from cfgplan.qualities import Better, units
from cfgplan.summary import some

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from cfgplan.explaining import Front

_MOST_NAMED_AT_A_POINT = 2


def show_front(options: argparse.Namespace, screen: Screen, task: shared.Task) -> Exit:
    """Compute the front and show it; exit code 0 only if it is complete."""
    from cfgplan import answers

    target, attribute = _asked(options.front, task.problem.environment, options.env)
    with task.planned(screen):
        found = answers.front(task.problem, target, attribute, **task.planning)
    if screen.json:
        screen.show_json(_plain(found))
    else:
        _show(screen, task.problem, found)
    if options.plot:
        shared.write_plot(options.plot, (6, 4), partial(_draw, found), screen)
    if not found.points:
        return OF_STATUS[Status.INFEASIBLE] if found.complete else Exit.NO_ANSWER
    return Exit.OK if found.complete else Exit.NOT_PROVEN


def _asked(text: str, environment: Environment, env: str) -> tuple[str, str]:
    """The target and attribute that are meant: the only pair that fits, or that is asked for. Raises InputError."""
    if not environment.qualities:
        raise InputError.of("no quality attribute is declared", file=env, mend="declare one under `qualities:`")
    label, _, name = text.rpartition(":")
    known = [(target, attribute.name) for target in environment.stream_targets for attribute in environment.qualities]
    fitting = [(t, a) for t, a in known if label in ("", t.label) and name in ("", a)]
    asked = [(t, a) for t, a in fitting if any(wish.attribute == a for wish in t.quality)]
    for pairs in (fitting, asked):
        if len(pairs) == 1:
            return pairs[0][0].label, pairs[0][1]
    message = (
        "--front must name a target and an attribute, since several are possible"
        if fitting
        else f"there is no {text!r}"
    )
    raise InputError.of(message, mend=f"write --front with one of {', '.join(f'{t.label}:{a}' for t, a in known)}")


def _show(screen: Screen, problem: Problem, found: Front) -> None:
    from rich.table import Table

    from cfgplan.cli.plan_text import cpu
    from cfgplan.cli.styled import Text

    table = Table("cost", found.attribute.name, "start", "rewire", "stop", "started units", box=None)
    for point in found.points:
        changes = point.plan.change_set
        assert changes is not None
        table.add_row(
            cpu(point.cost_us),
            found.attribute.shown(point.value),
            str(len(changes.started)),
            str(len(changes.rewired)),
            str(len(changes.stopped)),
            ", ".join(unit.id for unit in changes.started),
        )
    screen.show(table)
    how = "the complete front, proven" if found.complete else "better ones may exist"
    points = counted(len(found.points), "configuration")
    screen.show(Text(f"Target {found.target}, horizon {problem.horizon_s} s: {points}; {how}.", style="bold"))
    screen.times()


def _plain(found: Front) -> dict[str, object]:
    return {
        "target": found.target,
        "attribute": found.attribute.name,
        "unit": found.attribute.unit,
        "better": found.attribute.better.value,
        "complete": found.complete,
        "points": [
            {
                "cost_us": point.cost_us,
                "quality": float(units(point.value)),
                "started": [unit.id for unit in point.plan.change_set.started],
                "rewired": [unit.id for unit in point.plan.change_set.rewired],
                "stopped": list(point.plan.change_set.stopped),
            }
            for point in found.points
            if point.plan.change_set is not None
        ],
    }


def _names(found: Front) -> list[str]:
    """The transformations that each configuration starts, rare ones first."""
    started = [
        sorted({unit.transformation for unit in (point.plan.change_set or ChangeSet()).started})
        for point in found.points
    ]
    times = Counter(label for labels in started for label in labels)
    named = (sorted(labels, key=times.__getitem__) for labels in started)
    return [some(labels, _MOST_NAMED_AT_A_POINT) or "as it is" for labels in named]


def _draw(found: Front, axis: Axes) -> None:
    costs = [point.cost_us / 1e6 for point in found.points]
    values = [float(units(point.value)) for point in found.points]
    axis.step(costs, values, where="post", color="#0072b2", linewidth=1)
    axis.scatter(costs, values, s=28, color="#0072b2", zorder=3)
    for number, place in enumerate(zip(costs, values, strict=True), 1):
        axis.annotate(str(number), place, xytext=(5, 5), textcoords="offset points", fontsize=9)
    is_free_above = found.attribute.better is Better.LOWER
    axis.text(
        0.98,
        0.96 if is_free_above else 0.04,
        "\n".join(f"{number}  {name}" for number, name in enumerate(_names(found), 1)),
        transform=axis.transAxes,
        ha="right",
        va="top" if is_free_above else "bottom",
        multialignment="left",
        fontsize=8,
    )
    axis.margins(y=0.15)
    unit = f" ({found.attribute.unit})" if found.attribute.unit else ""
    axis.set_xlabel("cost over the horizon (CPU seconds)")
    axis.set_ylabel(f"{found.attribute.name}{unit}, {found.attribute.better} is better")
    axis.set_title(f"Cost of better quality of {found.target}", fontsize=11)
    axis.grid(alpha=0.3)
