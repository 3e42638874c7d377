"""Invariants between the results of different planners: every breach, in words."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from cfgplan.comparing import RunFailure
from cfgplan.comparing.runs import best_used, contradictions
from experiments.study.rows import Row


@dataclass(frozen=True)
class LeastCost:
    """The least cost known for an instance, and whether someone proved that there is none less.

    It is that of plans which leave `unused_required` required transformations unused, the fewest that any does.
    """

    cost_us: int
    proven: bool
    unused_required: int


def by_instance(rows: Iterable[Row]) -> dict[tuple[str, str], list[Row]]:
    """The rows of each instance, which is a name and the digest of its problem."""
    found: dict[tuple[str, str], list[Row]] = defaultdict(list)
    for row in rows:
        found[row.instance, row.digest].append(row)
    return dict(found)


def references(rows: Iterable[Row]) -> Mapping[tuple[str, str], LeastCost]:
    """Return the least known cost of each instance with a judged plan, to measure costs against."""
    found = {}
    for instance, group in by_instance(rows).items():
        plans = best_used(group)
        if plans:
            cost_us = min(plan.cost_us for plan in plans if plan.cost_us is not None)
            proven = any(row.proven and row.cost_us == cost_us for row in plans)
            found[instance] = LeastCost(cost_us, proven, plans[0].unused_required)
    return found


def gap(row: Row, reference: Mapping[tuple[str, str], LeastCost]) -> float | None:
    """Return how much more a row's plan costs than the least known cost, as a share; None without a comparable plan."""
    least = reference.get((row.instance, row.digest))
    if least is None or row.cost_us is None or not row.has_plan or row.violations != ():
        return None
    if row.unused_required > least.unused_required:
        return None
    least_us = least.cost_us
    return (row.cost_us - least_us) / least_us if least_us else float(row.cost_us > 0)


def failures(rows: Iterable[Row]) -> list[str]:
    """Return a sentence for each planner that crashed or lacks a package, with the reason of its first such run."""
    told = {RunFailure.CRASHED, RunFailure.UNAVAILABLE}
    first: dict[str, Row] = {}
    for row in rows:
        if row.outcome in told:
            first.setdefault(row.planner, row)
    return [f"{planner}: {row.outcome} at {row.instance}: {row.message}" for planner, row in sorted(first.items())]


def breaches(rows: Iterable[Row]) -> list[str]:
    """Every disagreement between planners and every plan that the judge refuses; empty if all is well."""
    return [
        f"{instance}: {text}" for (instance, _), group in by_instance(rows).items() for text in contradictions(group)
    ]
