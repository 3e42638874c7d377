"""What a manager knows beyond what runs: which transformation each unit is of, what is avoided, what to plan with."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

from cfgplan.domain import ChangeSet, ComputationUnit, Environment, Transformation
from cfgplan_runtime.lifecycle.back_off import BackOffs
from cfgplan_runtime.lifecycle.differing import runs_alike
from cfgplan_runtime.lifecycle.seams import Estimator
from cfgplan_runtime.lifecycle.silence import Silence

LARGEST_ESTIMATE_US = 10**12
"""Larger estimates are cut to this: 11 days of CPU time, which means never."""


@dataclass(frozen=True, slots=True)
class Running:
    """The transformation that a unit was started as, and when."""

    transformation: Transformation
    since_s: float


@dataclass(frozen=True, slots=True)
class Situation:
    """What is known of what runs, beyond its configuration."""

    back_offs: BackOffs
    units: Mapping[str, Running] = field(default_factory=dict)
    """By unit id, including units whose death has not been noticed yet."""
    failing: frozenset[str] = frozenset()
    """Ids of units that are given up though they run."""
    killed: frozenset[str] = frozenset()
    """Ids of units whose end was asked for."""
    lost_hosts: frozenset[str] = frozenset()
    silences: tuple[Silence, ...] = ()
    """Targets that count as unmet though a stream is published for them."""

    def label_of(self, unit: str) -> str | None:
        """The label of a unit's transformation; None if the unit is not known."""
        running = self.units.get(unit)
        return None if running is None else running.transformation.label

    def without(self, *gone: str) -> Situation:
        """The situation without these units."""
        left = {unit: running for unit, running in self.units.items() if unit not in gone}
        return replace(self, units=left, failing=self.failing.difference(gone), killed=self.killed.difference(gone))

    def with_started(self, units: Iterable[ComputationUnit], library: Environment, now_s: float) -> Situation:
        """Add the units that are not known yet: they run since `now_s` as `library` says."""
        known = library.transformation
        new = {
            unit.id: Running(known[unit.transformation], now_s)
            for unit in units
            if unit.id not in self.units and unit.transformation in known
        }
        return replace(self, units={**self.units, **new}) if new else self


class EstimatedLibrary:
    """Transformations with estimated instead of declared costs; the same object while its estimates stay the same."""

    def __init__(self) -> None:
        self._estimated: dict[str, tuple[Transformation, Transformation]] = {}

    def estimated(self, transformation: Transformation, estimator: Estimator, horizon_s: int) -> Transformation:
        labor_us = _capped(estimator.labor_us(transformation, horizon_s))
        upkeep_us = _capped(estimator.upkeep_us(transformation, horizon_s))
        if (labor_us, upkeep_us) == (transformation.labor_us, transformation.upkeep_us):
            return transformation
        declared, known = self._estimated.get(transformation.label, (None, transformation))
        if declared is not transformation or (known.labor_us, known.upkeep_us) != (labor_us, upkeep_us):
            known = replace(transformation, labor_us=labor_us, upkeep_us=upkeep_us)
            self._estimated[transformation.label] = (transformation, known)
        return known


def _capped(cost_us: int) -> int:
    return max(0, min(cost_us, LARGEST_ESTIMATE_US))


def avoided_now(world: Environment, running: Environment, situation: Situation) -> dict[str, str]:
    """Why transformations are left out, by label. One that backs off is not, while a good unit of it runs."""
    avoided: dict[str, str] = {}
    serving = {
        situation.units[unit.id].transformation.label: situation.units[unit.id].transformation
        for unit in running.units
        if unit.id in situation.units and unit.id not in situation.failing
    }
    for label, transformation in world.transformation.items():
        if transformation.host is not None and transformation.host in situation.lost_hosts:
            avoided[label] = f"host {transformation.host} is gone"
        elif label in situation.back_offs.avoided:
            served = serving.get(label)
            if served is None or not _has_ports_of(served, transformation):
                avoided[label] = situation.back_offs.refusal(label) or "it keeps failing"
    return avoided


def environment_to_plan(
    world: Environment,
    running: Environment,
    situation: Situation,
    avoided: Mapping[str, str],
    costs: Mapping[str, Transformation],
) -> Environment:
    """The environment that an update is planned for.

    A unit that can't go on (given up, or of a transformation that runs otherwise now) gets a label that the library
    does not have, so that the planner stops it, and replaces it where it is needed.
    """
    library = tuple(costs[label] for label in world.transformation if label not in avoided)
    units = tuple(_as_planned(unit, world, situation) for unit in running.units)
    return Environment(units, library, world.targets)


def _as_planned(unit: ComputationUnit, world: Environment, situation: Situation) -> ComputationUnit:
    now, known = world.transformation.get(unit.transformation), situation.units.get(unit.id)
    is_old = (
        now is not None
        and known is not None
        and not runs_alike(known.transformation, now)
        and now.label not in situation.back_offs.avoided
    )
    if is_old or unit.id in situation.failing:
        return replace(unit, transformation=f"{unit.transformation} (to be replaced)")
    return unit


def _has_ports_of(one: Transformation, other: Transformation) -> bool:
    return (set(one.input), set(one.output)) == (set(other.input), set(other.output))


def with_world(change_set: ChangeSet, world: Environment, known: Environment) -> ChangeSet:
    """Add to a change set over units how library and targets get from `known` to `world`."""
    return replace(
        change_set,
        added_transformations=tuple(
            t for label, t in world.transformation.items() if known.transformation.get(label) != t
        ),
        removed_transformations=tuple(sorted(set(known.transformation) - set(world.transformation))),
        added_targets=tuple(target for label, target in world.target.items() if known.target.get(label) != target),
        removed_targets=tuple(sorted(set(known.target) - set(world.target))),
    )
