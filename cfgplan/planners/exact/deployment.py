"""Plans made by counting: how many units of each group, then which hosts they are on, then who is wired to whom.

Hosts alike are first counted too. Where the units that are best then can be placed, all is proven; else each host
is looked at by itself.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from math import ceil
from operator import attrgetter
from typing import NamedTuple

import numpy as np
from ortools.graph.python.max_flow import SimpleMaxFlow
from ortools.sat.python.cp_model import (
    FEASIBLE,
    INFEASIBLE,
    MODEL_INVALID,
    OPTIMAL,
    CpSolver,
    CpSolverSolutionCallback,
    LinearExpr,
)

from cfgplan.domain import ComputationUnit, Objective, Publication, Stream, Subscription
from cfgplan.planners.exact.candidates import Candidates, HostName
from cfgplan.planners.exact.counting import PLACED, CountingModel, Misfit
from cfgplan.planners.exact.decode import lean, named
from cfgplan.planners.exact.groups import Group, HostKind, groups_of, host_kinds
from cfgplan.planners.exact.patterns import Patterns
from cfgplan.planners.exact.standing import Standing
from cfgplan.planners.networks.keys import Key
from cfgplan.planners.solving.clock import Clock, ContradictionError
from cfgplan.planners.solving.engine import repeatable_solver, solve
from cfgplan.planners.tuning import Fleets
from cfgplan.planning import Notion


def plan_by_counting(candidates: Candidates, standing: Standing) -> None:
    """Bring a plan forward to a proof."""
    groups = groups_of(candidates)
    kinds = host_kinds(candidates, groups)
    standing.counts |= {"groups": len(groups), "kinds of hosts": len(kinds), "rounds": 0, "conflicts": 0}
    deployment = _Deployment(candidates, standing, groups)
    for _ in range(_recounts(sum(len(kind.names) for kind in kinds), len(kinds), standing.clock.tuning.fleet)):
        known = len(deployment.misfits)
        if deployment.count(kinds) or standing.is_over:
            return
        if len(deployment.misfits) == known:
            break
    deployment.count(deployment.apart(kinds))


def _recounts(hosts: int, kinds: int, tuning: Fleets) -> int:
    """How often hosts alike are counted before each is looked at by itself."""
    if hosts == kinds:
        return 0
    return tuning.recounts if hosts > tuning.apart else 1


class _Step(NamedTuple):
    """Something to be minimised, its value in a plan, and who is told what is proven of it."""

    what: LinearExpr
    value: Callable[[Key], int]
    learn: Callable[[int], None]


class _Placed(NamedTuple):
    """The hosts of each group's units if they fit; a misfit if that is disproven."""

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
        """What is minimised first is at least so much."""

    def count(self, kinds: Sequence[HostKind]) -> bool:
        """Minimise all that is asked, one after the other. Returns whether all is proven.

        Where each kind is one host, each solution is a plan. Else what is best has to be placed, and before that only
        the bound of what is minimised first is one.
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
            learn = step.learn if is_placed or not number else None
            found = self._minimise(counts, step.what, values, learn, is_placed=is_placed)
            if found is None:
                return standing.is_infeasible
            values, least = found
            self._least = self._least if number else least
            counts.cp.add(step.what <= least)
            proven.append(least)
        if not is_placed and not self._offer(counts, values):
            return False
        assert standing.best is not None
        for step, least in zip(steps, proven, strict=True):
            if step.value(standing.best.key) > least:
                raise ContradictionError("a plan costs or changes more than the numbers of its units say")
            step.learn(least)
        standing.prove_all()
        return True

    def _steps(self, counts: CountingModel) -> Iterator[_Step]:
        problem, standing = self.candidates.problem, self.standing
        named = problem.environment.minimise if Notion.ORDER in problem.notions else ()
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
        learn: Callable[[int], None] | None,
        *,
        is_placed: bool,
    ) -> tuple[Sequence[int], int] | None:
        """The best numbers and their value; None if there are none, or the time is over before they are proven best."""
        clock = self.standing.clock
        counts.cp.minimize(what)
        if known:
            counts.cp.clear_hints()  # type: ignore[no-untyped-call]
        for index, value in enumerate(known):
            counts.cp.add_hint(counts.cp.get_int_var_from_proto_index(index), value)
        solver = _solver(clock)

        def learn_bound(bound: float) -> None:
            if learn is not None:
                learn(ceil(bound - 0.5))

        def look_at(solution: CpSolverSolutionCallback) -> bool:
            return not is_placed or self._offer(counts, solution.response_proto.solution)

        solver.best_bound_callback = learn_bound
        status = solve(solver, counts.cp, clock, look_at)
        self.standing.counts["rounds"] += 1
        self.standing.counts["conflicts"] += solver.num_conflicts
        if status == INFEASIBLE:
            self.standing.prove_infeasible()
            return None
        if status == MODEL_INVALID:
            raise ContradictionError("the engine refuses the model")
        learn_bound(solver.best_objective_bound)
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
        units = _WiringByNumber(counts, values, hosts_of).units()
        self.standing.offer(named(self.candidates, lean(self.candidates, units)))
        return is_fit

    def _placed(
        self,
        kind: HostKind,
        here: Mapping[int, int],
        used: int,
        *,
        has_more_company: bool = False,
    ) -> _Placed:
        """Place units of groups on so many hosts of a kind; those that others run with may become more."""
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
        if self.standing.best is None:
            return
        new = {group.label: n for n, group in enumerate(self.groups) if group.first.running is None}
        running = {group.first.id: n for n, group in enumerate(self.groups) if group.first.running is not None}
        units = self.standing.best.units
        number = Counter((running.get(unit.id, new.get(unit.transformation)), unit.host) for unit in units)
        for (n, k), there in counts.there.items():
            counts.cp.add_hint(there, number[n, counts.kinds[k].first])

    def _alike(self, kinds: Sequence[HostKind]) -> CountingModel:
        """The model in which hosts are counted, less what is known not to fit."""
        counts = CountingModel(self.candidates, self.groups, kinds)
        for misfit in self.misfits:
            counts.forbid(misfit)
        for k, patterns in self._patterns.items():
            for weights in patterns.limits:
                counts.limit(k, weights)
        return counts

    def _is_too_much(self, counts: CountingModel, values: Sequence[int]) -> bool:
        """Whether hosts of some kind can't have so many units, by limits that are demanded from now on."""
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
        """So many hosts of each kind as a plan may use that is no worse than the incumbent, each by itself."""
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
    """What a plan has of the objective at a place in the order, the first at 1."""
    return key.first[place]


