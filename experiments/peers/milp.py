"""The peer HiGHS, with landmarks added after each solution that is not grounded.

HiGHS and ortools can't share a process. It computes in doubles; the plan's cost is recomputed exactly.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from math import ceil

import numpy as np

from cfgplan.planning import Plan, Problem, Progress, Status
from cfgplan.reasons import unmet_reasons
from experiments.peers.counting import Counting, is_counted
from experiments.peers.lead import Lead, lead_apart
from experiments.peers.placing import selection_of
from experiments.peers.program import NumberProgram, Program, Rows
from experiments.peers.selection import Selection

Report = Callable[[Progress], None] | None


def plan(problem: Problem, *, time_limit_s: float | None = None, report: Report = None) -> Plan:
    """Return the cheapest update. Raises InputError for feedback inputs. See `planning.Planner`."""
    began = time.monotonic()
    if is_counted(problem):
        return _plan_numbers(Counting(problem, "highs"), began, time_limit_s, report)
    return _plan(selection_of(problem, "highs"), None, began, time_limit_s, report)


def plan_led(problem: Problem, *, time_limit_s: float | None = None, report: Report = None) -> Plan:
    """Return the cheapest update, using the landmarks and the remaining candidates of `cpsat`.

    No first solution is given, since with one HiGHS 1.16 may return an objective and values of different solutions.
    """
    began = time.monotonic()
    selection = Selection(problem, "highs-led")
    lead = lead_apart(problem, selection.who, time_limit_s)
    return _plan(selection, lead, began, time_limit_s, report)


def _plan(
    selection: Selection,
    lead: Lead | None,
    began: float,
    time_limit_s: float | None,
    report: Report,
) -> Plan:
    if not all(map(selection.feeders, selection.wanted)):
        return Plan(selection.who, Status.INFEASIBLE, reasons=unmet_reasons(selection.problem))
    program = Program(selection, lead)
    model = Model(program)
    model.add(program.one_of_alike())
    best, bound_us = (None, 0) if lead is None else (lead.plan, lead.bound_us)
    built_s = time.monotonic() - began
    rounds, nodes = 0, 0
    while best is None or bound_us < selection.cost_us(best):
        left_s = None if time_limit_s is None else time_limit_s - (time.monotonic() - began)
        if left_s is not None and left_s <= 0:
            break
        values, round_bound_us, round_nodes, solved = model.solve(left_s)
        chosen = None if values is None else [i for i in range(len(program.needs)) if values[i]]
        rounds, nodes, bound_us = rounds + 1, nodes + round_nodes, max(bound_us, round_bound_us)
        found = None if chosen is None else selection.plan_within(chosen)
        if found is not None:
            best = found
            bound_us = selection.cost_us(found) if solved else bound_us
        if report is not None:
            cost_us = None if best is None else selection.cost_us(best)
            report(Progress(time.monotonic() - began, cost_us, bound_us))
        if found is not None or not solved or chosen is None:
            break
        model.add(program.missed(chosen))
    counts = {"rounds": rounds, "nodes": nodes}
    seconds = {"build": built_s, "search": time.monotonic() - began - built_s}
    if lead is None and model.is_infeasible:
        return Plan(selection.who, Status.INFEASIBLE, seconds=seconds, counts=counts)
    return selection.answer(best, bound_us, seconds=seconds, counts=counts)


def _plan_numbers(counting: Counting, began: float, time_limit_s: float | None, report: Report) -> Plan:
    if reasons := unmet_reasons(counting.problem):
        return Plan(counting.who, Status.INFEASIBLE, reasons=reasons)
    program = NumberProgram(counting)
    model = Model(program)
    built_s = time.monotonic() - began
    values, bound_us, nodes, solved = model.solve(None if time_limit_s is None else max(0.01, time_limit_s - built_s))
    numbers = None if values is None else program.numbers(values)
    if numbers is not None and solved:
        bound_us = counting.plan_us(numbers)
    seconds = {"build": built_s, "search": time.monotonic() - began - built_s}
    if model.is_infeasible:
        return Plan(counting.who, Status.INFEASIBLE, seconds=seconds, counts={"nodes": nodes})
    if report is not None:
        report(Progress(time.monotonic() - began, None if numbers is None else counting.plan_us(numbers), bound_us))
    return counting.answer(numbers, bound_us, seconds=seconds, counts={"nodes": nodes})


class Model:
    """An integer program in HiGHS."""

    def __init__(self, program: Program | NumberProgram) -> None:
        import highspy  # not before `lead_apart` has made its process

        self.program, self._highspy = program, highspy
        self._highs = highspy.Highs()  # type: ignore[no-untyped-call]
        self._highs.silent()
        for option, value in {"threads": 1, "mip_rel_gap": 0.0, "mip_abs_gap": 0.5}.items():
            self._highs.setOptionValue(option, value)
        count = len(program.costs)
        columns = np.arange(count, dtype=np.int32)
        self._highs.addVars(count, np.zeros(count), np.array(program.most, dtype=float))
        self._highs.changeColsCost(count, columns, np.array(program.costs))
        whole = np.full(count, self._highspy.HighsVarType.kInteger.value, dtype=np.uint8)
        self._highs.changeColsIntegrality(count, columns, whole)
        self.add(program.rows)

    def add(self, rows: Rows) -> None:
        high = np.full(len(rows.low), self._highspy.kHighsInf)
        starts, columns = np.array(rows.starts, dtype=np.int32), np.array(rows.columns, dtype=np.int32)
        self._highs.addRows(
            len(rows.low), np.array(rows.low), high, len(columns), starts, columns, np.array(rows.values)
        )

    @property
    def is_infeasible(self) -> bool:
        """Return whether the engine has proven that the program is infeasible."""
        return bool(self._highs.getModelStatus() == self._highspy.HighsModelStatus.kInfeasible)

    def solve(self, left_s: float | None) -> tuple[list[int] | None, int, int, bool]:
        """Return the values of the best solution or None, a bound, the number of nodes, and whether optimality is
        proven.
        """
        self._highs.setOptionValue("time_limit", 1e9 if left_s is None else left_s)
        self._highs.run()
        info = self._highs.getInfo()
        solved = self._highs.getModelStatus() == self._highspy.HighsModelStatus.kOptimal
        bound = info.mip_dual_bound
        bound_us = max(0, ceil(bound - 1e-6 * max(1.0, abs(bound)))) * self.program.scale if abs(bound) < 1e300 else 0
        if info.primal_solution_status != self._highspy.SolutionStatus.kSolutionStatusFeasible:
            return None, bound_us, max(0, info.mip_node_count), False
        return list(map(round, self._highs.getSolution().col_value)), bound_us, max(0, info.mip_node_count), solved
