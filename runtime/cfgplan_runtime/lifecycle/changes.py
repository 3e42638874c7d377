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
    """Add these parts; each replaces the part with the same label or name."""

    targets: tuple[Target, ...] = ()
    transformations: tuple[Transformation, ...] = ()
    individuals: tuple[Individual, ...] = ()


@dataclass(frozen=True, slots=True)
class Remove:
    """Remove targets and transformations by label, and individuals by name, wherever they were declared."""

    targets: tuple[str, ...] = ()
    transformations: tuple[str, ...] = ()
    individuals: tuple[str, ...] = ()


@dataclass(frozen=True)
class Declare:
    """Declare the content of an included file, and `individuals`; a robot registers itself by this.

    `document` has `transformations` and `targets` in the environment file's form, with templates. A second declaration
    under the same `name` replaces the first.
    """

    name: str
    document: Mapping[str, object] = field(default_factory=dict, hash=False)
    individuals: tuple[Individual, ...] = ()


@dataclass(frozen=True, slots=True)
class Withdraw:
    """Remove the declaration of a name."""

    name: str


@dataclass(frozen=True, slots=True)
class Restore:
    """Undo the removal of targets, transformations or individuals by these names."""

    names: tuple[str, ...]


@dataclass(frozen=True)
class ReplaceWorld:
    """Use a new world, from the environment file or another source.

    `code_faults` are the faults of its transformations' code; see FaultyCode. If None, the known faults still count.
    """

    world: World
    by: str
    code_faults: Mapping[str, str] | None = field(default=None, hash=False)


@dataclass(frozen=True, slots=True)
class KillUnit:
    """End a unit at once. It does not count as a failure, so the next review may start its transformation again."""

    unit: str


@dataclass(frozen=True, slots=True)
class RestartUnits:
    """Replace running units by new ones of the same transformations, wired as they are.

    Each new unit runs beside the old one until it sends elements. If one can't be started or only fails, all old ones
    stay. `by` is the changed file, or the requester.
    """

    units: tuple[str, ...]
    by: str = "request"


@dataclass(frozen=True, slots=True)
class LoseHost:
    """Take a host out of service, with everything that runs there."""

    host: str
    cause: str = ""


@dataclass(frozen=True, slots=True)
class RegainHost:
    """Use a host again that was taken out of service."""

    host: str


@dataclass(frozen=True, slots=True)
class SetFact:
    """Set a fact to a value, written as in a file, with priority over the file; a host's is called HOST.NAME."""

    name: str
    value: str


@dataclass(frozen=True)
class FaultyCode:
    """The code of these transformations can't be started, by label with the cause; the code of all others can.

    The code of those in `changed` has changed since the last time, so that their failures no longer count.
    """

    faults: Mapping[str, str] = field(hash=False)
    changed: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class ReviewNow:
    """Optimise now, as if the horizon were reached. Back-offs are forgiven."""

    by: str = "request"


@dataclass(frozen=True)
class ApplyPlan:
    """Carry out a plan that was made for `basis` (`basis.Basis`), if this is still the present basis."""

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
