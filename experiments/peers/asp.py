"""The peer clingo. Answer sets are grounded by definition, so that the rules below are the whole problem."""

from __future__ import annotations

import json
import time
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from math import gcd
from typing import NamedTuple

import clingo

from cfgplan.errors import InputError
from cfgplan.planning import Plan, Problem, Progress, Status
from cfgplan.reasons import unmet_reasons
from experiments.peers.counting import Counting, is_counted
from experiments.peers.lead import Lead, lead_apart
from experiments.peers.placing import selection_of
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
NUMBERS = """
% at(L, H, N): at least N units of L are on H.
{ at(L, H, 1..M) } :- most(L, H, M).
:- at(L, H, N), N > 1, not at(L, H, N - 1).
has(L, H) :- at(L, H, 1).
used(H) :- has(L, H).
runs(L) :- has(L, H).
:- least(L, M), #count { H, N : at(L, H, N) } < M.
:- greatest(L, M), #count { H, N : at(L, H, N) } > M.
:- room(H, R, M), #sum { A, L, N : at(L, H, N), takes(L, H, R, A) } > M.
:- conflict(L, O), runs(L), runs(O).
:- conflict_on_host(L, O), has(L, H), has(O, H).
:- beside(L, O), has(L, H), not has(O, H).

% Targets, and inputs with their number of streams; whom limited streams feed.
:- wanted(T), not runs(O) : gives(O, T).
:- needs(L, T, K), runs(L), #count { O, H, N : at(O, H, N), gives(O, T) } < K.
:- serves(O, P, M), #sum { K, L, I, H, N : at(L, H, N), taker(O, P, L, I, K); K, 0, I : targets(O, P, I, K);
                           -M, O, H, N : at(O, H, N) } > 0.

% Of hosts alike the first ones are used.
:- next(G, H), used(H), not used(G).

#minimize { C, L, H, N : at(L, H, N), cost(L, H, C); C, H : used(H), rent(H, C) }.
#show at/3.
"""
CORES = "usc,one,stratify"
LARGEST_WEIGHT = 2**31 - 1
CHEAP_FIRST = ("--opt-heuristic=sign,model",)
"""Without this its first plans run most of the library: a hundred times dearer with 50,000 transformations."""


def plan_by_cores(
    problem: Problem, *, time_limit_s: float | None = None, report: Callable[[Progress], None] | None = None
) -> Plan:
    """Minimise the cost from below, by unsatisfiable cores; stratification makes it many times faster."""
    return _plan("clingo-usc", CORES, problem, time_limit_s, report)


def plan_by_cores_led(
    problem: Problem, *, time_limit_s: float | None = None, report: Callable[[Progress], None] | None = None
) -> Plan:
    """Minimise by cores with the landmarks of `cpsat`, its cost as a limit, and only its remaining candidates."""
    return _plan("clingo-usc-led", CORES, problem, time_limit_s, report, is_led=True)


