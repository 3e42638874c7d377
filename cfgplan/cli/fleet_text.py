"""What a plan comes to beyond the paper, as text for people: cost by parts, quality, hosts, transfers, failures."""

from __future__ import annotations

from collections.abc import Iterator

from rich.text import Text

from cfgplan.costs import seconds
from cfgplan.domain import Environment, Target
from cfgplan.figures import cost_parts, loads, qualities_of_targets, transfers
from cfgplan.planning import Failures, Problem
from cfgplan.qualities import Better, QualityAttribute, Wish, units

MOST_TRANSFERS = 10
"""More transfers are counted, not listed."""


def fleet_lines(problem: Problem, after: Environment) -> Iterator[Text]:
    """The lines of a configuration after an update; none for a problem that asks nothing beyond the paper."""
    if problem.is_plain:
        return
    parts = cost_parts(problem, after.units)
    named = {"transfers": parts.transfer_us, "cold spares": parts.standby_us, "quality missed": parts.quality_us}
    more = [f"{name} {cpu(cost_us)}" for name, cost_us in named.items() if cost_us]
    if more:
        both = [f"labor {cpu(parts.labor_us)}", f"upkeep {cpu(parts.upkeep_us)}"]
        yield Text(f"The cost is {' + '.join([*both, *more])}.")
    yield from _qualities(after)
    yield from _hosts(problem, after)
    if problem.survive is not None:
        kinds = "unit or host" if problem.survive is Failures.HOSTS else "unit"
        yield Text(f"No failure of a single {kinds} leaves a target without a stream.")


def cpu(cost_us: int) -> str:
    return f"{seconds(cost_us):f} s"


def quality(attribute: QualityAttribute, micro: int) -> str:
    """A value for people: `0.3 m`."""
    return f"{units(micro):f}{' ' + attribute.unit if attribute.unit else ''}"


def _qualities(after: Environment) -> Iterator[Text]:
    reached = qualities_of_targets(after, after.units)
    for target in after.targets:
        values = [_reached(after, target, name, value) for name, value in reached.get(target.label, {}).items()]
        if values:
            yield Text(f"Target {target.label}: {', '.join(values)}.")


def _reached(environment: Environment, target: Target, name: str, value: int) -> str:
    attribute = environment.quality[name]
    wish = next((wish for wish in target.quality if wish.attribute == name), Wish(name))
    side = "at most" if attribute.better is Better.LOWER else "at least"
    asked = "" if wish.bound is None else f" ({side} {quality(attribute, wish.bound)} is asked)"
    return f"{name} {quality(attribute, value)}{asked}"


def _hosts(problem: Problem, after: Environment) -> Iterator[Text]:
    for name, load in loads(after, after.units).items():
        host = after.host[name]
        number = sum(unit.host == name for unit in after.units)
        cpu_limit = "" if host.cpu_us is None else f" of {cpu(host.cpu_us)}"
        memory_limit = "" if host.memory_mb is None else f" of {host.memory_mb}"
        counted = "1 unit" if number == 1 else f"{number} units"
        yield Text(f"Host {name}: {counted}, {cpu(load.cpu_us)}{cpu_limit} CPU/s, {load.memory_mb}{memory_limit} MB.")
    carried = transfers(problem, after.units)
    for transfer in carried[:MOST_TRANSFERS]:
        dear = f", {cpu(transfer.cost_us)}" if transfer.cost_us else ""
        yield Text(f"  {transfer.stream}: {transfer.origin} -> {transfer.to}{dear}", style="dim")
    if len(carried) > MOST_TRANSFERS:
        yield Text(f"  ... and {len(carried) - MOST_TRANSFERS} more transfers", style="dim")
