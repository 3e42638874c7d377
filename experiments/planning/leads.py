"""The lead of one planner over others in time to proof, and in bounds and plans on instances that neither proved.

A planner that did not prove an instance counts with its time limit, so that the true lead is at least the given one.
On instances that neither proved, bounds and plans are compared instead.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from math import exp, log

from cfgplan.comparing import RunFailure
from experiments.study.invariants import by_instance
from experiments.study.rows import SHORTEST_PROOF_S, Row


@dataclass(frozen=True)
class Lead:
    """The geometric mean of the other's time to proof over the base's, on the `decided` instances that at least one
    proved.

    `at_least`: the other left some of these unproven; `at_most`: the base did. `bounds` and `plans` count, among the
    undecided instances, how often the base had the better one, and how often the other had.
    """

    ratio: float | None
    decided: int
    at_least: bool
    at_most: bool
    undecided: int
    bounds: tuple[int, int]
    plans: tuple[int, int]

    def text(self) -> str:
        """Return the lead as text such as `≥ 4.2`, followed by the better bounds and plans on undecided instances."""
        sign = {(False, False): "", (True, False): "≥ ", (False, True): "≤ ", (True, True): "about "}
        parts = [] if self.ratio is None else [f"{sign[self.at_least, self.at_most]}{self.ratio:.2g}"]
        if self.undecided:
            bounds, plans = (f"{ours}:{theirs}" for ours, theirs in (self.bounds, self.plans))
            parts.append(f"{self.undecided} open: bounds {bounds}, plans {plans}")
        return "; ".join(parts) or "-"


def lead(pairs: Iterable[tuple[Row, Row]]) -> Lead:
    """Return the lead of the base over the other; a pair is the base's and the other's row of one instance."""
    ratios, censored, bounds, plans = [], [False, False], [0, 0], [0, 0]
    undecided = 0
    for base, other in pairs:
        if base.proven or other.proven:
            ratios.append(log(seconds(other) / seconds(base)))
            censored = [censored[0] or not other.proven, censored[1] or not base.proven]
        else:
            undecided += 1
            _count(bounds, base.bound_us, other.bound_us)
            _count(plans, -_cost_us(base), -_cost_us(other))
    ratio = exp(sum(ratios) / len(ratios)) if ratios else None
    at_least, at_most = censored
    return Lead(ratio, len(ratios), at_least, at_most, undecided, (bounds[0], bounds[1]), (plans[0], plans[1]))


def matched(rows: Iterable[Row], base: str, others: Sequence[str]) -> Iterator[tuple[Row, Row]]:
    """Yield for each instance the base's row, and the other row with the first proof (any row if none has one)."""
    for group in by_instance(rows).values():
        bases = [row for row in group if row.planner == base and took_part(row)]
        ties = [row for row in group if row.planner in others and took_part(row)]
        if bases and ties:
            yield bases[0], min(ties, key=lambda row: (not row.proven, seconds(row), -row.bound_us, _cost_us(row)))


def seconds(row: Row) -> float:
    """Return the seconds until the proof, or the time limit without one."""
    return row.time_limit_s if row.proof_s is None else min(row.time_limit_s, max(SHORTEST_PROOF_S, row.proof_s))


def took_part(row: Row) -> bool:
    """Return whether the planner was installed and supports the problem."""
    return row.outcome not in (RunFailure.REFUSED, RunFailure.UNAVAILABLE)


def _cost_us(row: Row) -> float:
    return row.cost_us if row.cost_us is not None and row.has_plan else float("inf")


def _count(wins: list[int], ours: float, theirs: float) -> None:
    wins[0] += ours > theirs
    wins[1] += theirs > ours
