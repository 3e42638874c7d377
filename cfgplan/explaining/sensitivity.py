"""The optimal plan for each horizon, or for each upkeep of one transformation, with the exact break points."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import pairwise, product

from cfgplan.costs import LARGEST_COST_US, keep_cost_us, standby_cost_us
from cfgplan.domain import Environment, Transformation
from cfgplan.errors import InputError
from cfgplan.planning import Plan, Planner, Problem, Status, refuse_order
from cfgplan.qualities import MICRO
from cfgplan.summary import Summary, counted, summarised, summary
from cfgplan.validity.counts import unfed_us
from cfgplan.validity.hosts import carried_us, rents_us

PERCENT_US = 10_000
"""Microseconds of CPU time in each second that are 1 % of a core."""


@dataclass(frozen=True, order=True)
class CostLine:
    """A plan's cost in microseconds as it depends on a parameter: `fixed_us` and `each_us` times the parameter."""

    fixed_us: int
    each_us: int

    def at(self, value: int) -> int:
        return self.fixed_us + self.each_us * value


@dataclass(frozen=True)
class Span:
    """An interval of the parameter, from `begin` to `end`, for which `plan` is optimal at the cost `line`.

    It is unbounded if `end` is None. At a break point that is a whole number the plans of both spans are optimal.
    `runs` are the transformations that have units.
    """

    begin: Fraction
    end: Fraction | None
    line: CostLine
    plan: Plan
    runs: tuple[str, ...]

    def holds(self, value: int) -> bool:
        return self.begin <= value and (self.end is None or value <= self.end)


def _sensitivity_summary(found: Sensitivity) -> Summary:
    proven = "" if found.exact else "; not all of it is proven"
    line = f"{counted(len(found.spans), 'plan')} over {found.parameter}{proven}"
    rows = (
        (value_text(span.begin, found), "" if span.end is None else value_text(span.end, found), ", ".join(span.runs))
        for span in found.spans
    )
    return summary(line, ("from", "to", "runs"), rows)


@summarised(_sensitivity_summary)
@dataclass(frozen=True)
class Sensitivity:
    """The least cost as a function of a parameter: concave, and in each of its `spans` straight.

    The parameter is the horizon in seconds or, if `transformation` is given, its upkeep in microseconds of CPU time per
    second, both whole numbers; its value in the problem is `value`. The spans reach `last` at least; where the costs
    can't be computed beyond that, the last one ends there. `exact` is false if not all plans were proven.
    """

    value: int
    last: int
    spans: tuple[Span, ...]
    transformation: str | None = None
    exact: bool = True

    @property
    def parameter(self) -> str:
        """The varied parameter, in words."""
        return "the horizon" if self.transformation is None else f"the upkeep of {self.transformation}"

    @property
    def breaks(self) -> tuple[Fraction, ...]:
        """The values of the parameter at which another plan becomes optimal."""
        return tuple(span.begin for span in self.spans[1:])

    @property
    def here(self) -> Span | None:
        """The span with the problem's own value; None if no span has it."""
        return next((span for span in self.spans if span.holds(self.value)), None)


def value_text(value: Fraction, found: Sensitivity) -> str:
    """A value of the parameter for people: `12.5 s`, or `8 % of a core`; rounded if it is no short decimal."""
    return f"{_decimal(value)} s" if found.transformation is None else core_text(value)


def core_text(upkeep_us: Fraction) -> str:
    """An upkeep in microseconds of CPU time per second, as text: `8 % of a core`; rounded if it is no short decimal."""
    return f"{_decimal(upkeep_us / PERCENT_US)} % of a core"


def _decimal(value: Fraction) -> str:
    """Exact where six decimals are enough, else to four digits."""
    rounded = round(value, 6)
    if rounded == value:
        return f"{float(rounded):.6f}".rstrip("0").rstrip(".")
    return f"about {float(value):.4g}" if value < 10_000 else f"about {round(value)}"


def horizon_sensitivity(problem: Problem, planner: Planner) -> Sensitivity:
    """Return the optimal plan of each span of horizons from 0 on, without the largest cost.

    Without a plan, the result has no spans. The planner is called about three times for each span. Raises InputError if
    streams between hosts cost a fraction of a microsecond each second, since their rounded costs are no straight lines.
    """
    _refuse_rounding(problem)
    _refuse_energy(problem)
    library = problem.environment.transformation

    def at(horizon_s: int) -> Problem:
        return replace(problem, horizon_s=horizon_s, max_cost_us=None)

    def each_us(after: Environment) -> int:
        units = sum(
            (standby_cost_us if u.standby else keep_cost_us)(library[u.transformation], 1, after.place_of(u))
            for u in after.units
        )
        return units + carried_us(after, 1) + rents_us(after) + unfed_us(after, 1)

    # Beyond all that is paid once no saving of it is worth a microsecond more each second.
    once_us = problem.largest_cost_us(0)
    most = (LARGEST_COST_US - once_us) // max(problem.largest_cost_us(1) - once_us, 1)
    enough = max(1 + once_us, problem.horizon_s)
    return _sensitivity(_Envelope(problem, planner, at, each_us), problem.horizon_s, enough, most, None)


