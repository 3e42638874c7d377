"""The differences of two worlds, and the units that can keep running in the second."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TypeVar

from cfgplan.api import World
from cfgplan.domain import Transformation
from cfgplan.transformations import running_fields
from cfgplan_runtime.lifecycle.perturbations import Difference

T = TypeVar("T")


def can_run_as(one: Transformation, other: Transformation) -> bool:
    """Whether a unit of `one` can keep running as a unit of `other`: same code, params and ports."""
    return one is other or running_fields(one) == running_fields(other)


def difference(before: World, after: World) -> Difference:
    """The additions, removals and changes from one world to the other."""
    library, new_library = before.environment.transformation, after.environment.transformation
    targets, new_targets = before.environment.target, after.environment.target
    both = [(old, new_library[label]) for label, old in library.items() if label in new_library]
    names, new_names = before.ontology.individuals, after.ontology.individuals
    settings = {
        "horizon": before.horizon_s != after.horizon_s,
        "max_cost": before.max_cost_us != after.max_cost_us,
        "hosts": before.environment.hosts != after.environment.hosts,
        "transfer": before.environment.transfer_us != after.environment.transfer_us,
        "links": before.environment.links != after.environment.links,
        "minimise": before.environment.minimise != after.environment.minimise,
        "qualities": before.environment.qualities != after.environment.qualities,
        "facts": before.environment.facts != after.environment.facts,
        "survive": before.survive != after.survive,
    }
    return Difference(
        _missing(new_library, library),
        _missing(library, new_library),
        _labels(both, lambda old, new: not can_run_as(old, new)),
        _labels(both, lambda old, new: can_run_as(old, new) and not _same_but_for_costs(old, new)),
        _labels(both, lambda old, new: old != new and _same_but_for_costs(old, new)),
        _missing(new_targets, targets),
        _missing(targets, new_targets),
        tuple(label for label, old in targets.items() if label in new_targets and new_targets[label] != old),
        _missing(new_names, names),
        _missing(names, new_names),
        before.ontology != after.ontology,
        tuple(name for name, differs in settings.items() if differs),
    )


def _missing(some: Mapping[str, T], others: Mapping[str, T]) -> tuple[str, ...]:
    return tuple(sorted(name for name in some if name not in others))


def _labels(
    both: list[tuple[Transformation, Transformation]], differs: Callable[[Transformation, Transformation], bool]
) -> tuple[str, ...]:
    return tuple(old.label for old, new in both if old is not new and differs(old, new))


def _same_but_for_costs(old: Transformation, new: Transformation) -> bool:
    return old == replace(new, labor_us=old.labor_us, upkeep_us=old.upkeep_us)
