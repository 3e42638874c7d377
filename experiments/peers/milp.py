"""HiGHS: a mixed-integer program over units and demanded tags, with landmarks added where a ring is not grounded.

HiGHS and ortools can't share a process. It computes in doubles; the plan's cost is recomputed exactly.
"""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Collection, Sequence
from math import ceil, gcd

import highspy

from cfgplan.errors import InputError
from cfgplan.planners.selection import Selection
from cfgplan.planning import Plan, Problem, Progress, Status
from cfgplan.reasons import unmet_reasons

WHO = "highs"


def plan(
    problem: Problem, *, time_limit_s: float | None = None, report: Callable[[Progress], None] | None = None
) -> Plan:
    """The cheapest update; refuses feedback inputs. See `planning.Planner`."""
    began = time.monotonic()
    if reasons := unmet_reasons(problem):
        return Plan(WHO, Status.INFEASIBLE, reasons=reasons)
    selection = Selection(problem, WHO)
    if any(port.feedback for candidate in selection.candidates for port in candidate.transformation.inputs):
        raise InputError.of(f"{WHO} does not know feedback inputs")
    model = Model(selection)
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
    return selection.answer(best, bound_us, seconds={"all": time.monotonic() - began}, counts=counts)


class Model:
    """x for each candidate, y for each demanded tag, f for each feeder of a port in a distinct group."""

    def __init__(self, selection: Selection) -> None:
        self.selection = selection
        self.scale = gcd(*(candidate.cost_us for candidate in selection.candidates)) or 1
        self.highs = highspy.Highs()  # type: ignore[no-untyped-call]
        self.highs.silent()
        for option, value in {"threads": 1, "mip_rel_gap": 0.0, "mip_abs_gap": 0.5}.items():
            self.highs.setOptionValue(option, value)
        self.x = [self._binary(candidate.cost_us // self.scale) for candidate in selection.candidates]
        self.y: dict[str, int] = {}
        for tag in selection.wanted:
            self.highs.changeColBounds(self._fed(tag), 1, 1)
        for i in selection.kept:
            self.highs.changeColBounds(self.x[i], 1, 1)
        for i, candidate in enumerate(selection.candidates):
            for tag in sorted({port.tag for port in candidate.transformation.inputs}):
                self._at_most(self.x[i], [self._fed(tag)])
            self._feed_from_different_ones(i)

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
        return [i for i, x in enumerate(self.x) if value[x] > 0.5], bound_us, max(0, info.mip_node_count), solved

    def cut(self, chosen: list[int]) -> None:
        """Landmarks that these chosen miss: one of the ways in must be taken; so for a grown set too."""
        self._some([self.x[i] for i in self.selection.ways_in(chosen)])
        picky = any(p.distinct is not None for c in self.selection.candidates for p in c.transformation.inputs)
        if not picky:
            for outside in _grown(self.selection, chosen):
                self._some([self.x[i] for i in outside])

    def _fed(self, tag: str) -> int:
        """The column that says that a tag is fed, by one who does not need it itself."""
        if tag not in self.y:
            self.y[tag] = self._binary(0)
            needs = self.selection.candidates
            feeders = [
                i for i in self.selection.feeders(tag) if all(p.tag != tag for p in needs[i].transformation.inputs)
            ]
            self._at_most(self.y[tag], [self.x[i] for i in feeders])
        return self.y[tag]

    def _feed_from_different_ones(self, i: int) -> None:
        picky = [port for port in self.selection.candidates[i].transformation.inputs if port.distinct is not None]
        taken: dict[tuple[str | None, str], list[int]] = defaultdict(list)
        for port in picky:
            by_label: dict[str, list[int]] = defaultdict(list)
            for feeder in self.selection.feeders(port.tag):
                by_label[self.selection.candidates[feeder].transformation.label].append(self.x[feeder])
            feeds = {label: self._binary(0) for label in by_label}
            for label, feed in feeds.items():
                self._at_most(feed, by_label[label])
                taken[port.distinct, label].append(feed)
            self._at_most(self.x[i], list(feeds.values()))
        for columns in taken.values():
            self.highs.addRow(-highspy.kHighsInf, 1, len(columns), columns, [1.0] * len(columns))

    def _binary(self, cost: int) -> int:
        column: int = self.highs.getNumCol()
        self.highs.addCol(float(cost), 0, 1, 0, [], [])
        self.highs.changeColIntegrality(column, highspy.HighsVarType.kInteger)
        return column

    def _at_most(self, column: int, others: Sequence[int]) -> None:
        """column <= sum of the others"""
        columns = [column, *(other for other in others if other != column)]
        values = [1.0, *([-1.0] * (len(columns) - 1))]
        self.highs.addRow(-highspy.kHighsInf, 0, len(columns), columns, values)

    def _some(self, columns: Sequence[int]) -> None:
        self.highs.addRow(1, highspy.kHighsInf, len(columns), list(columns), [1.0] * len(columns))


def _grown(selection: Selection, chosen: Collection[int]) -> list[list[int]]:
    """For each goal that the chosen miss, who is left out of a largest set around them that misses it too."""
    candidates = selection.candidates
    cheap_last = sorted(range(len(candidates)), key=lambda i: (-candidates[i].cost_us, i))
    goals = list(selection.wanted)
    goals += [port.tag for i in selection.kept for port in candidates[i].transformation.inputs]
    left_out = []
    for goal in dict.fromkeys(goals):
        closure = Closure(selection)
        for i in chosen:
            closure.add(i)
        if goal not in closure.fed:
            left_out.append([i for i in cheap_last if i not in chosen and not closure.add_unless(i, goal)])
    return left_out


class Closure:
    """What a growing set of units feeds from sources."""

    def __init__(self, selection: Selection) -> None:
        self.fed: set[str] = set()
        self._members: set[int] = set()
        self._missing: list[int] = []
        self._waiting: dict[str, list[int]] = defaultdict(list)
        self._feeds: dict[int, list[str]] = defaultdict(list)
        for i, candidate in enumerate(selection.candidates):
            tags = {port.tag for port in candidate.transformation.inputs}
            self._missing.append(len(tags))
            for tag in tags:
                self._waiting[tag].append(i)
        for tag in {*self._waiting, *selection.wanted}:
            for i in selection.feeders(tag):
                self._feeds[i].append(tag)

    def add(self, i: int) -> list[str]:
        """Add a unit; returns the tags that are fed since."""
        self._members.add(i)
        new: list[str] = []
        ahead = [i] if self._missing[i] == 0 else []
        for unit in ahead:
            for tag in self._feeds[unit]:
                if tag not in self.fed:
                    self.fed.add(tag)
                    new.append(tag)
                    for above in self._waiting[tag]:
                        self._missing[above] -= 1
                        if self._missing[above] == 0 and above in self._members:
                            ahead.append(above)
        return new

    def add_unless(self, i: int, goal: str) -> bool:
        """Add a unit unless the goal would be fed by it; returns whether it was added."""
        new = self.add(i)
        if goal not in self.fed:
            return True
        self._members.discard(i)
        for tag in new:
            self.fed.discard(tag)
            for above in self._waiting[tag]:
                self._missing[above] += 1
        return False
