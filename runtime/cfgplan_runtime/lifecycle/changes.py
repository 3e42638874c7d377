"""Requests of users, tools and robots to a running manager."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TypeAlias

from cfgplan.api import World
from cfgplan.domain import ChangeSet, Target, Transformation


@dataclass(frozen=True, slots=True)
class Individual:
    """An individual of the ontology: the classes it belongs to, and its relations as (property, individual).

    Names are short names of the ontology, `prefix:name`, or IRIs. Templates expand over it.
    """

    name: str
    classes: tuple[str, ...] = ()
    relations: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True, slots=True)
class Add:
    """What is there from now on; what has a known label or name replaces the old one."""

    targets: tuple[Target, ...] = ()
    transformations: tuple[Transformation, ...] = ()
    individuals: tuple[Individual, ...] = ()


@dataclass(frozen=True, slots=True)
class Remove:
    """Labels of targets and transformations and names of individuals that are gone, wherever they were declared."""

    targets: tuple[str, ...] = ()
    transformations: tuple[str, ...] = ()
    individuals: tuple[str, ...] = ()


@dataclass(frozen=True)
class Declare:
    """Declare what an included file could, and `individuals`; a robot registers itself by this.

    `document` has `transformations` and `targets` in the environment file's form, templates too. Declaring again
    under the same `name` replaces what was declared.
    """

    name: str
    document: Mapping[str, object] = field(default_factory=dict, hash=False)
    individuals: tuple[Individual, ...] = ()


@dataclass(frozen=True, slots=True)
class Withdraw:
    """Take back the declaration of a name."""

    name: str


@dataclass(frozen=True, slots=True)
class Restore:
    """Take back that targets, transformations or individuals of these names were removed."""

    names: tuple[str, ...]


@dataclass(frozen=True)
class ReplaceWorld:
    """The environment file, or whatever else the world comes from, says something new."""

    world: World
    by: str


@dataclass(frozen=True, slots=True)
class KillUnit:
    """End a unit at once. Nobody is blamed, so the review that follows may start its transformation again."""

    unit: str


@dataclass(frozen=True, slots=True)
class RestartUnits:
    """Replace running units by new ones of the same transformations, wired as they are.

    Each new unit runs beside the old one until it gives. If one can't be started or only fails, all old ones stay.
    `by` is the file that has changed, or who asked.
    """

    units: tuple[str, ...]
    by: str = "request"


@dataclass(frozen=True, slots=True)
class LoseHost:
    """A host is gone, with everything that ran there."""

    host: str
    cause: str = ""


@dataclass(frozen=True, slots=True)
class RegainHost:
    """A host has come back."""

    host: str


@dataclass(frozen=True, slots=True)
class SetFact:
    """A fact of the world has a value from now on, written as in a file, whatever the file says."""

    name: str
    value: str


@dataclass(frozen=True)
class FaultyCode:
    """The code of these transformations can't be started, by label with the cause; that of all others may.

    The code of those `changed` is another one since the last time, so that their failures no longer count.
    """

    faults: Mapping[str, str] = field(hash=False)
    changed: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class ReviewNow:
    """Optimise now, as if the horizon were reached. Back-offs are forgiven."""

    by: str = "request"


@dataclass(frozen=True)
class ApplyPlan:
    """Carry out a plan that was made for `basis` (`basis.Basis`), if that is what runs and what is wanted."""

    change_set: ChangeSet
    basis: Mapping[str, Mapping[str, str]] = field(hash=False)
    by: str = "request"


@dataclass(frozen=True, slots=True)
class Stop:
    """Stop every unit, then the manager."""


WorldChange: TypeAlias = Add | Remove | Declare | Withdraw | Restore | ReplaceWorld
Change: TypeAlias = (
    WorldChange | KillUnit | RestartUnits | LoseHost | RegainHost | SetFact | FaultyCode | ReviewNow | ApplyPlan | Stop
)
