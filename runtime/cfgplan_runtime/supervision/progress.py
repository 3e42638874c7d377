"""An update under way: its aim, its steps so far, and the running configuration that it reads."""

from __future__ import annotations

from collections.abc import Mapping, Set
from dataclasses import dataclass, field
from typing import Protocol

from cfgplan.domain import ChangeSet, Environment, Stream
from cfgplan_runtime.supervision import wiring
from cfgplan_runtime.supervision.backend import Inlet
from cfgplan_runtime.supervision.handover_answers import HandoverAnswers


class Actual(Protocol):
    """The running configuration, at the moment of asking.

    `feeds` has each inlet's newest wire, which may not have switched yet.
    """

    @property
    def environment(self) -> Environment: ...
    @property
    def alive(self) -> Set[str]: ...
    @property
    def ready(self) -> Set[str]: ...
    @property
    def inactive(self) -> Set[str]:
        """The units that give nothing, since they are not connected yet."""

    @property
    def activating(self) -> Set[str]:
        """The units that were told to begin, and do not work yet."""

    @property
    def topics(self) -> Mapping[str, str | None]:
        """By topic that has an address: the host of its target."""

    @property
    def lost_hosts(self) -> Set[str]: ...
    @property
    def feeds(self) -> Mapping[Inlet, wiring.Wire]: ...
    @property
    def ends(self) -> Mapping[str, str]:
        """By unit that has ended without being told to: its end, as the predicate of a sentence."""

    @property
    def is_abandoned(self) -> bool: ...
    @property
    def answers(self) -> HandoverAnswers: ...
    def stop_s(self, unit: str) -> float | None:
        """The seconds that a unit may take to end, by its transformation; None if that has no `stop`."""

    def failure(self, unit: str) -> str | None:
        """The error of a unit's last failed step; None if none has failed."""

    def dry_units(self) -> Set[str]:
        """Units with outputs that have sent nothing for a while."""

    def is_followed(self, topics: Set[str]) -> bool:
        """Whether all followers of these topics are connected to them."""

    def now(self) -> float:
        """Seconds on a monotonic clock."""


@dataclass(frozen=True, slots=True)
class Progress:
    """A change set under way, which leads to the environment `after`. `wanted` has the stream that should feed each
    inlet.
    """

    actual: Actual
    change_set: ChangeSet
    after: Environment
    wanted: Mapping[Inlet, Stream]
    rewired: dict[Inlet, Stream | None] = field(default_factory=dict)
    """The former stream of each rewired inlet."""
    fresh: set[str] = field(default_factory=set)
    """The units that the update connects for the first time: new ones, and those that an undone update has kept."""
    needed: set[str] = field(default_factory=set)
    """The fresh units that have not begun yet: if one dies, the update is undone."""

    @property
    def started(self) -> list[str]:
        """The new units that run; cold spares are only recorded."""
        return [unit.id for unit in self.change_set.started if not unit.standby]

    def wired(self) -> Set[str]:
        """The units that are connected after the update."""
        return {stream.unit for stream in self.wanted.values()} | {inlet.unit for inlet in self.wanted}

    def switching(self) -> list[Inlet]:
        """The rewired inlets that have not switched yet."""
        return [inlet for inlet in self.rewired if self.is_switching(inlet)]

    def may_end(self, starved: Set[str] = frozenset()) -> bool:
        """Whether all rewired inlets have switched, except those that one of the `starved` units fed.

        The last inlet is checked first, because it switches last.
        """
        return all(self.replaces_one_of(starved, inlet) for inlet in reversed(self.rewired) if self.is_switching(inlet))

    def is_switching(self, inlet: Inlet) -> bool:
        feed = self.actual.feeds.get(inlet)
        return feed is not None and not feed.has_switched and self.lives(inlet)

    def lives(self, inlet: Inlet) -> bool:
        """Whether an inlet can be fed: its unit is alive, or its topic's host has joined."""
        if inlet.is_outlet:
            return self.actual.topics.get(inlet.port) not in self.actual.lost_hosts
        return inlet.unit in self.actual.alive

    def replaces_one_of(self, units: Set[str], inlet: Inlet) -> bool:
        """Whether one of these units fed a rewired inlet before."""
        old = self.rewired[inlet]
        return old is not None and old.unit in units

    def idle_units(self) -> set[str]:
        """The ending units that give no elements."""
        idle = wiring.starved_units(self.actual.environment) | self.actual.dry_units()
        return idle.intersection(self.change_set.stopped)

    def loading(self, units: Set[str]) -> list[str]:
        """The units of these that are not ready yet."""
        return sorted(units & self.actual.alive - self.actual.ready)

    def dead(self) -> list[str]:
        return sorted(self.needed - self.actual.alive)

    def fail_if_dead(self) -> None:
        dead = self.dead()
        if dead:
            raise StepFailedError(f"{dead[0]} {self.actual.ends.get(dead[0], 'died')}", dead)


class StepFailedError(Exception):
    """A step of an update that failed, to be undone."""

    def __init__(self, message: str, units: list[str], *, is_abandoned: bool = False) -> None:
        super().__init__(message)
        self.units = units
        self.is_abandoned = is_abandoned
