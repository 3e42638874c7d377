"""Whether a configuration bears every single failure: what is left can still be wired to meet every target."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

from cfgplan.domain import ComputationUnit, Environment, Similarity, Target, Transformation
from cfgplan.planning import Failures
from cfgplan.validity.reading import known_units
from cfgplan.validity.rules import Rule, Violation
from cfgplan.validity.startable import givers_by_tag, startable


def survival_violations(
    environment: Environment, similarity: Similarity, survive: Failures | None
) -> Iterator[Violation]:
    """Each single failure that leaves a target without a stream, whatever is rewired and whatever spare starts."""
    if survive is None:
        return
    units, givers = list(known_units(environment)), givers_by_tag(environment, similarity)
    for what, lost, targets in _failures(environment, survive):
        left = [(unit, transformation) for unit, transformation in units if unit.id not in lost]
        for target in _unmet(left, givers, similarity, targets):
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


def _failures(environment: Environment, survive: Failures) -> Iterator[tuple[str, set[str], tuple[Target, ...]]]:
    """Each failure in words, the units lost by it and the targets that are still there."""
    for unit in environment.units:
        if not unit.standby:
            yield f"unit {unit.id}", {unit.id}, environment.targets
    for host in environment.hosts if survive is Failures.HOSTS else ():
        lost = {unit.id for unit in environment.units if unit.host == host.name}
        yield f"host {host.name}", lost, tuple(target for target in environment.targets if target.host != host.name)


def _unmet(
    left: list[tuple[ComputationUnit, Transformation]],
    givers: Mapping[str, set[str]],
    similarity: Similarity,
    targets: tuple[Target, ...],
) -> Iterator[Target]:
    """The targets that no wiring of what is left meets: more units never hurt, so all of them may run."""
    while True:
        labels = startable(Environment((), tuple({kind.label: kind for _, kind in left}.values())), similarity)
        there = {(unit.transformation, unit.host) for unit, _ in left}
        able = [
            (unit, kind)
            for unit, kind in left
            if kind.label in labels and all((other, unit.host) in there for other in kind.beside)
        ]
        if len(able) == len(left):
            break
        left = able
    yield from (target for target in targets if labels.isdisjoint(givers.get(target.tag, ())))
