"""Whether a configuration bears every single failure: what is left can still be wired to meet every target."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace

from cfgplan.domain import ComputationUnit, Environment, Similarity, Target, Transformation
from cfgplan.planning import Failures
from cfgplan.validity.reading import known_units
from cfgplan.validity.rules import Rule, Violation
from cfgplan.validity.startable import different_choices_exist


def survival_violations(
    environment: Environment, similarity: Similarity, survive: Failures | None
) -> Iterator[Violation]:
    """Each single failure that leaves a target without a stream, whatever is rewired and whatever spare starts."""
    units = list(known_units(environment))
    for what, lost, targets in _failures(environment, survive):
        left = [(unit, transformation) for unit, transformation in units if unit.id not in lost]
        for target in _unmet(left, similarity, targets):
            text = f"if {what} fails, nothing else can meet target {target.label}"
            yield Violation(Rule.SURVIVES, text, next(iter(lost)) if len(lost) == 1 else None, target=target.label)


def justified_spares(environment: Environment, similarity: Similarity, survive: Failures | None) -> set[str]:
    """The units without which the others would not bear some failure."""
    if survive is None:
        return set()
    return {
        unit.id
        for unit in environment.units
        if any(survival_violations(_without(environment, unit), similarity, survive))
    }


def _without(environment: Environment, unit: ComputationUnit) -> Environment:
    return replace(environment, units=tuple(other for other in environment.units if other != unit))


def _failures(environment: Environment, survive: Failures | None) -> Iterator[tuple[str, set[str], tuple[Target, ...]]]:
    """Each failure in words, the units lost by it and the targets that are still there."""
    if survive is None:
        return
    for unit in environment.units:
        if not unit.standby:
            yield f"unit {unit.id}", {unit.id}, environment.targets
    for host in environment.hosts if survive is Failures.HOSTS else ():
        lost = {unit.id for unit in environment.units if unit.host == host.name}
        yield f"host {host.name}", lost, tuple(target for target in environment.targets if target.host != host.name)


def _unmet(
    left: list[tuple[ComputationUnit, Transformation]], similarity: Similarity, targets: tuple[Target, ...]
) -> Iterator[Target]:
    """The targets that no wiring of what is left meets: more units never hurt, so all of them may run."""
    anywhere = left
    while True:
        before: list[tuple[ComputationUnit, Transformation]] = []
        while True:
            more = [one for one in anywhere if one not in before and _can_run(one, before, anywhere, similarity)]
            if not more:
                break
            before += more
        if len(before) == len(anywhere):
            break
        anywhere = before
    for target in targets:
        if target.run is not None:
            is_met = any(kind.label == target.run for _, kind in anywhere)
        else:
            is_met = any(similarity.holds(port.tag, target.tag) for _, kind in anywhere for port in kind.outputs)
        if not is_met:
            yield target


def _can_run(
    one: tuple[ComputationUnit, Transformation],
    before: list[tuple[ComputationUnit, Transformation]],
    anywhere: list[tuple[ComputationUnit, Transformation]],
    similarity: Similarity,
) -> bool:
    unit, kind = one
    there = {other.transformation for other, _ in anywhere if other.host == unit.host}
    groups: dict[str, dict[str, set[str]]] = defaultdict(dict)
    for port in kind.inputs:
        feeders = {
            feeder.label
            for _, feeder in (anywhere if port.feedback else before)
            if any(similarity.holds(output.tag, port.tag) for output in feeder.outputs)
        }
        groups[port.distinct if port.distinct is not None else f"\0{port.name}"][port.name] = feeders
    return there.issuperset(kind.beside) and all(different_choices_exist(group) for group in groups.values())
