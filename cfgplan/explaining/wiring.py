"""Faults in the wiring of the running configuration, the most probable fault first.

The judge reports broken rules. This module adds optional inputs that probably should be fed, and streams that no unit
subscribes to. Each input is listed with the streams most similar to its demand: one misspelt topic name leaves both
an input without a stream and a similar stream without a subscriber.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import cache
from itertools import islice

from cfgplan.domain import ComputationUnit, Environment, InputPort, Stream, Subscription
from cfgplan.matching import Nearest
from cfgplan.validity import Rule, Violation

MOST_NEAR = 3
"""The number of similar streams listed for an input."""
ALIKE = 0.6
"""The least likeness of two tags' texts for a stream to be listed, if none is similar by meaning."""
_SERVICE = re.compile(r"\b(srv|action)\b")
"""The mark of a service in an output's type; its occasional clients are unknown, so it never counts as unused."""


class Suspicion(IntEnum):
    """A kind of wiring fault; the smaller the value, the more probably it is the cause and to be mended first."""

    REMAP = 0
    """A node is told to rename a topic that it does not have."""
    QOS = 1
    """Nodes that are wired directly do not hear each other, since their qualities of service do not fit."""
    STOPPED = 2
    """An input is not fed, and its possible feeder does not run."""
    CLASH = 3
    """An input is fed by a stream that does not match it."""
    PAIR = 4
    """An input is not fed, and a similar stream has no subscriber."""
    NUMBER = 5
    """An input takes too many streams or too few."""
    PERHAPS = 6
    """An optional input is not fed, and a similar stream has no subscriber."""
    TAKEN = 7
    """An input is not fed, and the similar streams have other subscribers."""
    NAMESAKE = 8
    """An input is not fed, and the similar streams are so by name only."""
    OTHER = 9
    """Another rule is broken."""
    ALONE = 10
    """An input is not fed, and no stream is similar."""
    NEEDLESS = 11
    """A unit runs that no target needs, mostly because it no longer feeds an input."""
    UNTAKEN = 12
    """A stream has no subscriber."""


_ODD: Mapping[Suspicion, str] = {Suspicion.REMAP: "remap", Suspicion.QOS: "qos", Suspicion.UNTAKEN: "untaken"}
"""The oddity of each suspicion that breaks no rule; a suspicion that is missing here is an unfed input."""


@dataclass(frozen=True, slots=True)
class NearStream:
    """A stream similar to an input's demand, whether it has subscribers, and its likeness (0 to 1).

    A stream that does not run is named by its transformation instead of a unit.
    """

    stream: Stream
    offer: Nearest
    is_taken: bool
    likeness: float
    by_name: bool = False
    runs: bool = True

    @property
    def verdict(self) -> str:
        """Its tag, the missing parts, and whether it is free, in words."""
        if not self.runs:
            return f"{self.offer.offered}: {self.offer.verdict}, but does not run"
        return f"{self.offer.offered}: {self.offer.verdict}{'' if self.is_taken else '; nothing subscribes to it'}"


@dataclass(frozen=True, slots=True)
class WiringFault:
    """A wrong or an odd wiring; an odd one breaks no rule, and its `violation` is None."""

    suspicion: Suspicion
    text: str
    violation: Violation | None = None
    unit: str | None = None
    port: str | None = None
    near: tuple[NearStream, ...] = ()

    @property
    def rule(self) -> str:
        """The name of the broken rule, or of the oddity."""
        if self.violation is not None:
            return self.violation.rule.name.lower()
        return _ODD.get(self.suspicion, "unfed")

    @property
    def breaks(self) -> bool:
        """Whether the fault keeps the configuration from working."""
        return self.violation is not None or self.suspicion is Suspicion.QOS

    @property
    def key(self) -> tuple[str, str]:
        """A key that identifies the fault, in this environment and in others."""
        return self.rule, self.text


def wiring_demands(environment: Environment, violations: Sequence[Violation]) -> set[str]:
    """The tags for which `wiring_faults` needs near offers."""
    return {port.tag for _, port in [*_unfed(environment), *_broken(environment, violations)]}


def wiring_faults(
    environment: Environment, violations: Sequence[Violation], near: Mapping[str, Sequence[Nearest]]
) -> tuple[WiringFault, ...]:
    """All faults and oddities of the running configuration, the probable fault first.

    `near` has the offers near to each demand.
    """
    return tuple(sorted(_Wiring(environment, near).faults(violations), key=probable_first))


def probable_first(fault: WiringFault) -> tuple[int, float, str]:
    """The key that sorts faults: by suspicion, then by how near a stream comes, then by text."""
    return fault.suspicion, -fault.near[0].likeness if fault.near else 0.0, fault.text


def _unfed(environment: Environment) -> Iterator[tuple[ComputationUnit, InputPort]]:
    """The inputs of running units that nothing feeds."""
    for unit in environment.units:
        transformation = environment.transformation.get(unit.transformation)
        for port in transformation.inputs if transformation and not unit.standby else ():
            if port.name not in unit.feeds:
                yield unit, port


def _broken(environment: Environment, violations: Sequence[Violation]) -> Iterator[tuple[ComputationUnit, InputPort]]:
    """The inputs at which rules are broken."""
    for violation in violations:
        found = _input_of(environment, violation)
        if found is not None:
            yield found


