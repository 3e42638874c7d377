"""The events that end a stable interval, as typed values (paper, section IV-C)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import msgspec

from cfgplan_runtime.supervision import events


class Perturbation(msgspec.Struct, frozen=True):
    """An event that ends a stable interval; each kind is a class of its own."""


class Started(Perturbation, frozen=True):
    """The manager has started, with no running units or with units that it has taken over."""


class UnitGone(Perturbation, frozen=True):
    """A unit has ended without being told to: it `hung` or grew `too large` and was killed, was `killed` on request, or
    ended as its `UnitDied` says.
    """

    unit: str
    transformation: str
    how: events.End | Literal["hung", "too large", "killed"]
    cause: str
    host: str | None = None


class UnitKeepsFailing(Perturbation, frozen=True):
    """A unit's code has failed in so many steps in a row that the unit is given up."""

    unit: str
    transformation: str
    failures: int
    text: str


class SubscriptionLost(Perturbation, frozen=True):
    """A living unit's input, or a topic (`unit` is null), has lost its source."""

    unit: str | None
    port: str


class TargetSilent(Perturbation, frozen=True):
    """No element has come on a target's topic for longer than the target may be silent; `units` send nothing."""

    target: str
    topic: str
    silent_s: float
    units: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Difference:
    """How two worlds differ, by label or name; `settings` names those that do: horizon, hosts and so on.

    Units of `replaced` transformations can't go on: source, params, ports, host or run differ. `changed`
    transformations differ in tags or flags only, `repriced` ones in costs only.
    """

    added_transformations: tuple[str, ...] = ()
    removed_transformations: tuple[str, ...] = ()
    replaced_transformations: tuple[str, ...] = ()
    changed_transformations: tuple[str, ...] = ()
    repriced_transformations: tuple[str, ...] = ()
    added_targets: tuple[str, ...] = ()
    removed_targets: tuple[str, ...] = ()
    changed_targets: tuple[str, ...] = ()
    added_individuals: tuple[str, ...] = ()
    removed_individuals: tuple[str, ...] = ()
    ontology: bool = False
    settings: tuple[str, ...] = ()

    def __bool__(self) -> bool:
        return any(getattr(self, name) for name in self.__dataclass_fields__)


class WorldChanged(Perturbation, frozen=True):
    """Transformations, targets, individuals or settings were added, removed or changed; `by` is the file or requester.

    `difference` has the labels that were added, removed, replaced, changed or repriced, the ontology and the settings.
    """

    by: str
    difference: Difference


class HostGone(Perturbation, frozen=True):
    """A host can't be reached any more, or was taken out of service: no unit can run there."""

    host: str
    cause: str = ""


class HostBack(Perturbation, frozen=True):
    """A host has joined, or may be used again."""

    host: str


class FactsChanged(Perturbation, frozen=True):
    """Facts have changed the environment of the plan.

    Transformations `left_out` may not run any more, those `back` may again, and outputs of those `requalified` are
    better or worse than before. `mapper on r1` means that facts of the host r1 forbid the mapper there.
    """

    left_out: tuple[str, ...] = ()
    back: tuple[str, ...] = ()
    requalified: tuple[str, ...] = ()


class QualitiesObserved(Perturbation, frozen=True):
    """Streams show that outputs are better or worse than planned; each is listed with its new and declared value."""

    outputs: tuple[str, ...]


class LinkMeasured(Perturbation, frozen=True):
    """A link between hosts carries another rate than planned, in bytes per second; null: no less than declared.

    `between` are the two selectors of its hosts.
    """

    between: tuple[str, str]
    rate: int | None


class LookDue(Perturbation, frozen=True):
    """A transformation that may be better than the running ones runs for some seconds, to observe its quality. `host`
    is the host of this look; null if the environment has no hosts.
    """

    transformation: str
    host: str | None = None


class LookOver(Perturbation, frozen=True):
    """The time of a look is over; the observed qualities of its units decide whether they stay."""

    units: tuple[str, ...]


class CodeChanged(Perturbation, frozen=True):
    """The code of units has changed: that of `left_out` can't be loaded (see `causes`), that of `back` can again."""

    left_out: tuple[str, ...] = ()
    back: tuple[str, ...] = ()
    causes: tuple[str, ...] = ()


class HorizonReached(Perturbation, frozen=True):
    """The time that the last update was planned for is over."""

    horizon_s: int


class UpdateFailed(Perturbation, frozen=True):
    """An update was undone (`is_undone`) or refused; `transformations` are those that could not be started.

    With `is_fault` the middleware has raised an exception outside its contract, so its state is unknown.
    """

    cause: str
    transformations: tuple[str, ...] = ()
    is_stale: bool = False
    is_fault: bool = False
    is_undone: bool = False


class MayStartAgain(Perturbation, frozen=True):
    """The back-off of transformations that kept failing is over."""

    transformations: tuple[str, ...]


class ReviewRequested(Perturbation, frozen=True):
    """A review that optimises, as at the horizon, was requested."""

    by: str = "request"


class RestartAsked(Perturbation, frozen=True):
    """A restart of units was requested; `by` is a file that has changed, or the requester."""

    units: tuple[str, ...]
    by: str


class PlanGiven(Perturbation, frozen=True):
    """A plan was given, to be carried out unchanged."""

    by: str
