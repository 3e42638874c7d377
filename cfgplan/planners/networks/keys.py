"""The key of a configuration in the order of optimality (Definition 10 and its ties), and its parts that may stay."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import NamedTuple

from cfgplan.domain import ALL, ComputationUnit, Environment, Objective
from cfgplan.figures import cost_parts, used_hosts
from cfgplan.onward import reached
from cfgplan.planning import Feature, Problem


class Key(NamedTuple):
    """The order of optimality: a configuration with a smaller key is better."""

    unused: int
    """Required transformations that serve no target."""
    first: tuple[int, ...]
    """Whether it costs more than is allowed, and the objectives in order; empty where the cost alone is minimised."""
    cost_us: int
    rewired: int
    started: int


def key_of(problem: Problem, units: Collection[ComputationUnit]) -> Key:
    """How good a configuration is; its cost has transfers, spares and missed quality in it."""
    before, parts = problem.environment.unit, cost_parts(problem, units)
    started = sum([unit.id not in before for unit in units])
    rewired = sum([unit.id in before and unit != before[unit.id] for unit in units])
    first: tuple[int, ...] = ()
    if Feature.ORDER in problem.features:
        values = {
            Objective.RENT: parts.rent_us,
            Objective.COST: parts.total_us,
            Objective.UNITS: sum(not unit.standby for unit in units),
            Objective.HOSTS: len(used_hosts(problem.environment, units)),
            Objective.REWIRED: rewired,
            Objective.STARTED: started,
        }
        is_too_dear = problem.max_cost_us is not None and parts.total_us > problem.max_cost_us
        first = int(is_too_dear), *(values[each] for each in problem.environment.minimise)
    return Key(len(unused_required(problem, units)), first, parts.total_us, rewired, started)


def unused_required(problem: Problem, units: Collection[ComputationUnit]) -> tuple[str, ...]:
    """The labels of the required transformations without a unit that serves a target."""
    if not problem.environment.required:
        return ()
    by_id = {unit.id: unit for unit in units}
    meeting = [unit.id for unit in problem.environment.meeting(units).values()]
    serving = reached(meeting, lambda unit_id: needed_feeders(problem.environment, by_id[unit_id]))
    used = {by_id[unit_id].transformation for unit_id in serving}
    return tuple(label for label in problem.environment.required if label not in used)


def needed_feeders(environment: Environment, unit: ComputationUnit) -> set[str]:
    """The units that have to run since they feed this one, except at inputs that start nothing; by id."""
    idle = environment.transformation[unit.transformation].idle_inputs
    return {s.stream.unit for s in unit.subscriptions if s.port not in idle}


def may_stay(problem: Problem, labels: Collection[str], unit: ComputationUnit) -> bool:
    """Whether the unit's wiring is valid, looked at by itself, if only units of these labels run."""
    there = problem.environment.unit

    def label_of(unit_id: str) -> str | None:
        label = there[unit_id].transformation if unit_id in there else None
        return label if label in labels else None

    return is_well_wired(problem, label_of, unit)


def is_well_wired(problem: Problem, label_of: Callable[[str], str | None], unit: ComputationUnit) -> bool:
    """Whether a unit's wiring is valid, looked at by itself.

    `label_of` tells the transformation of a unit that runs; None if it does not run.
    """
    environment, holds = problem.environment, problem.similarity.holds
    transformation = environment.transformation[unit.transformation]
    feeds, fed = unit.feeds, 0
    feeders: set[tuple[str, str]] = set()
    for port in transformation.inputs:
        streams = feeds.get(port.name, ())
        fed += bool(streams)
        if len(streams) != 1 or port.count != 1:
            feeding = {stream.unit for stream in streams}
            is_odd = unit.id in feeding if port.count == ALL else port.count > 1 and len(feeding) < len(streams)
            if is_odd or not port.takes(len(streams)):
                return False
        for stream in streams:
            label = label_of(stream.unit)
            output = None if label is None else environment.transformation[label].output.get(stream.port)
            if label is None or output is None or not holds(output.tag, port.tag):
                return False
            if port.distinct is not None and (port.distinct, label) in feeders:
                return False
            if port.distinct is not None:
                feeders.add((port.distinct, label))
    if fed < len(feeds):  # it takes streams at an input that its transformation does not have
        return False
    if not unit.publications:
        return True
    wanted = {target.topic: target.tag for target in environment.stream_targets}
    return all(
        publication.topic in wanted
        and publication.port in transformation.output
        and holds(transformation.output[publication.port].tag, wanted[publication.topic])
        for publication in unit.publications
    )
