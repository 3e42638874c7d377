"""Plans made by counting: how many units of each group, then their hosts, then their wiring.

Symmetric hosts are counted first. If the best numbers of units can be placed, the plan is proven; otherwise each host
is modelled separately.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from math import ceil
from operator import attrgetter
from typing import NamedTuple

from ortools.sat.python.cp_model import (
    FEASIBLE,
    INFEASIBLE,
    MODEL_INVALID,
    OPTIMAL,
    CpSolver,
    CpSolverSolutionCallback,
    LinearExpr,
)

from cfgplan.domain import Objective
from cfgplan.planners.exact.candidates import Candidates, HostName
from cfgplan.planners.exact.counted_wiring import CountedWiring
from cfgplan.planners.exact.counting import PLACED, CountingModel, Misfit
from cfgplan.planners.exact.decode import named
from cfgplan.planners.exact.groups import Group, HostKind, groups_of, host_kinds
from cfgplan.planners.exact.patterns import Patterns
from cfgplan.planners.exact.pruning import lean
from cfgplan.planners.exact.standing import Standing
from cfgplan.planners.networks.keys import Key
from cfgplan.planners.solving.clock import Clock, ContradictionError
from cfgplan.planners.solving.engine import repeatable_solver, solve
from cfgplan.planning import Feature


def plan_by_counting(candidates: Candidates, standing: Standing) -> None:
    """Count units until the best plan is proven or the time is over."""
    groups = groups_of(candidates)
    kinds = host_kinds(candidates, groups)
    standing.counts |= {"groups": len(groups), "kinds of hosts": len(kinds), "rounds": 0, "conflicts": 0}
    deployment = _Deployment(candidates, standing, groups)
    hosts, tuning = sum(len(kind.names) for kind in kinds), standing.clock.tuning.fleet
    recounts = tuning.recounts if hosts > tuning.apart else 1
    for _ in range(recounts if hosts > len(kinds) else 0):
        known = len(deployment.misfits)
        if deployment.count(kinds) or standing.is_over:
            return
        if len(deployment.misfits) == known:
            break
    deployment.count(deployment.apart(kinds))


class _Step(NamedTuple):
    """One objective of the order: its expression, its value in a plan, and the callback that takes its proven bound."""

    what: LinearExpr
    value: Callable[[Key], int]
    learn: Callable[[int], None]


class _Placed(NamedTuple):
    """The hosts of each group's units if they fit. It `is_misfit` if it is proven that they do not."""

    hosts: Mapping[int, Sequence[HostName]]
    is_fit: bool = False
    is_misfit: bool = False


