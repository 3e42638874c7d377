"""Looks: a transformation that may be better than the ones that run is run for some seconds, to observe its quality.

A transformation is observed only while it runs, and only on the hosts of its units. A place is a transformation on a
host; one without a host stands for all hosts where the transformation was neither observed nor looked at. If the
planner would choose a place with the quality that it may have, the transformation runs there for LOOK_S seconds without
subscribers; a slow stream is looked at until it has given enough elements. If a look finds nothing new, the next one at
this place comes later.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import inf
from types import MappingProxyType
from typing import Final, NamedTuple

from cfgplan.domain import ComputationUnit, Environment, Statement
from cfgplan.observed import Estimates, hoped_deviation
from cfgplan_runtime.lifecycle.back_off import Place
from cfgplan_runtime.lifecycle.seen_qualities import SeenQualities

LOOK_S: Final = 3.0
LONGEST_LOOK_S: Final = 60.0
"""A stream that has said too little by then is not waited for."""
LONGEST_INTERVAL_S: Final = 960.0
NEW: Final = 0.2
"""A look finds something new if a quality differs by more than this share from its known value."""
PAYS: Final = 2.0
"""A look is taken if the plan that it may lead to saves this many times the look's cost, or meets more targets;
experiments/observed/README.md has the figures.
"""


class Pause(NamedTuple):
    """When a place was looked at last, or could not be, and the seconds from then to its next look."""

    since_s: float
    interval_s: float


class Idle(NamedTuple):
    """When no transformation was worth a look, with which qualities and running units, and the seconds from then until
    the question is asked again if these stay the same.
    """

    since_s: float
    interval_s: float = 0.0
    qualities: Mapping[Statement, int] = MappingProxyType({})
    units: tuple[ComputationUnit, ...] = ()


@dataclass(frozen=True, slots=True)
class Looks:
    """When the next look at each place is due, and the look under way."""

    pauses: Mapping[Place, Pause] = field(default_factory=dict)
    """By place, also if its look observed nothing. A first look at a host also counts for the place without one."""
    idle: Idle = field(default_factory=lambda: Idle(0.0))
    """The last time when no look was taken; at first, the start of the run."""
    impossible: frozenset[Place] = frozenset()
    """The places for whose last look there was no room, or whose transformation shares a named state with another."""
    places: tuple[Place, ...] = ()
    """The place of the look; at the first look there, also the place without a host."""
    units: tuple[str, ...] = ()
    """The units of the look."""
    since_s: float = 0.0
    until_s: float = inf
    known: Mapping[Statement, int] = field(default_factory=dict)
    """The deviations of the observed outputs that were known before the look, in micro-units."""

    def next_s(self, qualities: Mapping[Statement, int], units: tuple[ComputationUnit, ...], least_s: float) -> float:
        """Return when looks may be taken again, given the qualities and the units of now."""
        is_same = self.idle.qualities == qualities and self.idle.units == units
        return self.idle.since_s + (max(self.idle.interval_s, least_s) if is_same else least_s)

    def idled(
        self,
        at_s: float,
        qualities: Mapping[Statement, int],
        units: tuple[ComputationUnit, ...],
        least_s: float,
    ) -> Looks:
        """Note that no look was worth its cost: if nothing changes, looks wait for twice as long as the last time."""
        is_same = self.idle.qualities == qualities and self.idle.units == units
        interval_s = min(2 * self.idle.interval_s, LONGEST_INTERVAL_S) if is_same else 0.0
        return replace(self, idle=Idle(at_s, max(interval_s, least_s), qualities, units))

    def due_s(self, place: Place, seen_s: float, least_interval_s: float) -> float:
        """Return when the next look is due at a place that was observed last at `seen_s`."""
        pause = self.pauses.get(place)
        return max(seen_s + least_interval_s, -inf if pause is None else pause.since_s + pause.interval_s)

    def begun(
        self,
        places: Sequence[Place],
        at_s: float,
        least_interval_s: float,
        *,
        is_possible: bool,
        known: Collection[Place],
    ) -> Looks:
        """Note that looks at places were planned. If `is_possible`, the last one was possible, and no other. The next
        look at each place comes after twice its interval, at least.
        """
        impossible = self.impossible.difference(places[-1:]) if is_possible else self.impossible
        impossible |= {*(places[:-1] if is_possible else places)}
        before = {each: self.pauses.get(each) for place in places for each in _counting(place, known)}
        doubled_s = {place: 0.0 if pause is None else 2 * pause.interval_s for place, pause in before.items()}
        new = {
            place: Pause(at_s, min(max(next_s, least_interval_s), LONGEST_INTERVAL_S))
            for place, next_s in doubled_s.items()
        }
        return replace(self, pauses={**self.pauses, **new}, impossible=impossible)

    def at(
        self,
        place: Place,
        statements: Iterable[Statement],
        qualities: Mapping[Statement, int],
        known: Collection[Place],
    ) -> Looks:
        """Look at outputs at a place, and keep their present deviations for comparison; see `known_places`."""
        return replace(self, places=_counting(place, known), known={one: qualities.get(one, 0) for one in statements})

    def running(self, units: tuple[str, ...], at_s: float) -> Looks:
        """Note that the units of the look run from now on."""
        return replace(self, units=units, since_s=at_s, until_s=at_s + LOOK_S)

    def ending(self, running: Environment, seen: SeenQualities, at_s: float) -> Looks:
        """End a look that has found something new, unless it still has to observe other outputs."""
        return replace(self, until_s=at_s) if self._has_seen_all(running, seen) else self

    def longer(self, running: Environment, seen: SeenQualities) -> Looks:
        """Continue a look at running units that have given too few elements, for LONGEST_LOOK_S at most."""
        is_running = any(unit in running.unit for unit in self.units)
        is_long = self.until_s >= self.since_s + LONGEST_LOOK_S
        if not is_running or is_long or self._has_seen_all(running, seen):
            return self
        return replace(self, until_s=self.until_s + LOOK_S)

    def _has_seen_all(self, running: Environment, seen: SeenQualities) -> bool:
        """Whether each output of the look has given enough elements, or its quality was learned since it began."""
        sampled = {
            Statement(unit.transformation, stream.port, attribute, unit.host)
            for (stream, attribute), window in seen.windows.items()
            if stream.unit in self.units and window.sample is not None and (unit := running.unit.get(stream.unit))
        }
        taught = {one for one in self.known if one in seen.estimates and seen.estimates[one].seen_s >= self.since_s}
        return self.known.keys() <= sampled | taught

    def over(self, world: Environment, qualities: Mapping[Statement, int], least_interval_s: float) -> Looks:
        """End the look; if it has found something new, the next one comes sooner."""
        has_taught = any(
            abs(qualities.get(one, 0) - seen) > NEW * abs(stated.stated + seen)
            for one, seen in self.known.items()
            if (stated := world.stated(one)) is not None
        )
        sooner = {
            place: self.pauses[place]._replace(interval_s=max(self.pauses[place].interval_s / 4, least_interval_s))
            for place in (self.places if has_taught else ())
        }
        return Looks({**self.pauses, **sooner}, self.idle, self.impossible)


def _counting(place: Place, known: Collection[Place]) -> tuple[Place, ...]:
    """Return the places for which a look counts: its own, and if that was not `known`, the one without a host."""
    return (place,) if place in known or place.host is None else (place, Place(place.label))


def known_places(running: Environment, estimates: Estimates, looks: Looks) -> frozenset[Place]:
    """Return the places on hosts where a transformation runs, was observed, or was looked at."""
    runs = (Place(unit.transformation, unit.host) for unit in running.units if not unit.standby)
    observed = (Place(statement.transformation, statement.host) for statement in estimates)
    return frozenset(place for place in (*runs, *observed, *looks.pauses) if place.host is not None)


def last_seen_s(
    world: Environment, running: Environment, estimates: Estimates, known: Collection[Place]
) -> dict[Place, float]:
    """Return when each place that a look can observe was last observed; -inf if it never was.

    A transformation has its `known` places, and one without a host while it may run on hosts that are not known. Three
    things are left out: places of running units; losses, which are measured only at subscribers; and qualities that a
    topic tells of a transformation that runs elsewhere, since they would be those of the other host.
    """
    runs = {Place(unit.transformation, unit.host) for unit in running.units if not unit.standby}
    running_labels, known_on = {place.label for place in runs}, dict[str, set[str | None]]()
    for place in known:
        if place.host in world.host:
            known_on.setdefault(place.label, set()).add(place.host)
    found: dict[Place, float] = {}

    def add(statement: Statement, anywhere: Statement, seen_s: float) -> None:
        place = Place(statement.transformation, statement.host)
        is_told_of_others = anywhere in world.told and place.label in running_labels
        if not (place in runs or anywhere in world.losing or is_told_of_others):
            found[place] = max(found.get(place, -inf), seen_s)

    for anywhere in world.observable:
        there = known_on.get(anywhere.transformation, set())
        if not world.hosts or world.observable_on[anywhere.transformation] - there:
            add(anywhere, anywhere, -inf)
        for host in there:
            add(anywhere._replace(host=host), anywhere, -inf)
    for statement, estimate in estimates.items():
        if world.stated(statement) is not None:
            add(statement, statement._replace(host=None), estimate.seen_s)
    return found


def hopes_of(place: Place, world: Environment, estimates: Estimates, at_s: float) -> dict[Statement, int]:
    """Return the deviations that the outputs of a transformation may have at a place if it is good, in micro-units."""
    found: dict[Statement, int] = {}
    for statement in dict.fromkeys((*(one._replace(host=place.host) for one in world.observable), *estimates)):
        stated, attribute = world.stated(statement), world.quality.get(statement.attribute)
        is_there = place == (statement.transformation, statement.host)
        if is_there and stated is not None and attribute is not None:
            found[statement] = hoped_deviation(stated, attribute, estimates.get(statement), at_s)
    return found
