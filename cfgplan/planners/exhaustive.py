"""The oracle: every set of units, every wiring of it, judged by the definitions alone.

It shares nothing with the other planners but the domain, and is slow on purpose. It refuses problems that are too large
for it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import combinations

from cfgplan.domain import ComputationUnit, Environment, Publication, Stream, Subscription
from cfgplan.errors import InputError
from cfgplan.planners import exhaustive_fleet
from cfgplan.planners.exhaustive_judging import OracleKey, Steps
from cfgplan.planning import Plan, Problem, Progress, Status, fresh_unit_ids

MOST_UNITS = 16
"""More candidate units (running ones and one new one per transformation) are refused."""


def plan(
    problem: Problem,
    *,
    time_limit_s: float | None = None,
    report: Callable[[Progress], None] | None = None,
) -> Plan:
    """The optimal plan by enumeration.

    Raises InputError for more than `MOST_UNITS` candidate units, and after `MOST_STEPS`.
    """
    if problem.notions:
        return exhaustive_fleet.plan(problem, time_limit_s=time_limit_s, report=report)
    began = time.monotonic()
    candidates = _candidates(problem.environment)
    if len(candidates) > MOST_UNITS:
        raise InputError.of(
            f"the exhaustive planner tries every set of units and {len(candidates)} are too many for it",
            mend=f"use the planner cpsat, or at most {MOST_UNITS} running units and transformations",
        )
    runnable = _runnable(problem, problem.environment.transformation)
    kept = {unit.id for unit in candidates if _is_pinned(problem, unit) and unit.transformation in runnable}
    best: tuple[OracleKey, list[ComputationUnit]] | None = None
    tried, steps = 0, Steps()
    for least, chosen in _sets_by_promise(problem, candidates):
        if best is not None and least >= best[0]:
            break
        if not kept.issubset(unit.id for unit in chosen):
            continue
        for units in _wirings(problem, chosen, steps, partial(_is_worth_it, best, least)):
            if time_limit_s is not None and time.monotonic() - began > time_limit_s:
                return _answer(problem, best, began, tried, stopped=True)
            tried += 1
            key = _key(problem, units)
            if key is not None and (best is None or key < best[0]):
                best = (key, units)
                if report is not None:
                    report(Progress(time.monotonic() - began, key[1], 0))
                if key == least:
                    break
    return _answer(problem, best, began, tried, stopped=False)


def _answer(
    problem: Problem, best: tuple[OracleKey, list[ComputationUnit]] | None, began: float, tried: int, *, stopped: bool
) -> Plan:
    seconds, counts = {"search": time.monotonic() - began}, {"wirings": tried}
    if best is None:
        if stopped:
            return Plan("exhaustive", Status.UNKNOWN, seconds=seconds, counts=counts)
        runnable = _runnable(problem, problem.environment.transformation)
        reasons = {
            target.label: "no wiring of any set of units meets it"
            for target in problem.environment.targets
            if not _gives(problem, runnable, target.tag)
        }
        return Plan("exhaustive", Status.INFEASIBLE, reasons=reasons, seconds=seconds, counts=counts)
    (_, cost_us, _, _), units = best
    bound_us = 0 if stopped else cost_us
    if problem.max_cost_us is not None and cost_us > problem.max_cost_us:
        status = Status.UNKNOWN if stopped else Status.TOO_EXPENSIVE
        known = None if stopped else cost_us
        return Plan("exhaustive", status, None, known, bound_us, seconds=seconds, counts=counts)
    used = _used(units)
    unused = tuple(label for label in problem.environment.required if label not in used)
    return Plan(
        "exhaustive",
        Status.of_plan(cost_us, bound_us),
        problem.environment.change_to(units),
        cost_us,
        bound_us,
        unused_required=unused,
        ties_proven=not stopped,
        required_proven=not (stopped and unused),
        seconds=seconds,
        counts=counts,
    )


def _is_worth_it(best: tuple[OracleKey, list[ComputationUnit]] | None, least: OracleKey, rewired: int) -> bool:
    return best is None or (least[0], least[1], rewired, least[3]) < best[0]


def _candidates(environment: Environment) -> list[ComputationUnit]:
    """The running units whose transformation is known, then one new unit of each transformation."""
    running = [unit for unit in environment.units if unit.transformation in environment.transformation]
    fresh = fresh_unit_ids(environment, sorted(environment.transformation))
    return running + [ComputationUnit(unit_id, label) for label, unit_id in fresh.items()]


def _is_pinned(problem: Problem, unit: ComputationUnit) -> bool:
    running = unit.id in problem.environment.unit
    return running and problem.environment.transformation[unit.transformation].pinned


def _sets_by_promise(
    problem: Problem, candidates: list[ComputationUnit]
) -> Iterator[tuple[OracleKey, tuple[ComputationUnit, ...]]]:
    """Every set of candidate units with the best key that a wiring of it could have, the best first."""
    environment = problem.environment
    required = {t.label for t in environment.library if t.required}
    sets = []
    for size in range(len(candidates) + 1):
        for chosen in combinations(candidates, size):
            unused = len(required - {unit.transformation for unit in chosen})
            started = sum(unit.id not in environment.unit for unit in chosen)
            key = (unused, _cost_us(problem, chosen), 0, started)
            sets.append((key, size, [unit.id for unit in chosen], chosen))
    for key, _, _, chosen in sorted(sets, key=lambda entry: entry[:3]):
        yield key, chosen


def _cost_us(problem: Problem, units: Iterable[ComputationUnit]) -> int:
    cost = 0
    for unit in units:
        transformation = problem.environment.transformation[unit.transformation]
        cost += transformation.upkeep_us * problem.horizon_s
        if unit.id not in problem.environment.unit:
            cost += transformation.labor_us
    return cost


@dataclass(frozen=True)
class _Demand:
    """An input port of a unit, or (without a unit) the topic of a target, and the streams that match."""

    unit: str | None
    name: str
    streams: tuple[Stream, ...]
    distinct: str | None = None
    feedback: bool = False


def _demands(problem: Problem, chosen: tuple[ComputationUnit, ...]) -> list[_Demand]:
    environment = problem.environment

    def streams(tag: str) -> tuple[Stream, ...]:
        return tuple(
            Stream(unit.id, port.name)
            for unit in chosen
            for port in environment.transformation[unit.transformation].outputs
            if problem.similarity.holds(port.tag, tag)
        )

    ports = [
        _Demand(unit.id, port.name, streams(port.tag), port.distinct, port.feedback)
        for unit in chosen
        for port in environment.transformation[unit.transformation].inputs
    ]
    return [_Demand(None, target.topic, streams(target.tag)) for target in environment.targets] + ports


def _wirings(
    problem: Problem, chosen: tuple[ComputationUnit, ...], steps: Steps, worth_it: Callable[[int], bool]
) -> Iterator[list[ComputationUnit]]:
    """Every wiring of the chosen units that meets the targets, is grounded and distinct; not all are lean.

    Wirings are skipped that rewire so many units that they are not `worth_it`.
    """
    demands = _demands(problem, chosen)
    label_of = {unit.id: unit.transformation for unit in chosen}
    running = problem.environment.unit
    choice: list[tuple[_Demand, Stream]] = []

    def may_feed(stream: Stream, demand: _Demand) -> bool:
        if demand.unit is None:
            return True
        if demand.distinct is not None:
            group = [s for d, s in choice if (d.unit, d.distinct) == (demand.unit, demand.distinct)]
            if label_of[stream.unit] in {label_of[s.unit] for s in group}:
                return False
        edges = [(s.unit, d.unit) for d, s in choice if d.unit is not None and not d.feedback]
        return demand.feedback or not _leads_to(edges, demand.unit, stream.unit)

    def extend() -> Iterator[list[ComputationUnit]]:
        steps.take()
        wired = _wired(chosen, choice)
        unfinished = {demand.unit for demand in demands[len(choice) :]}
        rewired = [u for u in wired if u.id in running and u.id not in unfinished and u != running[u.id]]
        if None not in unfinished and not worth_it(len(rewired)):
            return
        if len(choice) == len(demands):
            yield wired
            return
        demand = demands[len(choice)]
        for stream in demand.streams:
            if may_feed(stream, demand):
                choice.append((demand, stream))
                yield from extend()
                choice.pop()

    labels = set(label_of.values())
    if all(demand.streams for demand in demands) and _runnable(problem, labels) == labels:
        yield from extend()


def _wired(chosen: tuple[ComputationUnit, ...], choice: list[tuple[_Demand, Stream]]) -> list[ComputationUnit]:
    return [
        ComputationUnit(
            unit.id,
            unit.transformation,
            tuple(Subscription(d.name, stream) for d, stream in choice if d.unit == unit.id),
            tuple(Publication(s.port, d.name) for d, s in choice if d.unit is None and s.unit == unit.id),
        )
        for unit in chosen
    ]


def _key(problem: Problem, units: list[ComputationUnit]) -> OracleKey | None:
    """The key of a wiring, or None if it runs a unit that nothing needs."""
    environment = problem.environment
    pinned = {unit.id for unit in units if _is_pinned(problem, unit)}
    publishing = {unit.id for unit in units if unit.publications}
    if _needed(units, pinned | publishing) != {unit.id for unit in units}:
        return None
    used = _used(units)
    unused = sum(t.required and t.label not in used for t in environment.library)
    changes = environment.change_to(units)
    return unused, _cost_us(problem, units), len(changes.rewired), len(changes.started)


def _used(units: list[ComputationUnit]) -> set[str]:
    """The labels of the transformations with a unit that serves a target."""
    needed = _needed(units, {unit.id for unit in units if unit.publications})
    return {unit.transformation for unit in units if unit.id in needed}


def _needed(units: list[ComputationUnit], roots: set[str]) -> set[str]:
    edges = [(unit.id, s.stream.unit) for unit in units for s in unit.subscriptions]
    return {unit.id for unit in units if any(_leads_to(edges, root, unit.id) for root in roots)}


def _runnable(problem: Problem, labels: Iterable[str]) -> set[str]:
    """The largest part of `labels` with a grounded wiring: found by removing what can't be fed."""
    alive = set(labels)
    while True:
        order: list[str] = []
        grew = True
        while grew:
            grew = False
            for label in sorted(alive - set(order)):
                if _feeds_exist(problem, label, order, alive):
                    order.append(label)
                    grew = True
        if alive == set(order):
            return alive
        alive = set(order)


