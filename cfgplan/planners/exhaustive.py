"""The oracle: every set of placed units, every wiring of it, and the judge's word on each.

It shares nothing with the other planners, and is slow on purpose. It refuses problems that are too large for it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain, combinations, combinations_with_replacement, product
from math import comb, inf, prod
from typing import NamedTuple

from cfgplan.domain import (
    ALL,
    ComputationUnit,
    Environment,
    InputPort,
    Objective,
    Publication,
    Stream,
    Subscription,
    Transformation,
)
from cfgplan.errors import InputError
from cfgplan.planning import Feature, Measured, OnProgress, Plan, Problem, Progress, Status, fresh_units
from cfgplan.validity.counts import unfed_us
from cfgplan.validity.environments import each_violation, instance_violations, missing_units
from cfgplan.validity.hosts import carried_us, company_violations, placing_violations
from cfgplan.validity.plans import cost_us, unused_required, values_of
from cfgplan.validity.quality import priced_us
from cfgplan.validity.startable import providers_by_tag, startable
from cfgplan.validity.survival import justified_spares, survival_violations

MOST_SETS = 300_000
"""More sets of units are refused."""
MOST_STEPS = 100_000
"""More steps, each of which feeds one input or topic of one set of units, are refused."""
Units = tuple[ComputationUnit, ...]


class OracleRank(NamedTuple):
    """How good a configuration is: the least is best."""

    unused: int
    first: tuple[int, ...]
    """Whether it costs more than is allowed, and the objectives in order; empty where the cost alone is minimised."""
    cost_us: int
    rewired: int
    started: int


class _TimeIsOverError(Exception):
    """The time limit is over."""


class _Steps:
    """Counts steps. Raises InputError after `MOST_STEPS`, and _TimeIsOverError after the time limit."""

    def __init__(self, time_limit_s: float | None) -> None:
        self.began = time.monotonic()
        self._until = self.began + (inf if time_limit_s is None else time_limit_s)
        self._number = 0
        self.wirings = 0

    def look(self) -> None:
        """Look at the clock."""
        if time.monotonic() >= self._until:
            raise _TimeIsOverError

    def take(self) -> None:
        self._number += 1
        if self._number > MOST_STEPS:
            raise InputError.of(
                f"the exhaustive planner tries every wiring and {MOST_STEPS:,} steps were too few for it",
                mend="use the planner cpsat",
            )
        self.look()


def plan(problem: Problem, *, time_limit_s: float | None = None, report: OnProgress | None = None) -> Plan:
    """The optimal plan by enumeration.

    Raises InputError for more than `MOST_SETS` sets of units, and after `MOST_STEPS`.
    """
    steps = _Steps(time_limit_s)
    best: tuple[OracleRank, Environment] | None = None
    stopped = False

    def is_better(rank: OracleRank) -> bool:
        return best is None or rank < best[0]

    try:
        for rank, after in _configurations(problem, steps, is_better):
            best = rank, after
            if report is not None:
                report(Progress(time.monotonic() - steps.began, rank.cost_us, 0))
    except _TimeIsOverError:
        stopped = True
    return _answer(problem, best, steps, stopped=stopped)


def configurations(problem: Problem) -> Iterator[tuple[OracleRank, Environment]]:
    """Every valid configuration with its rank. Raises InputError as `plan` does."""
    return _configurations(problem, _Steps(None), lambda _: True)


def _configurations(
    problem: Problem, steps: _Steps, may_do: Callable[[OracleRank], bool]
) -> Iterator[tuple[OracleRank, Environment]]:
    """The valid configurations with a rank that `may_do`; where a rank does not, no greater one does."""
    environment, similarity = problem.environment, problem.similarity
    pinned, after = _pinned(problem), environment
    sets = _sets(problem, steps)
    for least, units in sorted(sets, key=lambda entry: (entry[0], len(entry[1]), [u.id for u in entry[1]])):
        if not may_do(least):
            return
        after = after.with_units(units)
        if not pinned.issubset(after.unit) or any(survival_violations(after, similarity, problem.survive)):
            continue
        spares: set[str] | None = None
        for rewired, wired in _wirings(problem, units, steps, partial(_may_rewire, may_do, least)):
            steps.wirings += 1
            after = after.with_units(wired)
            more_us = carried_us(after, problem.horizon_s) + priced_us(after) + unfed_us(after, problem.horizon_s)
            unused, dear_us = len(unused_required(after)), least.cost_us + more_us
            rank = OracleRank(unused, _first(problem, after, dear_us, rewired), dear_us, rewired, least.started)
            if not may_do(rank):
                continue
            if spares is None:
                spares = justified_spares(after, similarity, problem.survive)
            broken = each_violation(after, similarity, None, problem.horizon_s, spares, environment)
            if next(broken, None) is None:
                yield rank, after


def _may_rewire(may_do: Callable[[OracleRank], bool], least: OracleRank, rewired: int) -> bool:
    return may_do(least._replace(rewired=rewired))


def _answer(problem: Problem, best: tuple[OracleRank, Environment] | None, steps: _Steps, *, stopped: bool) -> Plan:
    seconds, counts = {"search": time.monotonic() - steps.began}, {"wirings": steps.wirings}
    plan = partial(Plan, "exhaustive", seconds=seconds, counts=counts)
    if best is None:
        return plan(Status.UNKNOWN) if stopped else plan(Status.INFEASIBLE, reasons=_reasons(problem))
    rank, after = best
    bound_us = 0 if stopped else rank.cost_us
    if problem.max_cost_us is not None and rank.cost_us > problem.max_cost_us:
        if stopped:
            return plan(Status.UNKNOWN)
        if rank.first:
            return plan(Status.TOO_EXPENSIVE, bound_us=problem.max_cost_us + 1)
        return plan(Status.TOO_EXPENSIVE, None, rank.cost_us, bound_us)
    unused, named = unused_required(after), zip(problem.environment.minimise, rank.first[1:], strict=False)
    objectives = tuple(Measured(each, value, 0 if stopped else value) for each, value in named)
    is_required_proven = not (stopped and unused)
    return plan(
        Status.of_plan(rank.cost_us, bound_us, objectives, is_required_proven=is_required_proven),
        problem.environment.change_to(after.units),
        rank.cost_us,
        bound_us,
        unused_required=unused,
        ties_proven=not stopped,
        required_proven=is_required_proven,
        objectives=objectives,
    )


def _reasons(problem: Problem) -> dict[str, str]:
    possible = startable(problem.environment, problem.similarity)
    providers = providers_by_tag(problem.environment, problem.similarity)
    targets = problem.environment.targets
    alone = [target.label for target in targets if possible.isdisjoint(providers.get(target.tag, ()))]
    if alone:
        return dict.fromkeys(alone, "no wiring of any set of units meets it")
    return {target.label: "no configuration meets all that is asked" for target in targets}


def _pinned(problem: Problem) -> set[str]:
    """Return the running units of pinned transformations that can be fed, which have to be kept."""
    environment = problem.environment
    pinned = [u for u in environment.units if _may_stay(problem, u) and not u.standby]
    pinned = [u for u in pinned if environment.transformation[u.transformation].pinned]
    possible = startable(environment, problem.similarity) if pinned else set()
    return {unit.id for unit in pinned if unit.transformation in possible}


def _sets(problem: Problem, steps: _Steps) -> list[tuple[OracleRank, Units]]:
    """Every set of units that is allowed where it is, not wired yet, with the best rank that it could have."""
    environment = problem.environment
    running = [_wired(unit, ()) for unit in environment.units if _may_stay(problem, unit)]
    places = [list(_places(problem, t)) for t in environment.library]
    most = [problem.most_new(t) for t in environment.library]
    count = 2 ** len(running) * prod(comb(len(k) + n, n) for k, n in zip(places, most, strict=True))
    if count > MOST_SETS:
        raise InputError.of(
            f"the exhaustive planner tries every set of units and {count:,} are too many for it",
            mend="use the planner cpsat",
        )
    ids = fresh_units(environment, {t.label: n for t, n in zip(environment.library, most, strict=True)})
    new = [
        [
            tuple(
                ComputationUnit(unit_id, t.label, host=host, standby=is_cold)
                for unit_id, (host, is_cold) in zip(ids[t.label], chosen, strict=False)
            )
            for size in range(n + 1)
            for chosen in combinations_with_replacement(where, size)
        ]
        for t, where, n in zip(environment.library, places, most, strict=True)
    ]
    kept = chain.from_iterable(combinations(running, size) for size in range(len(running) + 1))
    sets = ((*one, *chain.from_iterable(others)) for one, others in product(list(kept), list(product(*new))))
    found, after = [], environment
    for units in sets:
        steps.look()
        after = after.with_units(units)
        if _is_allowed(after, problem.horizon_s):
            found.append((_least(problem, after), units))
    return found


def _may_stay(problem: Problem, unit: ComputationUnit) -> bool:
    transformation = problem.environment.transformation.get(unit.transformation)
    if transformation is None or (unit.standby and (problem.survive is None or transformation.standby_us is None)):
        return False
    return not problem.environment.hosts or unit.host in problem.environment.hosts_for(transformation)


def _places(problem: Problem, transformation: Transformation) -> Iterator[tuple[str | None, bool]]:
    """Where a new unit may be, and whether it is a cold spare."""
    for host in problem.environment.hosts_for(transformation):
        yield host, False
        if problem.survive is not None and transformation.standby_us is not None:
            yield host, True


def _is_allowed(after: Environment, horizon_s: int) -> bool:
    broken = (instance_violations(after), placing_violations(after, horizon_s), company_violations(after))
    return not any(any(each) for each in (*broken, missing_units(after)))


def _least(problem: Problem, after: Environment) -> OracleRank:
    there = {unit.transformation for unit in after.units if not unit.standby}
    unused = sum(t.required and t.label not in there for t in after.library)
    started = sum(unit.id not in problem.environment.unit for unit in after.units)
    least_us = cost_us(problem, after) - unfed_us(after, problem.horizon_s)
    return OracleRank(unused, _first(problem, after, least_us, 0), least_us, 0, started)


def _first(problem: Problem, after: Environment, dear_us: int, rewired: int) -> tuple[int, ...]:
    """The leading objectives of a configuration with this cost and number of rewired units."""
    if Feature.ORDER not in problem.features:
        return ()
    beside = values_of(problem, after, set(problem.environment.minimise) - {Objective.COST, Objective.REWIRED})
    values = {**beside, Objective.COST: dear_us, Objective.REWIRED: rewired}
    is_too_dear = problem.max_cost_us is not None and dear_us > problem.max_cost_us
    return int(is_too_dear), *(values[each] for each in problem.environment.minimise)


@dataclass(frozen=True, eq=False)
class _Demand:
    """An input of a unit, or (without a unit) the topic of a target, and the sets of streams that may feed it."""

    unit: str | None
    name: str
    choices: tuple[tuple[Stream, ...], ...]
    distinct: str | None = None
    feedback: bool = False


def _demands(problem: Problem, units: Units) -> list[_Demand]:
    """The demands of targets, then those of the units' inputs."""
    library = problem.environment.transformation

    def streams(tag: str) -> tuple[Stream, ...]:
        return tuple(
            Stream(unit.id, port.name)
            for unit in units
            for port in library[unit.transformation].outputs
            if problem.similarity.holds(port.tag, tag)
        )

    def choices(unit: ComputationUnit, port: InputPort) -> tuple[tuple[Stream, ...], ...]:
        there = streams(port.tag)
        if port.count == ALL:
            others = tuple(stream for stream in there if stream.unit != unit.id)
            return (others,) if others or port.optional else ()
        several = [one for one in combinations(there, port.count) if len({s.unit for s in one}) == len(one)]
        return (*several, *([()] if port.optional else []))

    targets = problem.environment.stream_targets
    return [_Demand(None, t.topic, tuple((stream,) for stream in streams(t.tag))) for t in targets] + [
        _Demand(unit.id, port.name, choices(unit, port), port.distinct, port.feedback)
        for unit in units
        for port in library[unit.transformation].inputs
    ]


