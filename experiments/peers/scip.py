"""The peer SCIP, with landmarks as lazy constraints, which cut off ungrounded solutions within a single search.

It computes in doubles; the plan's cost is recomputed exactly.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from math import ceil
from typing import Any

import pyscipopt  # type: ignore[import-not-found, unused-ignore]

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
        return _plan_numbers(Counting(problem, "scip"), began, time_limit_s, report)
    return _plan(selection_of(problem, "scip"), None, began, time_limit_s, report)


def plan_led(problem: Problem, *, time_limit_s: float | None = None, report: Report = None) -> Plan:
    """Return the cheapest update, using the landmarks, the plan and the remaining candidates of `cpsat`."""
    began = time.monotonic()
    selection = Selection(problem, "scip-led")
    lead = lead_apart(problem, selection.who, time_limit_s)
    return _plan(selection, lead, began, time_limit_s, report)


def _plan(selection: Selection, lead: Lead | None, began: float, time_limit_s: float | None, report: Report) -> Plan:
    if not all(map(selection.feeders, selection.wanted)):
        return Plan(selection.who, Status.INFEASIBLE, reasons=unmet_reasons(selection.problem))
    program = Program(selection, lead)
    best, bound_us = (None, 0) if lead is None else (lead.plan, lead.bound_us)
    seconds, counts = {"build": time.monotonic() - began}, {"nodes": 0, "landmarks": 0}
    if best is None or bound_us < selection.cost_us(best):
        model = _model(program)
        grounded = _Grounded(program, model.getVars())
        model.includeConshdlr(
            grounded, "grounded", "", enfopriority=-10, chckpriority=-10, needscons=False, sepafreq=-1, eagerfreq=-1
        )
        if best is not None:
            first = model.createPartialSol()
            for i, variable in enumerate(grounded.variables[: len(program.needs)]):
                model.setSolVal(first, variable, float(i in set(best)))
            model.addSol(first)
            model.setObjlimit(selection.cost_us(best) / program.scale - 0.5)
        seconds["build"] = time.monotonic() - began
        if time_limit_s is not None:
            model.setParam("limits/time", max(0.01, time_limit_s - seconds["build"]))
        model.optimizeNogil()
        found = _chosen(program, model)
        best = best if found is None else found
        is_proven = best is not None and model.getStatus() in ("optimal", "infeasible")
        bound_us = selection.cost_us(best or ()) if is_proven else max(bound_us, _bound_us(program, model))
        counts = {"nodes": int(model.getNTotalNodes()), "landmarks": grounded.landmarks}
        if best is None and lead is None and model.getStatus() == "infeasible":
            seconds["search"] = time.monotonic() - began - seconds["build"]
            return Plan(selection.who, Status.INFEASIBLE, seconds=seconds, counts=counts)
    if report is not None:
        report(Progress(time.monotonic() - began, None if best is None else selection.cost_us(best), bound_us))
    seconds["search"] = time.monotonic() - began - seconds["build"]
    return selection.answer(best, bound_us, seconds=seconds, counts=counts)


def _plan_numbers(counting: Counting, began: float, time_limit_s: float | None, report: Report) -> Plan:
    if reasons := unmet_reasons(counting.problem):
        return Plan(counting.who, Status.INFEASIBLE, reasons=reasons)
    program = NumberProgram(counting)
    model, variables = _plain_model(program)
    built_s = time.monotonic() - began
    if time_limit_s is not None:
        model.setParam("limits/time", max(0.01, time_limit_s - built_s))
    model.optimizeNogil()
    seconds = {"build": built_s, "search": time.monotonic() - began - built_s}
    counts = {"nodes": int(model.getNTotalNodes())}
    if model.getStatus() == "infeasible":
        return Plan(counting.who, Status.INFEASIBLE, seconds=seconds, counts=counts)
    numbers, bound_us = None, _bound_us(program, model)
    if model.getNSols():
        best = model.getBestSol()
        numbers = program.numbers([model.getSolVal(best, variable) for variable in variables])
        bound_us = counting.plan_us(numbers) if model.getStatus() == "optimal" else bound_us
    if report is not None:
        report(Progress(time.monotonic() - began, None if numbers is None else counting.plan_us(numbers), bound_us))
    return counting.answer(numbers, bound_us, seconds=seconds, counts=counts)


def _plain_model(program: Program | NumberProgram) -> tuple[Any, list[Any]]:
    """The model, and the variables in the program's order: SCIP has those that are 0 or 1 first."""
    model = pyscipopt.Model()
    model.hideOutput()
    columns = zip(program.costs, program.most, strict=True)
    variables = [model.addVar(vtype="I" if most > 1 else "B", ub=most, obj=cost) for cost, most in columns]
    _add(model, variables, program.rows)
    model.setParam("parallel/maxnthreads", 1)
    return model, variables