def upkeep_sensitivity(problem: Problem, planner: Planner, label: str) -> Sensitivity:
    """Return the optimal plan of each span of a transformation's upkeep from 0 on, without the largest cost.

    If the horizon is 0, upkeep does not matter and the result has one span. Raises InputError if hosts limit CPU time,
    since their room then changes with the upkeep.
    """
    environment = problem.environment
    kind = environment.transformation[label]
    _refuse_limits(problem, kind)

    def at(upkeep_us: int) -> Problem:
        changed = (replace(t, upkeep_us=upkeep_us) if t.label == label else t for t in environment.library)
        return replace(problem.with_parts(library=tuple(changed)), max_cost_us=None)

    def each_us(after: Environment) -> int:
        running = [unit for unit in after.units if unit.transformation == label and not unit.standby]
        return problem.horizon_s * sum(unit.host not in kind.seen_us for unit in running)

    # With more upkeep each second than all else can cost, it is used only where it must be.
    rest = at(0).largest_cost_us(problem.horizon_s)
    most = (LARGEST_COST_US - rest) // max(at(1).largest_cost_us(problem.horizon_s) - rest, 1)
    value = kind.upkeep_us
    return _sensitivity(_Envelope(problem, planner, at, each_us), value, max(1 + rest, value), most, label)


def _sensitivity(envelope: _Envelope, value: int, enough: int, most: int, label: str | None) -> Sensitivity:
    last = min(enough, most)
    lines = envelope.lines(last)
    breaks = [_crossing(one, other) for one, other in pairwise(lines)]
    ends = [*breaks, None if last == enough else Fraction(last)]
    begins = [Fraction(0), *breaks]
    spans = tuple(envelope.span(*each) for each in zip(begins, ends, lines, strict=True)) if lines else ()
    return Sensitivity(value, last, spans, label, envelope.exact)


class _Envelope:
    """The lines of the optimal plans. The planner is asked where two known lines cross: it finds a lower line there, or
    there is none.

    A line that is optimal at two values is optimal between them, since the least cost is concave.
    """

    def __init__(
        self, problem: Problem, planner: Planner, at: Callable[[int], Problem], each_us: Callable[[Environment], int]
    ) -> None:
        refuse_order(problem, "sensitivities")
        self.exact = True
        self._problem = problem
        self._planner = planner
        self._at = at
        self._each_us = each_us
        self._plans: dict[CostLine, Plan] = {}
        self._best: dict[int, CostLine | None] = {}

    def lines(self, last: int) -> list[CostLine]:
        """Return the optimal lines from 0 to `last`, in order; empty if no plan exists."""
        found: list[CostLine] = []
        ahead = [(0, last)]
        while ahead:
            low, high = ahead.pop()
            left, right = self.best(low), self.best(high)
            if left is None or right is None:
                return []
            if right.at(low) == left.at(low):
                found.append(right)
            elif left.at(high) == right.at(high):
                found.append(left)
            else:
                middle = self._lower_between(low, high, left, right)
                if middle is None:
                    found += [left, right]
                else:
                    ahead += [(middle, high), (low, middle)]
        return list(dict.fromkeys(found))

    def span(self, begin: Fraction, end: Fraction | None, line: CostLine) -> Span:
        after = self._problem.after(self._plans[line])
        return Span(begin, end, line, self._plans[line], tuple(sorted({u.transformation for u in after.units})))

    def best(self, value: int) -> CostLine | None:
        """The line of an optimal plan at a value."""
        if value not in self._best:
            plan = self._planner(self._at(value))
            self.exact &= plan.status in (Status.OPTIMAL, Status.INFEASIBLE)
            self._best[value] = None
            if plan.cost_us is not None and plan.change_set is not None:
                each_us = self._each_us(self._problem.after(plan))
                line = self._best[value] = CostLine(plan.cost_us - each_us * value, each_us)
                self._plans.setdefault(line, plan)
        return self._best[value]

    def _lower_between(self, low: int, high: int, left: CostLine, right: CostLine) -> int | None:
        """A value next to the crossing of two lines at which another one is lower."""
        before = math.floor(_crossing(left, right))
        for value in (before, before + 1):
            if low < value < high:
                line = self.best(value)
                if line is None or line.at(value) < min(left.at(value), right.at(value)):
                    return value
        return None


def _crossing(one: CostLine, other: CostLine) -> Fraction:
    return Fraction(other.fixed_us - one.fixed_us, one.each_us - other.each_us)


def _refuse_rounding(problem: Problem) -> None:
    environment = problem.environment
    for transformation in environment.library if environment.hosts else ():
        for port, price_us in product(transformation.outputs, environment.prices_us):
            if port.bytes_per_s * price_us % 1_000_000:
                each_us = port.bytes_per_s * price_us / 1_000_000
                raise InputError.of(
                    f"to carry {transformation.label}/{port.name} costs {each_us:g} microseconds each second, which is "
                    "rounded for each horizon: the least cost has no exact break points",
                    mend="choose prices so that whole microseconds come out, or solve with several --horizon",
                )


def _refuse_energy(problem: Problem) -> None:
    for host in problem.environment.hosts:
        if host.energy is not None:
            raise InputError.of(
                f"host {host.name} has an energy: what it allows changes with the horizon, and the least cost jumps",
                mend="solve with several --horizon, or leave the energy out",
            )


def _refuse_limits(problem: Problem, kind: Transformation) -> None:
    for host in problem.environment.hosts:
        if host.speed != MICRO and host in problem.environment.places_for(kind):
            raise InputError.of(
                f"host {host.name} has a speed: upkeep there is rounded, and the least cost has no exact break points",
                mend="solve with several values, such as --set T.upkeep=0.1",
            )
        if host.cpu_us is not None:
            raise InputError.of(
                f"host {host.name} limits CPU time: what fits on it changes with the upkeep, so that the least cost "
                "jumps",
                mend="solve with several values, such as --set T.upkeep=0.1, or leave the limit out",
            )
