"""The configuration of a run as SVG, made from the run's record by the drawing of `cfgplan graph`."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import replace

from cfgplan.domain import (
    A_UNIT_OF,
    ChangeSet,
    ComputationUnit,
    Environment,
    Host,
    Target,
)
from cfgplan.drawing import picture
from cfgplan_runtime.operating.protocol import Record
from cfgplan_runtime.operating.records import units_of


def configuration(state: Record) -> Environment:
    """The units and targets of a run's state (`cfgplan/manual/control.md`), without any library."""
    units = units_of(state["units"])
    return Environment(units, targets=tuple(map(_target, state["targets"])), hosts=_hosts(units))


def anew(review: Record) -> tuple[str, ...]:
    """The ids of the units that a review has started."""
    return tuple(unit["id"] for unit in (review["change_set"] or {"started": ()})["started"])


def without(environment: Environment, units: Collection[str]) -> Environment:
    """The environment without some units; what they fed names them still."""
    return replace(environment, units=tuple(unit for unit in environment.units if unit.id not in units))


def svg(before: Environment, now: Environment) -> str:
    """What runs now; what has been started, rewired and stopped since `before` is marked."""
    there, was = now.unit, before.unit
    changes = ChangeSet(
        started=tuple(unit for unit in now.units if unit.id not in was),
        rewired=tuple(unit for unit in now.units if unit.id in was and was[unit.id] != unit),
        stopped=tuple(unit.id for unit in before.units if unit.id not in there),
    )
    hosts = _hosts((*before.units, *now.units))
    text = picture(Environment(before.units, targets=now.targets, hosts=hosts), changes).render("svg").decode()
    return text[text.index("<svg") :]


def _hosts(units: Iterable[ComputationUnit]) -> tuple[Host, ...]:
    return tuple(map(Host, sorted({unit.host for unit in units if unit.host is not None})))


def _target(target: Record) -> Target:
    if not target["topic"]:
        return Target(target["label"], run=target["tag"].removeprefix(A_UNIT_OF))
    return Target(target["label"], target["tag"], target["topic"], target["priority"])