def _model(program: Program) -> Any:
    model, _ = _plain_model(program)
    # Rules about the present rows alone would cut off solutions, or fix variables, that landmarks to come allow.
    model.setParam("misc/allowstrongdualreds", False)
    model.setParam("misc/allowweakdualreds", False)
    return model


def _add(model: Any, variables: Any, rows: Rows) -> None:
    for low, columns, values in rows.each():
        terms = (value * variables[i] for i, value in zip(columns, values, strict=True))
        model.addCons(pyscipopt.quicksum(terms) >= low)


def _chosen(program: Program, model: Any) -> list[int] | None:
    if model.getNSols() == 0:
        return None
    solution, variables = model.getBestSol(), model.getVars()
    chosen = [i for i in range(len(program.needs)) if model.getSolVal(solution, variables[i]) > 0.5]
    return program.selection.plan_within(chosen)


def _bound_us(program: Program | NumberProgram, model: Any) -> int:
    bound = float(model.getDualbound())
    return max(0, ceil(bound - 1e-6 * max(1.0, abs(bound)))) * program.scale if abs(bound) < 1e19 else 0


class _Grounded(pyscipopt.Conshdlr):  # type: ignore[misc]
    """Everything that runs is fed from sources in the end. The names of its methods are SCIP's."""

    def __init__(self, program: Program, variables: Any) -> None:
        self.program, self.variables, self.landmarks = program, variables, 0

    def conscheck(self, _constraints: Any, solution: Any, *_more: Any, **_named: Any) -> dict[str, Any]:
        return {"result": self._result(self._missed(solution) is None)}

    def consenfolp(self, *_more: Any, **_named: Any) -> dict[str, Any]:
        return self._cut_off()

    def consenfops(self, *_more: Any, **_named: Any) -> dict[str, Any]:
        return {"result": self._result(self._missed(None) is None)}

    def conslock(self, _constraint: Any, _kind: Any, positive: int, negative: int) -> None:
        for variable in self.variables[: len(self.program.needs)]:
            self.model.addVarLocks(variable, positive + negative, positive + negative)

    def _cut_off(self) -> dict[str, Any]:
        missed = self._missed(None)
        if missed is None:
            return {"result": pyscipopt.SCIP_RESULT.FEASIBLE}
        _add(self.model, self.variables, missed)
        self.landmarks += len(missed.low)
        return {"result": pyscipopt.SCIP_RESULT.CONSADDED}

    def _result(self, is_kept: bool) -> Any:
        return pyscipopt.SCIP_RESULT.FEASIBLE if is_kept else pyscipopt.SCIP_RESULT.INFEASIBLE

    def _missed(self, solution: Any) -> Rows | None:
        count = len(self.program.needs)
        chosen = [i for i in range(count) if self.model.getSolVal(solution, self.variables[i]) > 0.5]
        return self.program.missed(chosen) if self.program.selection.plan_within(chosen) is None else None
