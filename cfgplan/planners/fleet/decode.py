"""From a solution to units: named, wired, and without what nothing needs."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Collection, Iterable
from dataclasses import replace

from ortools.sat.python.cp_model import IntVar

from cfgplan.domain import ComputationUnit, Publication, Stream, Subscription
from cfgplan.planners.fleet.candidates import Candidates
from cfgplan.planners.fleet.model import Model
from cfgplan.planners.fleet.survivors import can_do_without
from cfgplan.planning import Problem, fresh_units


def solution(model: Model, holds: Callable[[IntVar], bool]) -> list[ComputationUnit]:
    """The units of a solution as they stand."""
    return [unit for i, there in model.is_there.items() if holds(there) for unit in [_unit(model, i, holds)]]


def decode(model: Model, units: list[ComputationUnit]) -> list[ComputationUnit]:
    """The lean configuration of a solution that survives what it has to; it costs no more than the solution says."""
    return named(model.candidates, lean(model.candidates, units))


def _unit(model: Model, index: int, holds: Callable[[IntVar], bool]) -> ComputationUnit:
    candidate = model.candidates.all[index]
    host = next(host for host, is_on in model.is_on[index].items() if holds(is_on))
    if index not in model.runs or not holds(model.runs[index]):
        return ComputationUnit(candidate.id, candidate.transformation.label, host=host, standby=True)
    subscriptions = tuple(
        Subscription(port.name, next(s for s, c in model.connects[index, port.name].items() if holds(c)))
        for port in candidate.transformation.inputs
    )
    publications = tuple(
        Publication(stream.port, topic)
        for topic, choices in model.publishes.items()
        for stream, publishes in choices.items()
        if stream.unit == candidate.id and holds(publishes)
    )
    return ComputationUnit(candidate.id, candidate.transformation.label, subscriptions, publications, host)


def lean(candidates: Candidates, units: Collection[ComputationUnit]) -> list[ComputationUnit]:
    """The units less those that no target, pin, number or failure needs, taken away one after the other.

    What has to survive failures does so before.
    """
    problem, left = candidates.problem, list(units)
    spares: set[str] = set()
    while True:
        roots = [u for u in left if u.publications or u.id in spares or _is_asked_for(problem, left, u)]
        needed = _needed(left, roots)
        needless = [unit for unit in left if unit.id not in needed]
        if not needless:
            return left
        # A unit that feeds another needless one goes after it; new units go before kept ones.
        fed_from = {s.stream.unit for unit in needless for s in unit.subscriptions if s.stream.unit != unit.id}
        last = [unit for unit in needless if unit.id not in fed_from] or needless
        goes = min(last, key=lambda unit: (unit.id in problem.environment.unit, unit.id))
        if can_do_without(candidates, left, goes):
            left = without_broken([unit for unit in left if unit is not goes])
        else:
            spares.add(goes.id)


def without_broken(units: list[ComputationUnit]) -> list[ComputationUnit]:
    """The units less those whose feeders are gone, as in a ring through feedback inputs that went."""
    while True:
        there = {unit.id for unit in units}
        whole = [unit for unit in units if all(s.stream.unit in there for s in unit.subscriptions)]
        if len(whole) == len(units):
            return units
        units = whole


def _is_asked_for(problem: Problem, units: Iterable[ComputationUnit], unit: ComputationUnit) -> bool:
    transformation = problem.environment.transformation[unit.transformation]
    if unit.standby or not (transformation.pinned or transformation.min_instances):
        return False
    if transformation.pinned and unit.id in problem.environment.unit:
        return True
    number = sum(other.transformation == unit.transformation and not other.standby for other in units)
    return number <= transformation.min_instances


def _needed(units: Iterable[ComputationUnit], roots: Iterable[ComputationUnit]) -> set[str]:
    by_id = {unit.id: unit for unit in units}
    ahead = [root.id for root in roots]
    needed = set(ahead)
    for unit_id in ahead:
        new = {s.stream.unit for s in by_id[unit_id].subscriptions} - needed
        needed |= new
        ahead += sorted(new)
    return needed


def named(candidates: Candidates, units: list[ComputationUnit]) -> list[ComputationUnit]:
    """New units with the first free ids, in canonical order of what they are."""
    new: dict[str, list[ComputationUnit]] = defaultdict(list)
    for unit in sorted(units, key=lambda unit: candidates.index_of[unit.id]):
        if candidates.all[candidates.index_of[unit.id]].running is None:
            new[unit.transformation].append(unit)
    ids = fresh_units(candidates.environment, {label: len(these) for label, these in sorted(new.items())})
    name = {u.id: new_id for label, these in new.items() for u, new_id in zip(these, ids[label], strict=True)}

    def renamed(stream: Stream) -> Stream:
        return Stream(name.get(stream.unit, stream.unit), stream.port)

    return [
        replace(
            unit,
            id=name.get(unit.id, unit.id),
            subscriptions=tuple(Subscription(s.port, renamed(s.stream)) for s in unit.subscriptions),
        )
        for unit in units
    ]
