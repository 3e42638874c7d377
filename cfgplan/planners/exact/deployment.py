"""Plans made by counting: how many units of each group, then their hosts, then their wiring.

A unit that is told apart is the only one of its group.

Symmetric hosts are counted first. If the best numbers of units can be placed, the plan is proven; otherwise each host
is modelled separately.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from operator import attrgetter
from typing import NamedTuple

from ortools.sat.python.cp_model import (
    FEASIBLE,
    INFEASIBLE,
    OPTIMAL,
    CpSolver,
    CpSolverSolutionCallback,
    LinearExprT,
)

from cfgplan.domain import Objective
from cfgplan.planners.exact.candidates import Candidates, HostKind, HostName
from cfgplan.planners.exact.decode import decode_numbers
from cfgplan.planners.exact.groups import groups_of, host_kinds
from cfgplan.planners.exact.model import Model
from cfgplan.planners.exact.patterns import Patterns
from cfgplan.planners.exact.pruning import lean
from cfgplan.planners.exact.rounds import InfeasibleError, minimised
from cfgplan.planners.exact.rules import PLACED, RULES
from cfgplan.planners.exact.solve_state import SolveState
from cfgplan.planners.exact.wiring import named
from cfgplan.planners.networks.keys import Key
from cfgplan.planners.solving.clock import Clock, ContradictionError
from cfgplan.planners.solving.engine import repeatable_solver, solve
from cfgplan.planning import Feature


def plan_by_counting(candidates: Candidates, state: SolveState) -> None:
    """Count units until the best plan is proven or the time is over."""
    kinds = host_kinds(candidates)
    deployment = _Deployment(candidates, state)
    state.counts |= {"groups": len(deployment.groups), "kinds of hosts": len(kinds), "rounds": 0, "conflicts": 0}
    hosts, tuning = sum(len(kind.names) for kind in kinds), state.clock.tuning.fleet
    recounts = tuning.recounts if hosts > tuning.apart else 1
    for _ in range(recounts if hosts > len(kinds) else 0):
        known = len(deployment.infeasible)
        if deployment.count(kinds) or state.is_over:
            return
        if len(deployment.infeasible) == known:
            break
    deployment.count(deployment.apart(kinds))


@dataclass(frozen=True)
class _InfeasibleCounts:
    """Numbers of units, by their groups, that do not fit on so many hosts of a kind, which is known by its first."""

    kind: HostName
    hosts: int
    units: Mapping[int, int]
    company: frozenset[int]
    """The groups that others need beside them: with another number of these it may be otherwise."""

    def forbid(self, model: Model) -> None:
        """Demand other numbers: fewer units of some group, more hosts, or other company."""
        more = model.cp.new_bool_var("")
        model.cp.add(model.uses[self.kind] > self.hosts).only_enforce_if(more)
        ways = [more]
        for n, number in self.units.items():
            there = model.numbers_on[n][self.kind]
            for is_other in (there < number, there > number) if n in self.company else (there < number,):
                ways.append(model.cp.new_bool_var(""))
                model.cp.add(is_other).only_enforce_if(ways[-1])
        model.cp.add_bool_or(ways)


class _Step(NamedTuple):
    """One objective of the order: its expression, its value in a plan, and the callback that takes its proven bound."""

    what: LinearExprT
    value: Callable[[Key], int]
    learn: Callable[[int], None]


class _Placed(NamedTuple):
    """The hosts of each group's units if they fit. It `is_infeasible` if it is proven that they do not."""

    hosts: Mapping[int, Sequence[HostName]]
    is_fit: bool = False
    is_infeasible: bool = False