class _Deployment:
    def __init__(self, candidates: Candidates, standing: Standing, groups: Sequence[Group]) -> None:
        self.candidates, self.standing, self.groups = candidates, standing, groups
        self.misfits: tuple[Misfit, ...] = ()
        """Numbers of units that are known not to fit."""
        self._patterns: dict[int, Patterns] = {}
        """Of kinds of several hosts, by their numbers, once something did not fit."""
        self._least = 0
        """The proven lower bound of the first objective."""

    def count(self, kinds: Sequence[HostKind]) -> bool:
        """Minimise the objectives one after the other. Returns whether each minimum is proven.

        If each kind is one host, each solution is a plan. Otherwise the best numbers have to be placed, and until then
        only the bound on the first objective is proven.
        """
        standing, is_placed = self.standing, all(len(kind.names) == 1 for kind in kinds)
        counts = CountingModel(self.candidates, self.groups, kinds) if is_placed else self._alike(kinds)
        standing.counts["counts"] = len(counts.cp.proto.variables)
        steps = list(self._steps(counts))
        counts.cp.add(steps[0].what >= self._least)
        if is_placed and standing.best is not None:
            counts.cp.add(steps[0].what <= steps[0].value(standing.best.key))
            self._hint(counts)
        values: Sequence[int] = ()
        proven: list[int] = []
        for number, step in enumerate(steps):
            learn = step.learn if is_placed or not number else lambda _: None
            found = self._minimise(counts, step.what, values, learn, is_placed=is_placed)
            if found is None:
                return standing.is_infeasible
            values, least = found
            self._least = self._least if number else least
            counts.cp.add(step.what <= least)
            proven.append(least)
        if not is_placed and not self._offer(counts, values):
            return False
        if standing.best is None:
            raise ContradictionError("the numbers of units are those of no plan")
        for step, least in zip(steps, proven, strict=True):
            if step.value(standing.best.key) > least:
                raise ContradictionError("a plan costs or changes more than the numbers of its units say")
            step.learn(least)
        standing.prove_all()
        return True

    def _steps(self, counts: CountingModel) -> Iterator[_Step]:
        problem, standing = self.candidates.problem, self.standing
        named = problem.environment.minimise if Feature.ORDER in problem.features else ()
        for place, each in enumerate(named, 1):
            learn = partial(standing.raise_bound_of, each)
            yield _Step(counts.objective(each), partial(_of_order, place), learn)
        if Objective.COST not in named:
            yield _Step(counts.objective(Objective.COST), attrgetter("cost_us"), standing.raise_bound)
        is_running = any(group.first.running for group in self.groups)
        for each in (Objective.REWIRED, Objective.STARTED) if is_running else (Objective.STARTED,):
            yield _Step(counts.objective(each), attrgetter(each), partial(standing.raise_bound_of, each))

    def _minimise(
        self,
        counts: CountingModel,
        what: LinearExpr,
        known: Sequence[int],
        learn: Callable[[int], None],
        *,
        is_placed: bool,
    ) -> tuple[Sequence[int], int] | None:
        """The best numbers and their value; None if there are none, or the time is over before they are proven best.

        `known` are numbers to begin with, if there are any. `learn` is told bounds.
        """
        clock = self.standing.clock
        counts.cp.minimize(what)
        if known:
            counts.cp.clear_hints()  # type: ignore[no-untyped-call]
        for index, value in enumerate(known):
            counts.cp.add_hint(counts.cp.get_int_var_from_proto_index(index), value)
        solver = _solver(clock)

        def learn_bound(bound: float) -> None:
            learn(ceil(bound - 0.5))

        def look_at(solution: CpSolverSolutionCallback) -> bool:
            return not is_placed or self._offer(counts, solution.response_proto.solution)

        status = solve(solver, counts.cp, clock, look_at, learn_bound)
        self.standing.counts["rounds"] += 1
        self.standing.counts["conflicts"] += solver.num_conflicts
        if status == INFEASIBLE:
            self.standing.prove_infeasible()
            return None
        if status == MODEL_INVALID:
            raise ContradictionError("the engine refuses the model")
        if status != OPTIMAL:
            return None
        values = list(solver.response_proto.solution)
        if self.misfits and not is_placed and self._is_too_much(counts, values):
            return self._minimise(counts, what, values, learn, is_placed=is_placed)
        return values, int(solver.value(what))

    def _offer(self, counts: CountingModel, values: Sequence[int]) -> bool:
        """Offer the plan that numbers say, with more hosts if their units do not fit on so many; False then."""
        hosts_of: dict[int, list[HostName]] = defaultdict(list)
        is_fit = True
        for k, kind in enumerate(counts.kinds):
            here = {n: values[on.index] for (n, at), on in counts.there.items() if at == k and values[on.index]}
            used = values[counts.used[k].index]
            placed = self._placed(kind, here, used)
            if not placed.is_fit:
                is_fit = False
                if placed.is_misfit:
                    company = {n for n in here if self.groups[n].label in self.candidates.environment.companions}
                    self.misfits = (*self.misfits, Misfit(k, used, here, frozenset(company)))
                more = (self._placed(kind, here, n, has_more_company=True) for n in _more(used, len(kind.names)))
                placed = next((found for found in more if found.is_fit), placed)
                if not placed.is_fit:
                    return False
            for n, hosts in placed.hosts.items():
                hosts_of[n] += hosts
        units = CountedWiring(counts, values, hosts_of).units()
        key = self.standing.offer(self.candidates, named(self.candidates, lean(self.candidates, units)))
        return is_fit and key is not None

    def _placed(self, kind: HostKind, here: Mapping[int, int], used: int, *, has_more_company: bool = False) -> _Placed:
        """Place units of groups on so many hosts of a kind.

        With `has_more_company`, those that others run with may be more.
        """
        if len(kind.names) == 1 or not here:
            return _Placed({n: [kind.first] * number for n, number in here.items()}, is_fit=True)
        groups, hosts, clock = [self.groups[n] for n in here], kind.apart()[:used], self.standing.clock
        counts = CountingModel(self.candidates, groups, hosts, PLACED)
        for group, number, units in zip(groups, counts.number, here.values(), strict=True):
            is_free = has_more_company and group.label in self.candidates.environment.companions
            counts.cp.add(number >= units if is_free else number == units)
        solver = _solver(clock)
        solver.parameters.max_deterministic_time = clock.tuning.fleet.place
        status = solve(solver, counts.cp, clock)
        if status not in (OPTIMAL, FEASIBLE):
            return _Placed({}, is_misfit=status == INFEASIBLE)
        found: dict[int, list[HostName]] = defaultdict(list)
        of = list(here)
        for (n, k), on in counts.there.items():
            found[of[n]] += [hosts[k].first] * solver.value(on)
        return _Placed(found, is_fit=True)

    def _hint(self, counts: CountingModel) -> None:
        """Hint the incumbent's units and hosts."""
        assert self.standing.best is not None
        new = {group.label: n for n, group in enumerate(self.groups) if group.first.running is None}
        running = {group.first.id: n for n, group in enumerate(self.groups) if group.first.running is not None}
        units = self.standing.best.units
        number = Counter((running.get(unit.id, new.get(unit.transformation)), unit.host) for unit in units)
        for (n, k), there in counts.there.items():
            counts.cp.add_hint(there, number[n, counts.kinds[k].first])

    def _alike(self, kinds: Sequence[HostKind]) -> CountingModel:
        """The counting model without the numbers of units that are known not to fit."""
        counts = CountingModel(self.candidates, self.groups, kinds)
        for misfit in self.misfits:
            counts.forbid(misfit)
        for k, patterns in self._patterns.items():
            for weights in patterns.limits:
                counts.limit(k, weights)
        return counts

    def _is_too_much(self, counts: CountingModel, values: Sequence[int]) -> bool:
        """Whether patterns say that hosts of some kind can't have so many units; the model then gets the limits."""
        is_limited = False
        for k, kind in enumerate(counts.kinds):
            if len(kind.names) > 1:
                if k not in self._patterns:
                    self._patterns[k] = Patterns(self.candidates, self.groups, kind)
                here = {n: values[on.index] for (n, at), on in counts.there.items() if at == k}
                if self._patterns[k].is_too_much(here, values[counts.used[k].index], self.standing.clock):
                    counts.limit(k, self._patterns[k].limits[-1])
                    is_limited = True
        return is_limited

    def apart(self, kinds: Sequence[HostKind]) -> list[HostKind]:
        """Split kinds into single hosts, as many of each kind as a plan no worse than the incumbent may use."""
        found: list[HostKind] = []
        for k, kind in enumerate(kinds):
            most = len(kind.names)
            if most > 1 and self.standing.best is not None:
                counts = self._alike(kinds)
                first = next(self._steps(counts))
                counts.cp.add(first.what <= first.value(self.standing.best.key))
                counts.cp.maximize(counts.used[k])
                solver = _solver(self.standing.clock)
                if solve(solver, counts.cp, self.standing.clock) == OPTIMAL:
                    most = solver.value(counts.used[k])
            found += kind.apart()[:most]
        return found


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


def _solver(clock: Clock) -> CpSolver:
    solver = repeatable_solver(small=False, time_limit_s=clock.left_s())
    solver.parameters.cut_level = 1
    return solver
