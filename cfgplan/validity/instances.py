"""Which units may be there together, and how many of each transformation."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator

from cfgplan.domain import Environment
from cfgplan.validity.rules import Rule, Violation


def instance_violations(environment: Environment) -> Iterator[Violation]:
    """Conflicting transformations that both have units, and too few or too many units of one."""
    there = Counter(unit.transformation for unit in environment.units)
    running = _running(environment)
    for transformation in environment.library:
        label = transformation.label
        for other in transformation.conflicts:
            if label in there and other in there and label != other:
                unit = next(u for u in environment.units if u.transformation == label)
                yield Violation(Rule.APART, f"units of {label} and {other} are there, which conflict", unit.id)
        if len(running[label]) < transformation.min_instances:
            text = f"{len(running[label])} units of {label} run, but it asks for {transformation.min_instances}"
            yield Violation(Rule.INSTANCES, text)
        if transformation.max_instances is not None and there[label] > transformation.max_instances:
            yield Violation(
                Rule.INSTANCES,
                f"{there[label]} units of {label} are there, but it allows {transformation.max_instances}",
            )


def asked_by_number(environment: Environment) -> set[str]:
    """The running units of transformations that have no more of them than they ask for."""
    running = _running(environment)
    return {
        unit_id
        for transformation in environment.library
        if len(running[transformation.label]) <= transformation.min_instances
        for unit_id in running[transformation.label]
    }


def _running(environment: Environment) -> dict[str, list[str]]:
    running: dict[str, list[str]] = defaultdict(list)
    for unit in environment.units:
        if not unit.standby:
            running[unit.transformation].append(unit.id)
    return running
