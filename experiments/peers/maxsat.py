"""The peer RC2 of PySAT: MaxSAT by unsatisfiable cores, with landmarks added after each solution that is not grounded.

Every cost is the weight of a soft clause. Hosts and feedback inputs are not supported.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Timer

from pysat.card import CardEnc, EncType  # type: ignore[import-untyped, unused-ignore]
from pysat.examples.rc2 import RC2, RC2Stratified  # type: ignore[import-untyped, unused-ignore]
from pysat.formula import WCNF  # type: ignore[import-untyped, unused-ignore]

from cfgplan.planning import Plan, Problem, Progress, Status
from cfgplan.reasons import unmet_reasons
from experiments.peers.program import Program, Rows
from experiments.peers.selection import Selection

Report = Callable[[Progress], None] | None


def plan(problem: Problem, *, time_limit_s: float | None = None, report: Report = None) -> Plan:
    """Return the cheapest update. Raises InputError for feedback inputs and hosts. See `planning.Planner`."""
    return _plan(Selection(problem, "rc2"), _Anytime, time_limit_s, report)


def plan_stratified(problem: Problem, *, time_limit_s: float | None = None, report: Report = None) -> Plan:
    """Return the cheapest update; the dearest units come into the formula first. See `plan`."""
    return _plan(Selection(problem, "rc2-stratified"), _Stratified, time_limit_s, report)


def _plan(selection: Selection, engine: type[_Anytime], time_limit_s: float | None, report: Report) -> Plan:
    began = time.monotonic()
    if not all(map(selection.feeders, selection.wanted)):
        return Plan(selection.who, Status.INFEASIBLE, reasons=unmet_reasons(selection.problem))
    program = Program(selection, None)
    best: list[int] | None = None
    bound_us = rounds = 0

    def raise_bound(cost: int) -> None:
        nonlocal bound_us
        bound_us = cost * program.scale
        if report is not None:
            report(Progress(time.monotonic() - began, None, bound_us))

    with engine(_formula(program), raise_bound) as solver:
        built_s = time.monotonic() - began
        with _alarm(None if time_limit_s is None else time_limit_s - built_s, solver):
            while best is None and (chosen := solver.optimum(len(program.needs))) is not None:
                rounds += 1
                best = selection.plan_within(chosen)
                for clause in () if best is not None else _clauses(program.missed(chosen), solver.variables):
                    solver.add_clause(clause)
        is_infeasible = best is None and not solver.is_late
    seconds, counts = {"build": built_s, "search": time.monotonic() - began - built_s}, {"rounds": rounds}
    if is_infeasible:
        return Plan(selection.who, Status.INFEASIBLE, seconds=seconds, counts=counts)
    if best is not None:
        bound_us = selection.cost_us(best)
    return selection.answer(best, bound_us, seconds=seconds, counts=counts)


@contextmanager
def _alarm(left_s: float | None, solver: _Anytime) -> Iterator[None]:
    """Stop the solver when the time is over."""
    if left_s is None:
        yield
        return
    timer = Timer(max(0.0, left_s), solver.stop)
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


class _Anytime(RC2):  # type: ignore[misc, unused-ignore]
    """RC2 that tells each bound and can be stopped at any time."""

    def __init__(self, formula: WCNF, tell: Callable[[int], None], **options: bool) -> None:
        self.is_late, self._tell = False, tell
        self.variables = formula.nv
        super().__init__(formula, adapt=True, exhaust=True, minz=True, **options)

    def optimum(self, count: int) -> list[int] | None:
        """Return which of the first `count` variables are true in an optimum; None without one, or if stopped."""
        if self.is_late:
            return None
        values = self.compute()
        return None if values is None or self.is_late else [i for i in range(count) if values[i] > 0]

    def stop(self) -> None:
        self.is_late = True
        self.interrupt()

    def process_core(self) -> None:
        super().process_core()
        self.interrupted = self.interrupted or self.is_late
        if not self.is_late:  # the cost of a core whose exhaustion was stopped is no bound
            self._tell(self.cost)

    def _call_oracle(self, assumptions: list[int], **_: bool) -> bool | None:
        """Whether the assumptions can hold; None if stopped. Each question can be stopped: RC2 asks that of some."""
        answer: bool | None = super()._call_oracle(assumptions, expect_interrupt=True)
        return answer


class _Stratified(_Anytime, RC2Stratified):  # type: ignore[misc, unused-ignore]
    """The same by strata of weights. None is hardened, since an upper bound may come from an ungrounded solution."""

    def __init__(self, formula: WCNF, tell: Callable[[int], None]) -> None:
        super().__init__(formula, tell, nohard=True)


def _formula(program: Program) -> WCNF:
    """The program's columns as variables, from 1 on; a soft clause for each cost."""
    formula = WCNF()
    for clause in _clauses(program.rows, len(program.costs)):
        formula.append(clause)
    for column, cost in enumerate(program.costs):
        if cost:
            formula.append([-column - 1], weight=round(cost))
    return formula


def _clauses(rows: Rows, variables: int) -> Iterator[list[int]]:
    """Yield the rows as clauses; a row is one, or lets one be true at most. Variables above `variables` are new."""
    for low, columns, values in rows.each():
        literals = [column + 1 if value > 0 else -column - 1 for column, value in zip(columns, values, strict=True)]
        least = round(low) + sum(value < 0 for value in values)
        if least == 1:
            yield literals
        elif least == len(literals) - 1:
            encoded = CardEnc.atmost([-literal for literal in literals], top_id=variables, encoding=EncType.seqcounter)
            variables = max(variables, encoded.nv)
            yield from encoded.clauses
        else:
            raise AssertionError("a row of a plain problem is a clause, or lets one be true at most")