def _solver(clock: Clock) -> CpSolver:
    solver = repeatable_solver(small=False, time_limit_s=clock.left_s())
    solver.parameters.cut_level = 1
    return solver


class _Taker(NamedTuple):
    """An input of a unit, or a target, with the streams that it may take and those that it has."""

    who: tuple[str, str]
    number: int
    streams: Sequence[Stream]
    old: Sequence[Stream] = ()


class _WiringByNumber:
    """Who takes whose streams, once it is known how many units of each group run, and where."""

    def __init__(
        self, counts: CountingModel, values: Sequence[int], hosts_of: Mapping[int, Sequence[HostName]]
    ) -> None:
        self._counts, self._values, self._candidates = counts, values, counts.candidates
        self._all = counts.candidates.all
        self._host_of: dict[int, HostName] = {}
        for n, hosts in hosts_of.items():
            self._host_of |= dict(zip(counts.groups[n].units, hosts, strict=False))
        self._stays = {counts.groups[n].units[0] for n, stays in counts.stays.items() if values[stays.index]}

    def units(self) -> list[ComputationUnit]:
        """The units, wired; those that stay as they are the same."""
        demands = list(self._demands())
        limited = [demand for demand in demands if any(map(self._serves, demand.streams))]
        taken = {demand.who: _first(demand) for demand in demands if demand not in limited}
        taken |= self._shared_out(limited)
        topics: dict[str, list[Publication]] = defaultdict(list)
        for target in self._counts.environment.stream_targets:
            for stream in taken.get(("", target.label), ()):
                topics[stream.unit].append(Publication(stream.port, target.topic))
        return [self._wired(i, host, taken, topics) for i, host in sorted(self._host_of.items())]

    def _wired(
        self,
        unit: int,
        host: HostName,
        taken: Mapping[tuple[str, str], Sequence[Stream]],
        topics: Mapping[str, Sequence[Publication]],
    ) -> ComputationUnit:
        candidate = self._all[unit]
        if unit in self._stays and candidate.running is not None:
            return candidate.running
        ports = [port.name for port in candidate.transformation.inputs]
        wires = [Subscription(port, stream) for port in ports for stream in taken[candidate.id, port]]
        label = candidate.transformation.label
        return ComputationUnit(candidate.id, label, tuple(wires), tuple(topics.get(candidate.id, ())), host)

    def _serves(self, stream: Stream) -> int:
        """How many may take a stream; 0: any number."""
        return self._all[self._candidates.index_of[stream.unit]].transformation.output[stream.port].serves or 0

    def _running(self, tag: str) -> list[Stream]:
        return [s for s in self._candidates.streams(tag) if self._candidates.index_of[s.unit] in self._host_of]

    def _demands(self) -> Iterator[_Taker]:
        """Those of units that do not stay as they are, and those of targets that such units meet."""
        for i in sorted(self._host_of.keys() - self._stays):
            old = {} if (running := self._all[i].running) is None else running.feeds
            for port in self._all[i].transformation.inputs:
                streams = self._running(port.tag)
                yield _Taker((self._all[i].id, port.name), port.count, streams, old.get(port.name, ()))
        index_of, group_of = self._candidates.index_of, self._counts.group_of
        for target in self._counts.environment.stream_targets:
            there = [s for s in self._running(target.tag) if index_of[s.unit] not in self._stays]
            sources = [(group_of[index_of[stream.unit]], stream.port) for stream in there]
            publishes = [self._values[self._counts.publishes[target.label, source].index] for source in sources]
            streams = [stream for stream, may in zip(there, publishes, strict=True) if may]
            if streams:
                yield _Taker(("", target.label), 1, streams)

    def _shared_out(self, demands: Sequence[_Taker]) -> dict[tuple[str, str], list[Stream]]:
        """The streams that each demand takes where some serve only so many: a flow from streams to demands."""
        if not demands:
            return {}
        kept = Counter(s.stream for i in self._stays for s in self._running_unit(i).subscriptions)
        kept.update(Stream(self._all[i].id, p.port) for i in self._stays for p in self._running_unit(i).publications)
        nodes: dict[object, int] = {}
        arcs: dict[tuple[int, int], int] = {}

        def arc(tail: object, head: object, most: int) -> tuple[int, int]:
            found = nodes.setdefault(tail, len(nodes)), nodes.setdefault(head, len(nodes))
            arcs[found] = most
            return found

        ways: dict[tuple[int, int], tuple[tuple[str, str], Stream]] = {}
        for demand in demands:
            arc(demand.who, "sink", demand.number)
            for stream in demand.streams:
                serves = self._serves(stream)
                arc("source", stream, serves - kept[stream] if serves else len(demands))
                arc((demand.who, stream.unit), demand.who, 1)
                ways[arc(stream, (demand.who, stream.unit), 1)] = demand.who, stream
        flow = SimpleMaxFlow()
        tails, heads = zip(*arcs, strict=True)
        numbers = flow.add_arcs_with_capacity(np.array(tails), np.array(heads), np.array(list(arcs.values())))
        flow.solve(nodes["source"], nodes["sink"])
        if flow.optimal_flow() < sum(demand.number for demand in demands):
            raise ContradictionError("the streams that are counted can't be shared out")
        taken: dict[tuple[str, str], list[Stream]] = {demand.who: [] for demand in demands}
        for way, used in zip(arcs, flow.flows(numbers).tolist(), strict=True):
            if used and way in ways:
                who, stream = ways[way]
                taken[who].append(stream)
        return taken

    def _running_unit(self, unit: int) -> ComputationUnit:
        running = self._all[unit].running
        assert running is not None
        return running


def _first(demand: _Taker) -> list[Stream]:
    """The streams of as many different units as are demanded, those that it has first."""
    of_units: dict[str, Stream] = {}
    for stream in (*(stream for stream in demand.old if stream in demand.streams), *demand.streams):
        of_units.setdefault(stream.unit, stream)
    return list(of_units.values())[: demand.number]