def plan_by_branching(
    problem: Problem, *, time_limit_s: float | None = None, report: Callable[[Progress], None] | None = None
) -> Plan:
    """Minimise the cost from above, by branch-and-bound."""
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
    if not is_led and is_counted(problem):
        return _plan_numbers(Counting(problem, who), strategy, began, time_limit_s, report)
    selection = Selection(problem, who) if is_led else selection_of(problem, who)
    if not all(map(selection.feeders, selection.wanted)):
        return Plan(who, Status.INFEASIBLE, reasons=unmet_reasons(problem))
    scale = _scale(who, [candidate.cost_us for candidate in selection.candidates])
    lead = lead_apart(problem, who, time_limit_s) if is_led else Lead(None, 0, [], [])
    best, best_us = lead.plan, None if lead.plan is None else selection.cost_us(lead.plan)
    control = _control(strategy, None if best_us is None else best_us // scale)
    control.add("base", [], RULES + "\n".join((*_facts(selection, scale), *_known(lead))))
    found = _optimum(control, scale, best_us, lead.bound_us, began, time_limit_s, report)
    if found.is_infeasible and not is_led:
        return Plan(who, Status.INFEASIBLE, seconds=found.seconds, counts=found.counts)
    if found.shown is not None:
        best = [symbol.arguments[0].number for symbol in found.shown]
    return selection.answer(best, found.bound_us, seconds=found.seconds, counts=found.counts)


def _plan_numbers(
    counting: Counting,
    strategy: str,
    began: float,
    time_limit_s: float | None,
    report: Callable[[Progress], None] | None,
) -> Plan:
    if reasons := unmet_reasons(counting.problem):
        return Plan(counting.who, Status.INFEASIBLE, reasons=reasons)
    scale = _scale(counting.who, [*map(counting.cost_us, counting.most), *counting.rents_us.values()])
    control = _control(strategy)
    control.add("base", [], NUMBERS + "\n".join(_facts_of_numbers(counting, scale)))
    found = _optimum(control, scale, None, 0, began, time_limit_s, report)
    if found.is_infeasible:
        return Plan(counting.who, Status.INFEASIBLE, seconds=found.seconds, counts=found.counts)
    numbers = None
    if found.shown is not None:
        numbers = Counter((symbol.arguments[0].string, symbol.arguments[1].string) for symbol in found.shown)
    return counting.answer(numbers, found.bound_us, seconds=found.seconds, counts=found.counts)


def _scale(who: str, costs: Collection[int]) -> int:
    scale = gcd(*costs) or 1
    if max(costs, default=0) // scale > LARGEST_WEIGHT:
        raise InputError.of(f"{who} counts in 32 bits, and a cost is too large for it")
    return scale


def _control(strategy: str, best: int | None = None) -> clingo.Control:
    known = [] if best is None else [f"--opt-mode=opt,{best}"]
    return clingo.Control([f"--opt-strategy={strategy}", *CHEAP_FIRST, *known, "--models=0", "--warn=none"])


class _Found(NamedTuple):
    """The atoms of the best model (None without one), which may be proven optimal; `bound_us` is proven."""

    shown: Sequence[clingo.Symbol] | None
    is_infeasible: bool
    bound_us: int
    seconds: dict[str, float]
    counts: dict[str, int]


def _optimum(
    control: clingo.Control,
    scale: int,
    best_us: int | None,
    bound_us: int,
    began: float,
    time_limit_s: float | None,
    report: Callable[[Progress], None] | None,
) -> _Found:
    """Ground and solve; a plan of `best_us` may be known before."""
    control.ground([("base", [])])
    built_s = time.monotonic() - began
    shown: Sequence[clingo.Symbol] | None = None

    def tell() -> None:
        if report is not None:
            report(Progress(time.monotonic() - began, best_us, bound_us))

    def on_model(model: clingo.Model) -> None:
        nonlocal shown, best_us
        shown, best_us = model.symbols(shown=True), sum(model.cost) * scale
        tell()

    def on_unsat(lower: Sequence[int]) -> None:
        nonlocal bound_us
        if lower and lower[0] * scale > bound_us:
            bound_us = lower[0] * scale
            tell()

    with control.solve(on_model=on_model, on_unsat=on_unsat, async_=True) as handle:
        handle.wait(None if time_limit_s is None else max(0.0, time_limit_s - (time.monotonic() - began)))
        handle.cancel()
        is_over = bool(handle.get().exhausted)
    if is_over and best_us is not None:  # with a lead, its plan is the best if there was no model
        bound_us = best_us
    solving = control.statistics["solving"]["solvers"]
    counts = {"choices": int(solving["choices"]), "conflicts": int(solving["conflicts"])}
    is_infeasible = is_over and best_us is None
    return _Found(
        shown, is_infeasible, bound_us, {"build": built_s, "search": time.monotonic() - began - built_s}, counts
    )


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
    for limit in selection.limits:
        yield f":- #sum {{ {'; '.join(f'{n},{i} : run({i})' for i, n in limit.takes.items())} }} > {limit.most}."
    for tag, tag_number in used.items():
        yield from (f"gives({i},{tag_number})." for i in selection.feeders(tag))


def _known(lead: Lead) -> Iterator[str]:
    for least, members in lead.landmarks:
        yield f":- #sum {{ {'; '.join(f'{n},{i} : run({i})' for i, n in members.items())} }} < {least}."
    yield from (f":- run({i})." for i in lead.dropped)


def _facts_of_numbers(counting: Counting, scale: int) -> Iterator[str]:
    environment = counting.problem.environment

    def fact(name: str, *parts: str | int) -> str:
        return f"{name}({','.join(json.dumps(part, ensure_ascii=False) for part in parts)})."

    for (label, host), most in counting.most.items():
        yield fact("most", label, host, most) + fact("cost", label, host, counting.cost_us((label, host)) // scale)
        yield from (fact("takes", label, host, *taken) for taken in counting.takes((label, host)).items())
    for host, rent_us in counting.rents_us.items():
        yield fact("rent", host, rent_us // scale)
        rooms = {each: counting.room(host, each) for each in counting.resources}
        yield from (fact("room", host, each, room) for each, room in rooms.items() if room is not None)
    yield from (fact("next", *hosts) for hosts in counting.alike())
    for label, units in counting.kinds.items():
        kind = counting.kind(label)
        yield fact("least", label, kind.min_instances) + fact("greatest", label, len(units))
        for name in ("conflict", "conflict_on_host", "beside"):
            yield from (fact(name, label, other) for other in counting.company(label)[name])
        yield from (fact("needs", label, port.tag, port.count) for port in kind.inputs)
    for tag in sorted(counting.tags):
        yield from (fact("gives", label, tag) for label, _ in counting.providers(tag))
    yield from (fact("wanted", target.tag) for target in environment.targets)
    for provider, most in counting.limited():
        yield fact("serves", *provider, most)
        for number, (label, count) in enumerate(counting.takers(provider)):
            yield fact("taker", *provider, label, number, count) if label else fact("targets", *provider, number, count)
