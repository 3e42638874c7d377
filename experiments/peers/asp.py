"""clingo: answer sets are grounded by definition, so the rules below are the whole problem."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from math import gcd

import clingo

from cfgplan.errors import InputError
from cfgplan.planning import Plan, Problem, Progress, Status
from cfgplan.reasons import unmet_reasons
from experiments.peers.lead import Lead, lead_apart
from experiments.peers.selection import Selection

RULES = """
{ run(U) } :- unit(U), fed(T) : needs(U, T); fed_port(U, P) : picky(U, P, T).
fed(T) :- run(U), gives(U, T).
:- wanted(T), not fed(T).
:- kept(U), not run(U).
:- run(U), needs_back(U, T), not fed(T).

% Ports of a distinct group choose a transformation each.
alive(L) :- run(U), label(U, L).
offers(T, L) :- gives(U, T), label(U, L).
{ feed(U, P, L) } :- picky(U, P, T), offers(T, L), alive(L).
{ feed(U, P, L) } :- picky_back(U, P, T), offers(T, L), alive(L).
fed_port(U, P) :- feed(U, P, L).
:- run(U), picky_back(U, P, T), not fed_port(U, P).
:- feed(U, P, L), feed(U, Q, L), P < Q, group(U, P, G), group(U, Q, G).

#minimize { C, U : run(U), cost(U, C) }.
#show run/1.
"""
CORES = "usc,one,stratify"
LARGEST_WEIGHT = 2**31 - 1
CHEAP_FIRST = ("--opt-heuristic=sign,model",)
"""Without this its first plans run most of the library: a hundred times dearer with 50,000 transformations."""


def plan_by_cores(
    problem: Problem, *, time_limit_s: float | None = None, report: Callable[[Progress], None] | None = None
) -> Plan:
    """Optimisation from below, by unsatisfiable cores, large weights first: without that it is many times slower."""
    return _plan("clingo-usc", CORES, problem, time_limit_s, report)


def plan_by_cores_led(
    problem: Problem, *, time_limit_s: float | None = None, report: Callable[[Progress], None] | None = None
) -> Plan:
    """The same after `cpsat`'s bounds: with its landmarks, below the cost of its plan, and only what these leave."""
    return _plan("clingo-usc-led", CORES, problem, time_limit_s, report, is_led=True)


def plan_by_branching(
    problem: Problem, *, time_limit_s: float | None = None, report: Callable[[Progress], None] | None = None
) -> Plan:
    """Optimisation from above, by branch-and-bound."""
    return _plan("clingo-bb", "bb", problem, time_limit_s, report)


def _plan(
    who: str,
    strategy: str,
    problem: Problem,
    time_limit_s: float | None,
    report: Callable[[Progress], None] | None,
    *,
    is_led: bool = False,
) -> Plan:
    began = time.monotonic()
    selection = Selection(problem, who)
    if not all(map(selection.feeders, selection.wanted)):
        return Plan(who, Status.INFEASIBLE, reasons=unmet_reasons(problem))
    scale = gcd(*(candidate.cost_us for candidate in selection.candidates)) or 1
    if any(candidate.cost_us // scale > LARGEST_WEIGHT for candidate in selection.candidates):
        raise InputError.of(f"{who} counts in 32 bits, and a cost is too large for it")
    lead = lead_apart(problem, who, time_limit_s) if is_led else Lead(None, 0, [], [])
    best, bound_us = lead.plan, lead.bound_us
    known = [] if best is None else [f"--opt-mode=opt,{selection.cost_us(best) // scale}"]
    control = clingo.Control([f"--opt-strategy={strategy}", *CHEAP_FIRST, *known, "--models=0", "--warn=none"])
    control.add("base", [], RULES + "\n".join((*_facts(selection, scale), *_known(lead))))
    control.ground([("base", [])])
    built_s = time.monotonic() - began

    def tell() -> None:
        if report is not None:
            cost_us = None if best is None else selection.cost_us(best)
            report(Progress(time.monotonic() - began, cost_us, bound_us))

    def on_model(model: clingo.Model) -> None:
        nonlocal best
        best = [symbol.arguments[0].number for symbol in model.symbols(shown=True)]
        tell()

    def on_unsat(lower: Sequence[int]) -> None:
        nonlocal bound_us
        if lower and lower[0] * scale > bound_us:
            bound_us = lower[0] * scale
            tell()

    with control.solve(on_model=on_model, on_unsat=on_unsat, async_=True) as handle:
        handle.wait(None if time_limit_s is None else max(0.0, time_limit_s - (time.monotonic() - began)))
        handle.cancel()
        if handle.get().exhausted and best is not None:  # with a lead, its plan is the best if there was no model
            bound_us = selection.cost_us(best)
    solving = control.statistics["solving"]["solvers"]
    counts = {"choices": int(solving["choices"]), "conflicts": int(solving["conflicts"])}
    seconds = {"build": built_s, "search": time.monotonic() - began - built_s}
    return selection.answer(best, bound_us, seconds=seconds, counts=counts)


def _facts(selection: Selection, scale: int) -> Iterator[str]:
    """Units and tags are numbers; so are labels, ports and groups. Labels matter only to distinct groups."""
    numbers: dict[str, int] = {}

    def number(name: str) -> int:
        return numbers.setdefault(name, len(numbers))

    def use(tag: str) -> int:
        if tag not in used:
            used[tag] = number(f"tag {tag}")
        return used[tag]

    used: dict[str, int] = {}
    picky = any(p.distinct is not None for c in selection.candidates for p in c.transformation.inputs)
    for i, candidate in enumerate(selection.candidates):
        yield f"unit({i}). cost({i},{candidate.cost_us // scale})."
        if picky:
            yield f"label({i},{number(candidate.transformation.label)})."
        for port in candidate.transformation.inputs:
            back = "_back" if port.feedback else ""
            yield f"needs{back}({i},{use(port.tag)})."
            if port.distinct is not None:
                name, group = number(f"port {port.name}"), number(f"group {port.distinct}")
                yield f"picky{back}({i},{name},{use(port.tag)}). group({i},{name},{group})."
    yield from (f"wanted({use(tag)})." for tag in selection.wanted)
    yield from (f"kept({i})." for i in sorted(selection.kept))
    for tag, tag_number in used.items():
        yield from (f"gives({i},{tag_number})." for i in selection.feeders(tag))


def _known(lead: Lead) -> Iterator[str]:
    for least, members in lead.landmarks:
        yield f":- #sum {{ {'; '.join(f'{n},{i} : run({i})' for i, n in members.items())} }} < {least}."
    yield from (f":- run({i})." for i in lead.dropped)
