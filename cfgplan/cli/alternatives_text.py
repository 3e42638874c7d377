"""Alternatives as text: what each costs, and how it differs from the first."""

from __future__ import annotations

from collections.abc import Iterator

from rich.text import Text

from cfgplan.cli.update_text import cpu, verdict
from cfgplan.explaining import Alternatives
from cfgplan.planning import Plan, Problem


def alternatives_text(problem: Problem, found: Alternatives) -> Text:
    """The plans in order; ends without a newline."""
    lines = [line for place, plan in enumerate(found.plans) for line in _plan(problem, found.plans[0], place, plan)]
    lines.append(verdict(problem, found.plans[0]))
    if not found.complete:
        lines.append(Text("Further alternatives may be missing: not all could be decided.", style="yellow"))
    elif found.has_more:
        lines.append(Text("There are more: ask for a larger number of alternatives.", style="dim"))
    else:
        lines.append(Text("There are no others.", style="dim"))
    return Text("\n").join(lines)


def _plan(problem: Problem, first: Plan, place: int, plan: Plan) -> Iterator[Text]:
    changes = plan.change_set
    assert changes is not None and plan.cost_us is not None and first.cost_us is not None
    difference_us = plan.cost_us - first.cost_us
    more = f" ({'+' if difference_us >= 0 else '-'}{cpu(abs(difference_us))})" if place else ""
    kept = len(problem.environment.units) - len(changes.stopped) - len(changes.rewired)
    yield Text(
        f"{place + 1}. {cpu(plan.cost_us)}{more}: {len(changes.started)} to start, {len(changes.rewired)} to rewire, "
        f"{len(changes.stopped)} to stop, {kept} kept as they are",
        style="bold",
    )
    one, other = _running(problem, first), _running(problem, plan)
    if not place:
        yield Text(f"   {', '.join(sorted(other)) or 'nothing runs'}")
    if other - one:
        yield Text(f"   + {', '.join(sorted(other - one))}", style="green")
    if one - other:
        yield Text(f"   - {', '.join(sorted(one - other))}", style="red")
    for label in plan.unused_required:
        yield Text(f"   required {label} is not used", style="yellow")


def _running(problem: Problem, plan: Plan) -> set[str]:
    assert plan.change_set is not None
    return {unit.transformation for unit in problem.environment.update(plan.change_set).units}