class _Deployment:
    def __init__(self, candidates: Candidates, state: SolveState) -> None:
        self.candidates, self.state = candidates, state
        self.groups = groups_of(candidates)
        self.infeasible: tuple[_InfeasibleCounts, ...] = ()
        """Numbers of units that are known not to fit."""
        self._patterns: dict[HostName, Patterns] = {}
        """Of kinds of several hosts, by their first, once something did not fit."""
        self._least = 0
        """The proven lower bound of the first objective."""

    def count(self, kinds: Sequence[HostKind]) -> bool:
        """Minimise the objectives one after the other. Returns whether each minimum is proven.

        If each kind is one host, each solution is a plan. Otherwise the best numbers have to be placed, and until then
        only the bound on the first objective is proven.
        """
        state, is_placed = self.state, all(kind.is_one for kind in kinds)
        model = Model(self.candidates.aggregated(self.groups, kinds), RULES) if is_placed else self._limited(kinds)
        state.counts["counts"] = len(model.cp.proto.variables)
        steps = list(self._steps(model))
        model.cp.add(steps[0].what >= self._least)
        if is_placed and state.best is not None:
            model.cp.add(steps[0].what <= steps[0].value(state.best.key))
            model.hint(state.best.units)
        values: Sequence[int] = ()
        proven: list[int] = []
        for number, step in enumerate(steps):
            learn = step.learn if is_placed or not number else lambda _: None
            try:
                found = self._minimise(model, step.what, values, learn, is_placed=is_placed)
            except InfeasibleError:
                state.prove_infeasible()
                return True
            if found is None:
                return False
            values, least = found
            self._least = self._least if number else least
            model.cp.add(step.what <= least)
            proven.append(least)
        if not is_placed and not self._offer(model, values):
            return False
        if state.best is None:
            raise ContradictionError("the numbers of units are those of no plan")
        for step, least in zip(steps, proven, strict=True):
            if step.value(state.best.key) > least:
                raise ContradictionError("a plan costs or changes more than the numbers of its units say")
            step.learn(least)
        state.prove_all()
        return True

    def _steps(self, model: Model) -> Iterator[_Step]:
        problem, state = self.candidates.problem, self.state
        if model.uses_required:
            unused = len(problem.environment.required) - model.total([*model.uses_required.values()])
            yield _Step(unused, attrgetter("unused"), state.raise_least_unused)
        named = problem.environment.minimise if Feature.ORDER in problem.features else ()
        for place, each in enumerate(named, 1):
            learn = partial(state.raise_bound_of, each)
            yield _Step(model.objective(each), partial(_of_order, place), learn)
        if Objective.COST not in named:
            yield _Step(model.objective(Objective.COST), attrgetter("cost_us"), state.raise_bound)
        is_running = any(candidate.running for candidate in model.candidates.all)
        for each in (Objective.REWIRED, Objective.STARTED) if is_running else (Objective.STARTED,):
            yield _Step(model.objective(each), attrgetter(each), partial(state.raise_bound_of, each))

    def _minimise(
        self,
        model: Model,
        what: LinearExprT,
        known: Sequence[int],
        learn: Callable[[int], None],
        *,
        is_placed: bool,
    ) -> tuple[Sequence[int], int] | None:
        """The best numbers and their value; None if the time is over before they are proven best.

        `known` are numbers to begin with, if there are any. `learn` is told bounds. Raises InfeasibleError.
        """
        clock = self.state.clock

        def solver() -> CpSolver:
            if known:
                model.cp.clear_hints()  # type: ignore[no-untyped-call]
            for index, value in enumerate(known):
                model.cp.add_hint(model.cp.get_int_var_from_proto_index(index), value)
            return _solver(model, clock)

        def look_at(solution: CpSolverSolutionCallback) -> bool:
            return not is_placed or self._offer(model, solution.response_proto.solution)

        def taken(solver: CpSolver, is_best: bool) -> tuple[Sequence[int], int | None] | None:
            values = list(solver.response_proto.solution)
            if is_best and self.infeasible and not is_placed and self._is_too_much(model, values):
                return None
            return values, int(solver.value(what)) if is_best else None

        found = minimised(model, what, self.state, solver=solver, look_at=look_at, learn=learn, taken=taken)
        if found is None or found[1] is None:
            return None
        return found[0], found[1]

    def _offer(self, model: Model, values: Sequence[int]) -> bool:
        """Offer the plan that numbers say, with more hosts if their units do not fit on so many; False then."""
        hosts_of: dict[int, list[HostName]] = defaultdict(list)
        is_fit = True
        for kind in model.candidates.hosts:
            here = {n: number for n, number in _on(model, values, kind.first).items() if number}
            used = _used(model, values, kind.first)
            placed = self._placed(kind, here, used)
            if not placed.is_fit:
                is_fit = False
                if placed.is_infeasible:
                    companions = self.candidates.environment.companions
                    company = {n for n in here if model.candidates.all[n].transformation.label in companions}
                    self.infeasible = (*self.infeasible, _InfeasibleCounts(kind.first, used, here, frozenset(company)))
                more = (self._placed(kind, here, n, has_more_company=True) for n in _more(used, len(kind.names)))
                placed = next((found for found in more if found.is_fit), placed)
                if not placed.is_fit:
                    return False
            for n, hosts in placed.hosts.items():
                hosts_of[n] += hosts
        units = decode_numbers(self.candidates, model, values, hosts_of)
        key = self.state.offer(self.candidates, named(self.candidates, lean(self.candidates, units)))
        return is_fit and key is not None

    def _placed(self, kind: HostKind, here: Mapping[int, int], used: int, *, has_more_company: bool = False) -> _Placed:
        """Place units of groups on so many hosts of a kind.

        With `has_more_company`, those that others run with may be more.
        """
        if kind.is_one or not here:
            return _Placed({n: [kind.first] * number for n, number in here.items()}, is_fit=True)
        clock = self.state.clock
        model = Model(self.candidates.aggregated([self.groups[n] for n in here], kind.apart()[:used]), PLACED)
        for n, units in enumerate(here.values()):
            label = model.candidates.all[n].transformation.label
            is_free = has_more_company and label in self.candidates.environment.companions
            model.cp.add(model.number[n] >= units if is_free else model.number[n] == units)
        solver = _solver(model, clock)
        solver.parameters.max_deterministic_time = clock.tuning.fleet.place
        status = solve(solver, model.cp, clock)
        if status not in (OPTIMAL, FEASIBLE):
            return _Placed({}, is_infeasible=status == INFEASIBLE)
        found = {
            n: [host for host, number in numbers.items() for _ in range(solver.value(number))]
            for n, numbers in zip(here, model.numbers_on.values(), strict=True)
        }
        return _Placed(found, is_fit=True)

    def _limited(self, kinds: Sequence[HostKind]) -> Model:
        """The model of kinds of hosts without the numbers of units that are known not to fit."""
        model = Model(self.candidates.aggregated(self.groups, kinds), RULES)
        for numbers in self.infeasible:
            numbers.forbid(model)
        for host, patterns in self._patterns.items():
            for weights in patterns.limits:
                weights.limit(model, host)
        return model

    def _is_too_much(self, model: Model, values: Sequence[int]) -> bool:
        """Whether patterns say that hosts of some kind can't have so many units; the model then gets the limits."""
        is_limited = False
        for kind in model.candidates.hosts:
            if not kind.is_one:
                if kind.first not in self._patterns:
                    self._patterns[kind.first] = Patterns(self.candidates, self.groups, kind)
                patterns, here = self._patterns[kind.first], _on(model, values, kind.first)
                if patterns.is_too_much(here, _used(model, values, kind.first), self.state.clock):
                    patterns.limits[-1].limit(model, kind.first)
                    is_limited = True
        return is_limited

    def apart(self, kinds: Sequence[HostKind]) -> list[HostKind]:
        """Split kinds into single hosts, as many of each kind as a plan no worse than the incumbent may use."""
        found: list[HostKind] = []
        for kind in kinds:
            most = len(kind.names)
            if most > 1 and self.state.best is not None:
                model = self._limited(kinds)
                first = next(self._steps(model))
                model.cp.add(first.what <= first.value(self.state.best.key))
                model.cp.maximize(model.uses[kind.first])
                solver = _solver(model, self.state.clock)
                if solve(solver, model.cp, self.state.clock) == OPTIMAL:
                    most = solver.value(model.uses[kind.first])
            found += kind.apart()[:most]
        return found


def _on(model: Model, values: Sequence[int], host: HostName) -> dict[int, int]:
    """How many units of each group are on hosts of a kind."""
    return {n: values[there[host].index] for n, there in model.numbers_on.items() if host in there}


def _used(model: Model, values: Sequence[int], host: HostName) -> int:
    """On how many hosts of a kind there are units."""
    return values[model.uses[host].index] if host in model.uses else 1


def _more(used: int, most: int) -> Iterator[int]:
    """A number of hosts, and more and more of them up to the most."""
    step = 0
    while used + step < most:
        yield used + step
        step = 2 * step or 1
    yield most


def _of_order(place: int, key: Key) -> int:
    """The value of a plan's n-th objective; the first is number 1."""
    return key.first[place]


def _solver(model: Model, clock: Clock) -> CpSolver:
    size, tuning = len(model.cp.proto.variables), clock.tuning
    solver = repeatable_solver(
        small=size < tuning.fleet.small, tiny=size < tuning.solve.tiny, time_limit_s=clock.left_s()
    )
    solver.parameters.cut_level = 1
    return solver
