"""Whether a configuration survives every single failure: the remaining units can be wired to meet every target."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

from cfgplan.domain import ComputationUnit, Environment, Similarity, Target
from cfgplan.planning import Failures
from cfgplan.validity.facts import known_units
from cfgplan.validity.rules import Rule, Violation
from cfgplan.validity.startable import providers_by_tag, startable

if TYPE_CHECKING:
    from cfgplan.validity.rewiring import Known


def survival_violations(
    environment: Environment, similarity: Similarity, survive: Failures | None
) -> Iterator[Violation]:
    """Yield each single failure that leaves a target without a stream, for any rewiring and any start of spares."""
    if survive is None:
        return
    from cfgplan.validity.rewiring import Rewiring

    units, providers = list(known_units(environment)), providers_by_tag(environment, similarity)
    for what, lost, targets in _failures(environment, survive):
        left = _able([(unit, kind) for unit, kind in units if unit.id not in lost], similarity)
        labels, lone = {kind.label for _, kind in left}, next(iter(lost)) if len(lost) == 1 else None
        unmet = [target for target in targets if labels.isdisjoint(providers.get(target.tag, ()))]
        for target in unmet:
            text = f"if {what} fails, nothing else can meet target {target.label}"
            yield Violation(Rule.SURVIVES, text, lone, target=target.label)
        if not unmet and not Rewiring(left, similarity, targets).exists():
            text = f"if {what} fails, the remaining units can't be wired to meet all targets"
            yield Violation(Rule.SURVIVES, text, lone)


def justified_spares(
    environment: Environment, similarity: Similarity, survive: Failures | None, but: Collection[str] = ()
) -> set[str]:
    """Return the ids of the units, except `but`, without which the others would not survive some failure."""
    if survive is None:
        return set()
    return {
        unit.id
        for unit in environment.units
        if unit.id not in but and any(survival_violations(_without(environment, unit), similarity, survive))
    }


def _without(environment: Environment, unit: ComputationUnit) -> Environment:
    return replace(environment, units=tuple(other for other in environment.units if other != unit))


def _failures(environment: Environment, survive: Failures) -> Iterator[tuple[str, set[str], tuple[Target, ...]]]:
    """Yield each failure in words, the lost units and the remaining targets."""
    for unit in environment.units:
        if not unit.standby:
            yield f"unit {unit.id}", {unit.id}, environment.targets
    for host in environment.hosts if survive is Failures.HOSTS else ():
        lost = {unit.id for unit in environment.units if unit.host == host.name}
        yield f"host {host.name}", lost, tuple(target for target in environment.targets if target.host != host.name)


def _able(left: list[Known], similarity: Similarity) -> list[Known]:
    """Return the units that can run if all of them may: more units never hurt unless they compete for streams."""
    while True:
        library = tuple({kind.label: kind for _, kind in left}.values())
        labels = startable(Environment((), library), similarity, Counter(kind.label for _, kind in left))
        there = {(unit.transformation, unit.host) for unit, _ in left}
        able = [
            (unit, kind)
            for unit, kind in left
            if kind.label in labels and all((other, unit.host) in there for other in kind.beside)
        ]
        if len(able) == len(left):
            return able
        left = able