def _wirings(
    problem: Problem, units: Units, steps: _Steps, may_rewire: Callable[[int], bool]
) -> Iterator[tuple[int, Units]]:
    """Every wiring of the units that meets the targets, is grounded and distinct, and how many units it rewires.

    Wirings with more than `may_rewire` rewired units are left out; not all are lean.
    """
    hot = tuple(unit for unit in units if not unit.standby)
    demands = _demands(problem, hot)
    label_of = {unit.id: unit.transformation for unit in hot}
    running = problem.environment.unit
    kept = [unit for unit in units if unit.id in running]
    waiting = [{demand.unit for demand in demands[done:]} for done in range(len(demands) + 1)]
    choice: list[tuple[_Demand, Stream]] = []
    known: dict[tuple[str, tuple[tuple[_Demand, Stream], ...]], ComputationUnit] = {}

    def wired(unit: ComputationUnit) -> ComputationUnit:
        own = tuple([(d, stream) for d, stream in choice if unit.id == (stream.unit if d.unit is None else d.unit)])
        if (unit.id, own) not in known:
            known[unit.id, own] = _wired(unit, own)
        return known[unit.id, own]

    def may_feed(streams: tuple[Stream, ...], demand: _Demand) -> bool:
        if demand.unit is None:
            return True
        if demand.distinct is not None:
            group = [s for d, s in choice if (d.unit, d.distinct) == (demand.unit, demand.distinct)]
            labels = [label_of[stream.unit] for stream in streams]
            if len(set(labels)) < len(labels) or not {label_of[s.unit] for s in group}.isdisjoint(labels):
                return False
        edges = [(s.unit, d.unit) for d, s in choice if d.unit is not None and not d.feedback]
        return demand.feedback or not any(_leads_to(edges, demand.unit, stream.unit) for stream in streams)

    def extend(done: int) -> Iterator[tuple[int, Units]]:
        steps.take()
        unfinished = waiting[done]
        finished = [unit for unit in kept if unit.id not in unfinished] if None not in unfinished else []
        rewired = sum(wired(unit) != running[unit.id] for unit in finished)
        if not may_rewire(rewired):
            return
        if done == len(demands):
            yield rewired, tuple([wired(unit) for unit in units])
            return
        demand = demands[done]
        for streams in demand.choices:
            if may_feed(streams, demand):
                choice.extend((demand, stream) for stream in streams)
                yield from extend(done + 1)
                del choice[len(choice) - len(streams) :]

    labels = set(label_of.values())
    library = tuple(t for t in problem.environment.library if t.label in labels)
    if all(demand.choices for demand in demands) and startable(Environment((), library), problem.similarity) == labels:
        yield from extend(0)


def _wired(unit: ComputationUnit, choice: Sequence[tuple[_Demand, Stream]]) -> ComputationUnit:
    subscriptions = tuple([Subscription(d.name, stream) for d, stream in choice if d.unit == unit.id])
    published = tuple([Publication(s.port, d.name) for d, s in choice if d.unit is None and s.unit == unit.id])
    return ComputationUnit(unit.id, unit.transformation, subscriptions, published, unit.host, unit.standby)


def _leads_to(edges: list[tuple[str, str]], start: str, end: str) -> bool:
    """Whether `end` is `start` or is reached from it along the edges."""
    seen, ahead = {start}, [start]
    for here in ahead:
        new = [to for source, to in edges if source == here and to not in seen]
        seen.update(new)
        ahead += new
    return end in seen