def _input_of(environment: Environment, violation: Violation) -> tuple[ComputationUnit, InputPort] | None:
    unit = environment.unit.get(violation.unit or "")
    transformation = unit and environment.transformation.get(unit.transformation)
    port = transformation and transformation.input.get(violation.port or "")
    return (unit, port) if unit and port else None


class _Wiring:
    """The streams of running units, and their subscribers."""

    def __init__(self, environment: Environment, near: Mapping[str, Sequence[Nearest]]) -> None:
        self._environment = environment
        self._near = near
        running = [unit for unit in environment.units if not unit.standby]
        self._taken = {s.stream for unit in running for s in unit.subscriptions}
        self._taken |= {Stream(unit.id, p.port) for unit in running for p in unit.publications}
        self._offering: dict[str, list[Stream]] = {}
        for unit in running:
            transformation = environment.transformation.get(unit.transformation)
            for output in transformation.outputs if transformation else ():
                self._offering.setdefault(output.tag, []).append(Stream(unit.id, output.name))
                if output.type is not None and _SERVICE.search(output.type):
                    self._taken.add(Stream(unit.id, output.name))

        there = {unit.transformation for unit in running}
        self._stopped = [each for each in environment.library if each.label not in there]

    def faults(self, violations: Sequence[Violation]) -> Iterator[WiringFault]:
        told, paired = set(), set()
        for violation in violations:
            fault = self._of_rule(violation)
            told.add((fault.unit, fault.port))
            paired |= {near.stream for near in fault.near}
            yield fault
        for unit, port in _unfed(self._environment):
            near = self._nearest(unit, port)
            if (unit.id, port.name) not in told and _of_unfed(near) is Suspicion.PAIR:
                paired |= {each.stream for each in near}
                text = f"optional input {port.name} of unit {unit.id} is not fed"
                yield WiringFault(Suspicion.PERHAPS, text, None, unit.id, port.name, near)
        for stream in sorted(s for streams in self._offering.values() for s in streams):
            if stream not in self._taken and stream not in paired:
                text = f"{stream} has no subscriber"
                yield WiringFault(Suspicion.UNTAKEN, text, None, stream.unit, stream.port)

    def _of_rule(self, violation: Violation) -> WiringFault:
        found = _input_of(self._environment, violation)
        is_fed = found is not None and found[1].name in found[0].feeds
        near: tuple[NearStream, ...] = ()
        suspicion = Suspicion.OTHER
        if violation.rule is Rule.LEAN:
            suspicion = Suspicion.NEEDLESS
        elif violation.rule is Rule.FED and is_fed:
            suspicion = Suspicion.NUMBER
        elif violation.rule in (Rule.FED, Rule.MATCHING):
            near = (self._stopped_givers(found[1]) if not is_fed else ()) or self._nearest(*found) if found else ()
            suspicion = _of_unfed(near)
            if violation.rule is Rule.MATCHING:
                near, suspicion = tuple(each for each in near if not each.by_name), Suspicion.CLASH
        return WiringFault(suspicion, violation.text, violation, violation.unit, violation.port, near)

    def _stopped_givers(self, port: InputPort) -> tuple[NearStream, ...]:
        """The outputs that would feed an input if they ran."""
        whole = {near.offered: near for near in self._near.get(port.tag, ()) if not near.missing and not near.undecided}
        streams = (
            NearStream(Stream(kind.label, output.name), whole[output.tag], False, 1.0, runs=False)
            for kind in self._stopped
            for output in kind.outputs
            if output.tag in whole
        )
        return tuple(islice(streams, MOST_NEAR))

    def _nearest(self, unit: ComputationUnit, port: InputPort) -> tuple[NearStream, ...]:
        """Return the other units' streams most similar to an input's demand, or else those with similar names."""
        alike = (Nearest(offered, (port.tag,)) for offered in self._offering if likeness(offered, port.tag) >= ALIKE)
        found: list[NearStream] = []
        meant = (offer for offer in self._near.get(port.tag, ()) if not offer.by_name)
        for offers, by_name in ((meant, False), (alike, True)):
            found = found or [
                NearStream(stream, offer, stream in self._taken, likeness(offer.offered, port.tag), by_name)
                for offer in offers
                for stream in self._offering.get(offer.offered, ())
                if stream.unit != unit.id and Subscription(port.name, stream) not in unit.subscriptions
            ]
        found.sort(key=lambda near: (len(near.offer.missing), near.is_taken, -near.likeness, near.stream))
        return tuple(found[:MOST_NEAR])


def _of_unfed(near: Sequence[NearStream]) -> Suspicion:
    if not near:
        return Suspicion.ALONE
    if not near[0].runs:
        return Suspicion.STOPPED
    if near[0].by_name:
        return Suspicion.NAMESAKE
    return Suspicion.TAKEN if all(each.is_taken for each in near) else Suspicion.PAIR


def likeness(one: str, other: str) -> float:
    """Return the likeness of two texts, from 0 to 1: Dice's coefficient of their runs of three characters."""
    ours, theirs = _runs(one), _runs(other)
    return 2 * len(ours & theirs) / (len(ours) + len(theirs))


@cache
def _runs(text: str) -> frozenset[str]:
    padded = f"  {text} "
    return frozenset(padded[at : at + 3] for at in range(len(padded) - 2))