def _feeds_exist(problem: Problem, label: str, before: list[str], alive: set[str]) -> bool:
    """Whether the inputs of `label` can be fed, by trying every choice of feeders."""
    inputs = problem.environment.transformation[label].inputs

    def extend(feeders: tuple[str, ...]) -> bool:
        if len(feeders) == len(inputs):
            return True
        port = inputs[len(feeders)]
        return any(
            extend((*feeders, feeder))
            for feeder in (sorted(alive) if port.feedback else before)
            if _gives(problem, [feeder], port.tag)
            and not any(
                port.distinct is not None and other.distinct == port.distinct and taken == feeder
                for other, taken in zip(inputs, feeders, strict=False)
            )
        )

    return extend(())


def _gives(problem: Problem, labels: Iterable[str], tag: str) -> bool:
    return any(
        problem.similarity.holds(port.tag, tag)
        for label in labels
        for port in problem.environment.transformation[label].outputs
    )


def _leads_to(edges: list[tuple[str, str]], start: str, end: str) -> bool:
    """Whether `end` is `start` or is reached from it along the edges."""
    seen, ahead = {start}, [start]
    while ahead:
        here = ahead.pop()
        if here == end:
            return True
        new = [to for source, to in edges if source == here and to not in seen]
        seen.update(new)
        ahead += new
    return False
