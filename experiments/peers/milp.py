"""HiGHS: a mixed-integer program over units and demanded tags, with landmarks added where a ring is not grounded.

HiGHS and ortools can't share a process. It computes in doubles; the plan's cost is recomputed exactly.
"""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from math import ceil, gcd

import highspy
import numpy as np

from cfgplan.errors import InputError
from cfgplan.planning import Plan, Problem, Progress, Status
from cfgplan.reasons import unmet_reasons
from experiments.peers.selection import Selection

WHO = "highs"


def plan(
    problem: Problem, *, time_limit_s: float | None = None, report: Callable[[Progress], None] | None = None
) -> Plan:
    """The cheapest update; refuses feedback inputs. See `planning.Planner`."""
    began = time.monotonic()
    selection = Selection(problem, WHO)
    if not all(map(selection.feeders, selection.wanted)):
        return Plan(WHO, Status.INFEASIBLE, reasons=unmet_reasons(problem))
    if any(port.feedback for candidate in selection.candidates for port in candidate.transformation.inputs):
        raise InputError.of(f"{WHO} does not know feedback inputs")
    model = Model(selection)
    built_s = time.monotonic() - began
    bound_us, rounds, nodes = 0, 0, 0
    best: list[int] | None = None
    while True:
        left_s = None if time_limit_s is None else time_limit_s - (time.monotonic() - began)
        if left_s is not None and left_s <= 0:
            break
        chosen, round_bound_us, round_nodes, solved = model.solve(left_s)
        rounds, nodes, bound_us = rounds + 1, nodes + round_nodes, max(bound_us, round_bound_us)
        if chosen is not None and selection.satisfied(chosen):
            best = chosen
            bound_us = selection.cost_us(chosen) if solved else bound_us
        if report is not None:
            cost_us = None if best is None else selection.cost_us(best)
            report(Progress(time.monotonic() - began, cost_us, bound_us))
        if best is not None or not solved or chosen is None:
            break
        model.cut(chosen)
    counts = {"rounds": rounds, "nodes": nodes}
    seconds = {"build": built_s, "search": time.monotonic() - began - built_s}
    return selection.answer(best, bound_us, seconds=seconds, counts=counts)


@dataclass
class Rows:
    """Linear constraints in the compressed form that HiGHS takes all at once: `low <= sum(value * column)`."""

    low: list[float] = field(default_factory=list)
    starts: list[int] = field(default_factory=list)
    columns: list[int] = field(default_factory=list)
    values: list[float] = field(default_factory=list)

    def at_least(self, low: float, columns: Sequence[int], values: Sequence[float]) -> None:
        self.low.append(low)
        self.starts.append(len(self.columns))
        self.columns += columns
        self.values += values

    def implies(self, column: int, others: Sequence[int]) -> None:
        """column <= sum of the others"""
        self.at_least(0, [*others, column], [1.0] * len(others) + [-1.0])

    def some(self, columns: Sequence[int]) -> None:
        self.at_least(1, columns, [1.0] * len(columns))

    def add_to(self, highs: highspy.Highs) -> None:
        high = np.full(len(self.low), highspy.kHighsInf)
        starts, columns = np.array(self.starts, dtype=np.int32), np.array(self.columns, dtype=np.int32)
        highs.addRows(len(self.low), np.array(self.low), high, len(columns), starts, columns, np.array(self.values))


