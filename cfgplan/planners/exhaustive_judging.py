"""How the oracle judges a finished configuration of a fleet: cost, leanness, failures.

It asks the judge which quality is reached, what is carried, and what a unit costs on its host.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations, product

from cfgplan.domain import CPU, ComputationUnit, Target
from cfgplan.errors import InputError
from cfgplan.planning import Failures, Problem
from cfgplan.validity.hosts import carried_us, costs_there
from cfgplan.validity.quality import priced_us, quality_violations

OracleKey = tuple[int, int, int, int]
"""Unused required transformations, cost in microseconds, rewired units, started units: the least is best."""
Units = tuple[ComputationUnit, ...]

MOST_STEPS = 100_000
"""More steps, each of which feeds one input or topic of one set of units, are refused."""


class Steps:
    """Counts the steps of one enumeration."""

    def __init__(self) -> None:
        self.number = 0

    def take(self) -> None:
        """Count a step. Raises InputError after `MOST_STEPS`."""
        self.number += 1
        if self.number > MOST_STEPS:
            raise InputError.of(
                f"the exhaustive planner tries every wiring and {MOST_STEPS:,} steps were too few for it",
                mend="use the planner cpsat",
            )


def cost_of_units(problem: Problem, units: Units) -> int:
    cost = 0
    for unit in units:
        transformation = problem.environment.transformation[unit.transformation]
        labor_us, upkeep_us, standby_us = costs_there(problem.environment, unit, transformation)
        cost += (standby_us if unit.standby else upkeep_us) * problem.horizon_s
        if unit.id not in problem.environment.unit and not unit.standby:
            cost += labor_us
    return cost


def taken_by(problem: Problem, unit: ComputationUnit) -> Mapping[str, int]:
    """How much a unit takes of each resource of its host."""
    transformation = problem.environment.transformation[unit.transformation]
    return {**transformation.takes, CPU: costs_there(problem.environment, unit, transformation)[1]}


def is_borne(problem: Problem, units: Sequence[ComputationUnit]) -> bool:
    """Whether no single failure leaves a target without a stream."""
    environment = problem.environment
    if problem.survive is None:
        return True
    failures: list[tuple[list[ComputationUnit], list[Target]]] = [
        ([left for left in units if left != unit], list(environment.targets)) for unit in units if not unit.standby
    ]
    if problem.survive is Failures.HOSTS:
        failures += [
            (
                [left for left in units if left.host != host.name],
                [t for t in environment.targets if t.host != host.name],
            )
            for host in environment.hosts
        ]
    return all(
        all(is_met_by(problem, possible, target) for target in targets)
        for left, targets in failures
        for possible in [runnable(problem, left)]
    )


def key_of(problem: Problem, units: Units) -> OracleKey | None:
    """The key of a wiring, or None if a bound is missed or a unit is there that nothing needs."""
    environment = problem.environment
    after = replace(environment, units=units)
    if any(quality_violations(after)) or not _is_lean(problem, units):
        return None
    used = {unit.transformation for unit in needed_by(units, [unit for unit in units if unit.publications])}
    unused = sum(t.required and t.label not in used for t in environment.library)
    cost = cost_of_units(problem, units) + carried_us(after, problem.horizon_s) + priced_us(after)
    changes = environment.change_to(units)
    return unused, cost, len(changes.rewired), len(changes.started)


def _is_lean(problem: Problem, units: Units) -> bool:
    environment = problem.environment
    number = Counter(unit.transformation for unit in units if not unit.standby)
    roots = []
    for unit in units:
        transformation = environment.transformation[unit.transformation]
        is_pinned = transformation.pinned and unit.id in environment.unit and not unit.standby
        is_asked_for = not unit.standby and number[unit.transformation] <= transformation.min_instances
        is_spare = not is_borne(problem, [other for other in units if other != unit])
        if unit.publications or is_pinned or is_asked_for or is_spare:
            roots.append(unit)
    return len(needed_by(units, roots)) == len(units)


def needed_by(units: Sequence[ComputationUnit], roots: Sequence[ComputationUnit]) -> list[ComputationUnit]:
    by_id = {unit.id: unit for unit in units}
    needed = {unit.id: unit for unit in roots}
    ahead = list(roots)
    while ahead:
        for subscription in ahead.pop().subscriptions:
            feeder = by_id[subscription.stream.unit]
            if feeder.id not in needed:
                needed[feeder.id] = feeder
                ahead.append(feeder)
    return list(needed.values())


def reached_from(edges: list[tuple[str, str]], start: str) -> set[str]:
    """The units reached from one along the streams, that one included."""
    seen, ahead = {start}, [start]
    while ahead:
        here = ahead.pop()
        new = {to for source, to in edges if source == here} - seen
        seen |= new
        ahead += new
    return seen


def runnable(problem: Problem, units: Sequence[ComputationUnit]) -> list[ComputationUnit]:
    """The largest part of the units that can be wired with each other: found by removing what can't be fed."""
    alive = list(units)
    while True:
        order: list[ComputationUnit] = []
        while True:
            more = [unit for unit in alive if unit not in order and _feeds_exist(problem, unit, order, alive)]
            if not more:
                break
            order += more
        if len(order) == len(alive):
            return alive
        alive = order


def _feeds_exist(
    problem: Problem, unit: ComputationUnit, before: list[ComputationUnit], alive: list[ComputationUnit]
) -> bool:
    """Whether the inputs of a unit can be fed, by trying every choice of transformations that feed them."""
    inputs = problem.environment.transformation[unit.transformation].inputs
    choices = [
        {other.transformation for other in (alive if port.feedback else before) if _gives(problem, other, port.tag)}
        for port in inputs
    ]
    return any(
        all(
            first.distinct is None or first.distinct != second.distinct or one != other
            for (first, one), (second, other) in combinations(list(zip(inputs, feeders, strict=True)), 2)
        )
        for feeders in product(*choices)
    )


def _gives(problem: Problem, unit: ComputationUnit, tag: str) -> bool:
    outputs = problem.environment.transformation[unit.transformation].outputs
    return any(problem.similarity.holds(port.tag, tag) for port in outputs)


def is_met_by(problem: Problem, units: Sequence[ComputationUnit], target: Target) -> bool:
    return any(_gives(problem, unit, target.tag) for unit in units)
