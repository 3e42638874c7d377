"""Units that only wait for what may start again shortly: they stay, though nothing that runs needs them now."""

from __future__ import annotations

from collections.abc import Set
from dataclasses import replace

from cfgplan.domain import ChangeSet, ComputationUnit, Environment


def without_stopping(change_set: ChangeSet, running: Environment, spared: Set[str]) -> ChangeSet:
    """The change set without the stops of `spared` units. They keep what feeds them, and their topics."""
    stopped = tuple(unit for unit in change_set.stopped if unit not in spared)
    taken = {p.topic for unit in (*change_set.started, *change_set.rewired) for p in unit.publications}
    waiting = [_waiting(unit, set(stopped), taken) for unit in running.units if unit.id in spared]
    rewired = tuple(unit for unit in waiting if unit != running.unit[unit.id])
    return replace(change_set, stopped=stopped, rewired=(*change_set.rewired, *rewired))


def _waiting(unit: ComputationUnit, gone: Set[str], taken: Set[str]) -> ComputationUnit:
    subscriptions = tuple(s for s in unit.subscriptions if s.stream.unit not in gone)
    publications = tuple(p for p in unit.publications if p.topic not in taken)
    return replace(unit, subscriptions=subscriptions, publications=publications)
