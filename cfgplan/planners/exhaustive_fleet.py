"""The oracle for problems that ask more than the paper: every set of placed units, every wiring of it.

Quality, hosts, conflicts, instances and survival are judged by the definitions alone, on finished wirings.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from itertools import chain, combinations, combinations_with_replacement, product
from math import comb, prod

from cfgplan.domain import ComputationUnit, Environment, Publication, Stream, Subscription, Transformation
from cfgplan.errors import InputError
from cfgplan.planners.exhaustive_judging import (
    OracleKey,
    Steps,
    Units,
    cost_of_units,
    is_borne,
    is_met_by,
    key_of,
    needed_by,
    reached_from,
    runnable,
    taken_by,
)
from cfgplan.planning import Plan, Problem, Progress, Status, fresh_units

MOST_SETS = 300_000
"""More sets of units are refused."""

UnitKind = tuple[str, str | None, bool]
"""A new unit but for its id: its transformation, its host and whether it is a cold spare."""


def plan(
    problem: Problem,
    *,
    time_limit_s: float | None = None,
    report: Callable[[Progress], None] | None = None,
) -> Plan:
    """The optimal plan by enumeration.

    Raises InputError for more than `MOST_SETS` sets of units, and after `MOST_STEPS`.
    """
    began = time.monotonic()
    best: tuple[OracleKey, Units] | None = None
    tried, steps = 0, Steps()
    for least, units in sorted(_sets(problem), key=lambda entry: (entry[0], [unit.id for unit in entry[1]])):
        if best is not None and least >= best[0]:
            break
        if not is_borne(problem, units):
            continue
        for wired in _wirings(problem, units, steps):
            if time_limit_s is not None and time.monotonic() - began > time_limit_s:
                return _answer(problem, best, began, tried, stopped=True)
            tried += 1
            key = key_of(problem, wired)
            if key is not None and (best is None or key < best[0]):
                best = (key, wired)
                if report is not None:
                    report(Progress(time.monotonic() - began, key[1], 0))
    return _answer(problem, best, began, tried, stopped=False)


def _answer(problem: Problem, best: tuple[OracleKey, Units] | None, began: float, tried: int, *, stopped: bool) -> Plan:
    seconds, counts = {"search": time.monotonic() - began}, {"wirings": tried}
    environment = problem.environment
    if best is None:
        if stopped:
            return Plan("exhaustive", Status.UNKNOWN, seconds=seconds, counts=counts)
        possible = runnable(problem, [ComputationUnit(t.label, t.label) for t in environment.library])
        alone = {
            target.label: "no wiring of any set of units meets it"
            for target in environment.targets
            if not is_met_by(problem, possible, target)
        }
        joint = {target.label: "no configuration meets all that is asked" for target in environment.targets}
        return Plan("exhaustive", Status.INFEASIBLE, reasons=alone or joint, seconds=seconds, counts=counts)
    (_, cost_us, _, _), units = best
    bound_us = 0 if stopped else cost_us
    if problem.max_cost_us is not None and cost_us > problem.max_cost_us:
        status = Status.UNKNOWN if stopped else Status.TOO_EXPENSIVE
        return Plan("exhaustive", status, None, None if stopped else cost_us, bound_us, seconds=seconds, counts=counts)
    used = {unit.transformation for unit in needed_by(units, [unit for unit in units if unit.publications])}
    unused = tuple(label for label in environment.required if label not in used)
    return Plan(
        "exhaustive",
        Status.of_plan(cost_us, bound_us),
        environment.change_to(units),
        cost_us,
        bound_us,
        unused_required=unused,
        ties_proven=not stopped,
        required_proven=not (stopped and unused),
        seconds=seconds,
        counts=counts,
    )


def _sets(problem: Problem) -> list[tuple[OracleKey, Units]]:
    """Every set of units, not wired yet, with the best key that it could have."""
    environment = problem.environment
    running = [unit for unit in environment.units if _may_stay(problem, unit)]
    kinds = [list(_new_kinds(problem, t)) for t in environment.library]
    most = [problem.most_new(t) for t in environment.library]
    count = 2 ** len(running) * prod(comb(len(k) + n, n) for k, n in zip(kinds, most, strict=True))
    if count > MOST_SETS:
        raise InputError.of(
            f"the exhaustive planner tries every set of units and {count:,} are too many for it",
            mend="use the planner cpsat",
        )
    new_sets = [
        list(chain.from_iterable(combinations_with_replacement(kind, size) for size in range(n + 1)))
        for kind, n in zip(kinds, most, strict=True)
    ]
    sets = []
    for size in range(len(running) + 1):
        for kept in combinations(running, size):
            for chosen in product(*new_sets):
                units = (*kept, *_named(problem.environment, chosen))
                if _is_allowed(problem, units):
                    sets.append((_least(problem, units), units))
    return sets


def _may_stay(problem: Problem, unit: ComputationUnit) -> bool:
    transformation = problem.environment.transformation.get(unit.transformation)
    if transformation is None or (unit.standby and (problem.survive is None or transformation.standby_us is None)):
        return False
    return not problem.environment.hosts or unit.host in problem.environment.hosts_for(transformation)


def _new_kinds(problem: Problem, transformation: Transformation) -> Iterator[UnitKind]:
    for host in problem.environment.hosts_for(transformation):
        yield transformation.label, host, False
        if problem.survive is not None and transformation.standby_us is not None:
            yield transformation.label, host, True


def _named(environment: Environment, chosen: Sequence[Sequence[UnitKind]]) -> Iterator[ComputationUnit]:
    ids = fresh_units(environment, {kinds[0][0]: len(kinds) for kinds in chosen if kinds})
    for kinds in chosen:
        for number, (label, host, is_cold) in enumerate(kinds):
            yield ComputationUnit(ids[label][number], label, host=host, standby=is_cold)


def _is_allowed(problem: Problem, units: Units) -> bool:
    """Whether pinned units are kept, numbers and conflicts are right, and hosts have room for their units."""
    environment = problem.environment
    library = environment.transformation
    there = Counter(unit.transformation for unit in units)
    running = Counter(unit.transformation for unit in units if not unit.standby)
    for t in environment.library:
        if running[t.label] < t.min_instances or (t.max_instances is not None and there[t.label] > t.max_instances):
            return False
        if there[t.label] and any(there[other] for other in t.conflicts if other != t.label):
            return False
    for host in environment.hosts:
        takes = [taken_by(problem, unit) for unit in units if unit.host == host.name]
        for resource in {resource for each in takes for resource in each}:
            room = host.room(resource)
            if room is not None and sum(each.get(resource, 0) for each in takes) > room:
                return False
    pinned = {u.id for u in environment.units if _may_stay(problem, u) and library[u.transformation].pinned}
    if pinned:
        possible = runnable(problem, [ComputationUnit(t.label, t.label) for t in environment.library])
        labels = {unit.transformation for unit in possible}
        pinned = {u.id for u in environment.units if u.id in pinned and u.transformation in labels and not u.standby}
    return pinned <= {unit.id for unit in units}


def _least(problem: Problem, units: Units) -> OracleKey:
    environment = problem.environment
    there = {unit.transformation for unit in units if not unit.standby}
    unused = sum(t.required and t.label not in there for t in environment.library)
    started = sum(unit.id not in environment.unit for unit in units)
    return unused, cost_of_units(problem, units), 0, started


def _wirings(problem: Problem, units: Units, steps: Steps) -> Iterator[Units]:
    """Every wiring of the running units that meets the targets, is grounded and distinct."""
    environment = problem.environment
    hot = [unit for unit in units if not unit.standby]
    label_of = {unit.id: unit.transformation for unit in hot}
    library = environment.transformation
    demands: list[tuple[str | None, str, str, str | None, bool]] = [
        (None, target.topic, target.tag, None, False) for target in environment.targets
    ]
    demands += [
        (u.id, port.name, port.tag, port.distinct, port.feedback)
        for u in hot
        for port in library[u.transformation].inputs
    ]
    streams = [
        [
            Stream(unit.id, port.name)
            for unit in hot
            for port in library[unit.transformation].outputs
            if problem.similarity.holds(port.tag, demand[2])
        ]
        for demand in demands
    ]

    def extend(choice: tuple[Stream, ...]) -> Iterator[tuple[Stream, ...]]:
        steps.take()
        if len(choice) == len(demands):
            yield choice
            return
        unit, _, _, distinct, feedback = demands[len(choice)]
        done = list(zip(demands, choice, strict=False))
        feeders = {label_of[s.unit] for d, s in done if distinct is not None and (d[0], d[3]) == (unit, distinct)}
        edges = [(s.unit, d[0]) for d, s in done if d[0] is not None and not d[4]]
        for stream in streams[len(choice)]:
            is_distinct = label_of[stream.unit] not in feeders
            if is_distinct and (unit is None or feedback or stream.unit not in reached_from(edges, unit)):
                yield from extend((*choice, stream))

    for choice in extend(()) if all(streams) else ():
        done = list(zip(demands, choice, strict=True))
        yield tuple(
            ComputationUnit(
                unit.id,
                unit.transformation,
                tuple(Subscription(d[1], stream) for d, stream in done if d[0] == unit.id),
                tuple(Publication(s.port, d[1]) for d, s in done if d[0] is None and s.unit == unit.id),
                unit.host,
                unit.standby,
            )
            for unit in units
        )
