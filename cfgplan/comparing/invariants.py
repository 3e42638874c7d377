"""What must hold between the results of different planners, whoever is right: every breach, in words."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from cfgplan.comparing.rows import Row
from cfgplan.planning import REFUSED


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
    """What to measure costs against, for each instance that anyone has a judged plan for."""
    found = {}
    for instance, group in by_instance(rows).items():
        plans = _best_used(group)
        if plans:
            cost_us = min(map(_cost_us, plans))
            proven = any(row.proven and row.cost_us == cost_us for row in plans)
            found[instance] = LeastCost(cost_us, proven, plans[0].unused_required)
    return found


def gap(row: Row, reference: Mapping[tuple[str, str], LeastCost]) -> float | None:
    """By what share of the least known cost a row's plan is dearer; None without a plan that compares with it."""
    least = reference.get((row.instance, row.digest))
    if least is None or row.cost_us is None or not row.has_plan or row.violations != ():
        return None
    if row.unused_required > least.unused_required:
        return None
    least_us = least.cost_us
    return (row.cost_us - least_us) / least_us if least_us else float(row.cost_us > 0)


def breaches(rows: Iterable[Row]) -> list[str]:
    """Every disagreement between planners and every plan that the judge refuses; empty if all is well."""
    rows = list(rows)
    found = [f"{_who(row)}: {text}" for row in rows for text in row.violations or ()]
    for group in by_instance(rows).values():
        found += _disagreements(group)
    return found


def _disagreements(rows: Sequence[Row]) -> Iterator[str]:
    plans = _best_used(rows)
    cheapest = min(plans, key=_cost_us, default=None)
    for row in rows:
        if row.has_plan and row.violations is None:
            yield f"{_who(row)}: the plan was not judged"
        if cheapest is not None:
            least = f"{cheapest.planner} has a plan of {_cost_us(cheapest)} us"
            if row in plans and row.proven and _cost_us(row) > _cost_us(cheapest):
                yield f"{_who(row)}: says that {_cost_us(row)} us is the least, but {least}"
            if row.bound_us > _cost_us(cheapest) and not row.unused_required:
                yield f"{_who(row)}: says that none costs less than {row.bound_us} us, but {least}"
        if row.outcome in REFUSED:
            for other in rows:
                if other.has_plan or (other.proven and other.outcome != row.outcome):
                    yield f"{_who(row)}: says {row.outcome}, but {other.planner} says {other.outcome}"


def _cost_us(row: Row) -> int:
    assert row.cost_us is not None
    return row.cost_us


def _best_used(rows: Sequence[Row]) -> list[Row]:
    """The judged plans that leave the fewest required transformations unused: only their costs compare."""
    plans = [row for row in rows if row.has_plan and row.violations == ()]
    fewest = min((row.unused_required for row in plans), default=0)
    return [row for row in plans if row.unused_required == fewest]


def _who(row: Row) -> str:
    return f"{row.planner} on {row.instance}"