class Model:
    """x for each candidate, y for each demanded tag, f for each feeder of a port in a distinct group."""

    def __init__(self, selection: Selection) -> None:
        self.selection = selection
        self.scale = gcd(*(candidate.cost_us for candidate in selection.candidates)) or 1
        self.highs = highspy.Highs()  # type: ignore[no-untyped-call]
        self.highs.silent()
        for option, value in {"threads": 1, "mip_rel_gap": 0.0, "mip_abs_gap": 0.5}.items():
            self.highs.setOptionValue(option, value)
        self.needs = [sorted({port.tag for port in c.transformation.inputs}) for c in selection.candidates]
        self.picky = any(p.distinct is not None for c in selection.candidates for p in c.transformation.inputs)
        self.closure = Closure(selection, self.needs)
        self._costs = [float(candidate.cost_us // self.scale) for candidate in selection.candidates]
        self._y: dict[str, int] = {}
        rows = Rows()
        for i in selection.kept:
            rows.some([i])
        for tag in dict.fromkeys([*selection.wanted, *(tag for tags in self.needs for tag in tags)]):
            self._y[tag] = self._column()
            rows.implies(self._y[tag], [i for i in selection.feeders(tag) if tag not in self.needs[i]])
        for tag in selection.wanted:
            rows.some([self._y[tag]])
        for i, tags in enumerate(self.needs):
            for tag in tags:
                rows.implies(i, [self._y[tag]])
            self._feed_from_different_ones(i, rows)
        count = len(self._costs)
        columns = np.arange(count, dtype=np.int32)
        self.highs.addVars(count, np.zeros(count), np.ones(count))
        self.highs.changeColsCost(count, columns, np.array(self._costs))
        whole = np.full(count, highspy.HighsVarType.kInteger.value, dtype=np.uint8)
        self.highs.changeColsIntegrality(count, columns, whole)
        rows.add_to(self.highs)

    def solve(self, left_s: float | None) -> tuple[list[int] | None, int, int, bool]:
        """The chosen of the best solution, a bound, the nodes, and whether the solution is proven optimal."""
        self.highs.setOptionValue("time_limit", 1e9 if left_s is None else left_s)
        self.highs.run()
        info = self.highs.getInfo()
        solved = self.highs.getModelStatus() == highspy.HighsModelStatus.kOptimal
        bound = info.mip_dual_bound
        bound_us = max(0, ceil(bound - 1e-6 * max(1.0, abs(bound)))) * self.scale if abs(bound) < 1e300 else 0
        if info.primal_solution_status != highspy.SolutionStatus.kSolutionStatusFeasible:
            return None, bound_us, max(0, info.mip_node_count), False
        value = self.highs.getSolution().col_value
        chosen = [i for i in range(len(self.needs)) if value[i] > 0.5]
        return chosen, bound_us, max(0, info.mip_node_count), solved

    def cut(self, chosen: list[int]) -> None:
        """Landmarks that these chosen miss: one of the ways in must be taken; or one of those outside a grown set."""
        rows = Rows()
        if self.picky:
            rows.some(self.selection.ways_in(chosen))
        else:
            for outside in self.closure.missed(chosen):
                rows.some(outside)
        rows.add_to(self.highs)

    def _column(self) -> int:
        self._costs.append(0.0)
        return len(self._costs) - 1

    def _feed_from_different_ones(self, i: int, rows: Rows) -> None:
        picky = [port for port in self.selection.candidates[i].transformation.inputs if port.distinct is not None]
        taken: dict[tuple[str | None, str], list[int]] = defaultdict(list)
        for port in picky:
            by_label: dict[str, list[int]] = defaultdict(list)
            for feeder in self.selection.feeders(port.tag):
                by_label[self.selection.candidates[feeder].transformation.label].append(feeder)
            feeds = {label: self._column() for label in by_label}
            for label, feed in feeds.items():
                rows.implies(feed, by_label[label])
                taken[port.distinct, label].append(feed)
            rows.implies(i, list(feeds.values()))
        for columns in taken.values():
            rows.at_least(-1, columns, [-1.0] * len(columns))


class Closure:
    """What a growing set of units feeds from sources."""

    def __init__(self, selection: Selection, needs: Sequence[Collection[str]]) -> None:
        self._selection = selection
        self._needs = needs
        self._waiting: dict[str, list[int]] = defaultdict(list)
        self._feeds: dict[int, list[str]] = defaultdict(list)
        for i, tags in enumerate(needs):
            for tag in tags:
                self._waiting[tag].append(i)
        for tag in {*self._waiting, *selection.wanted}:
            for i in selection.feeders(tag):
                self._feeds[i].append(tag)
        costs = [candidate.cost_us for candidate in selection.candidates]
        self._cheap_last = sorted(range(len(costs)), key=lambda i: (-costs[i], i))
        self._goals = dict.fromkeys([*selection.wanted, *(tag for i in sorted(selection.kept) for tag in needs[i])])

    def missed(self, chosen: Collection[int]) -> list[list[int]]:
        """For each goal that the chosen miss, who is left out of a largest set around them that misses it too."""
        self._begin(chosen)
        missed = [goal for goal in self._goals if goal not in self._fed]
        left_out = []
        for goal in missed:
            self._begin(chosen)
            left_out.append([i for i in self._cheap_last if i not in self._members and not self._add_unless(i, goal)])
        return left_out

    def _begin(self, chosen: Collection[int]) -> None:
        self._fed: set[str] = set()
        self._members: set[int] = set()
        self._missing = [len(tags) for tags in self._needs]
        for i in chosen:
            self._add(i)

    def _add(self, i: int) -> list[str]:
        """Add a unit; returns the tags that are fed since."""
        self._members.add(i)
        new: list[str] = []
        ahead = [i] if self._missing[i] == 0 else []
        for unit in ahead:
            for tag in self._feeds[unit]:
                if tag not in self._fed:
                    self._fed.add(tag)
                    new.append(tag)
                    for above in self._waiting[tag]:
                        self._missing[above] -= 1
                        if self._missing[above] == 0 and above in self._members:
                            ahead.append(above)
        return new

    def _add_unless(self, i: int, goal: str) -> bool:
        """Add a unit unless the goal would be fed by it; returns whether it was added."""
        new = self._add(i)
        if goal not in self._fed:
            return True
        self._members.discard(i)
        for tag in new:
            self._fed.discard(tag)
            for above in self._waiting[tag]:
                self._missing[above] += 1
        return False
