"""Back-offs: the waits before transformations that keep failing are started again.

A failure counts for the host where it was: a camera or a library that one computer lacks says nothing of the others.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import inf
from typing import NamedTuple

from cfgplan_runtime.lifecycle.reports import BackingOff
from cfgplan_runtime.supervision.delays import doubling_s
from cfgplan_runtime.supervision.events import FailuresKept


class Place(NamedTuple):
    """A transformation by label, on a host; None: wherever it runs."""

    label: str
    host: str | None = None


@dataclass(frozen=True, slots=True)
class BackOffRules:
    """Times in seconds. The first failure in a row causes no wait, the second `first_s`, each further one twice the
    wait before.

    The failure of a unit that had lived for `good_life_s` counts as a first one. No wait is longer than `most_s`. A
    transformation that nothing can replace waits `alone_s` at most.
    """

    first_s: float = 1.0
    most_s: float = 300.0
    good_life_s: float = 60.0
    alone_s: float = 3.0

    def delay_s(self, failures: int) -> float:
        """The wait in seconds after `failures` failures in a row."""
        return doubling_s(failures, self.first_s, self.most_s)


@dataclass(frozen=True, slots=True)
class Record:
    """The failures in a row at a place, where nothing is started before `until_s`; `cause` is that of the last one."""

    failures: int
    until_s: float
    cause: str


@dataclass(frozen=True, slots=True)
class BackOffs:
    """The failures of transformations by place, and the places where they must not be started now. Immutable."""

    rules: BackOffRules
    records: Mapping[Place, Record] = field(default_factory=dict)
    avoided: frozenset[Place] = frozenset()

    def after_failure(
        self, place: Place, lived_s: float, now_s: float, cause: str, *, is_costly: bool = False
    ) -> BackOffs:
        """Count a failure of a unit that has lived for `lived_s`.

        After a costly one, which undid a whole update, even the first in a row causes a wait.
        """
        before = self.records.get(place)
        is_new = before is None or lived_s >= self.rules.good_life_s
        failures = 1 if is_new or before is None else before.failures + 1
        delay_s = self.rules.delay_s(failures + is_costly)
        return self._with(place, Record(failures, now_s + delay_s, cause), waits=delay_s > 0)

    def restoring(self, kept: FailuresKept, now_s: float) -> BackOffs:
        """Continue with the failures that an earlier manager has counted, unless some are known already."""
        place = Place(kept.transformation, kept.host)
        if place in self.records:
            return self
        return self._with(place, Record(kept.number, now_s + kept.left_s, kept.cause), waits=kept.left_s > 0)

    def refusing(self, label: str, cause: str) -> BackOffs:
        """Never start a transformation again, wherever, until it changes."""
        return self._with(Place(label), Record(1, inf, cause))

    def postponing(self, place: Place, until_s: float) -> BackOffs:
        """Do not start a transformation before `until_s`; this counts no failure."""
        before = self.records.get(place, Record(0, until_s, "its start would hold up another update"))
        return self._with(place, replace(before, until_s=max(before.until_s, until_s)))

    def shortening(self, label: str, now_s: float) -> BackOffs:
        """Cut the waits of a transformation that nothing can replace to `alone_s`. Returns self if nothing changes."""
        until_s = now_s + self.rules.alone_s
        late = {place for place in self.places_of(label) if until_s < self.records[place].until_s < inf}
        if not late:
            return self
        shorter = {place: replace(self.records[place], until_s=until_s) for place in late}
        return replace(self, records={**self.records, **shorter})

    def refusals(self) -> BackOffs:
        """The same failures, but avoid only transformations that are refused until they change."""
        return replace(self, avoided=frozenset(place for place in self.avoided if self.records[place].until_s == inf))

    def places_of(self, label: str) -> frozenset[Place]:
        """Where a transformation must not be started now."""
        return frozenset(place for place in self.avoided if place.label == label)

    def why_not(self, label: str, host: str | None) -> str | None:
        """Why a transformation must not be started on a host now; None if it may be. A refusal has its own cause."""
        place = next((one for one in (Place(label), Place(label, host)) if one in self.avoided), None)
        if place is None:
            return None
        return self.records[place].cause if self.records[place].until_s == inf else "after failures"

    def forgiving(self, *labels: str) -> BackOffs:
        """Forget the failures of transformations."""
        left = {place: record for place, record in self.records.items() if place.label not in labels}
        return replace(self, records=left, avoided=frozenset(one for one in self.avoided if one.label not in labels))

    def forgiving_all(self) -> BackOffs:
        """Forget all failures but refusals."""
        left = {place: record for place, record in self.records.items() if record.until_s == inf}
        return replace(self, records=left, avoided=self.avoided & left.keys())

    def at(self, now_s: float) -> BackOffs:
        """Stop avoiding places whose wait is over."""
        return replace(self, avoided=frozenset(one for one in self.avoided if self.records[one].until_s > now_s))

    @property
    def next_end_s(self) -> float:
        """When the next avoided transformation may be started again; inf if none is avoided."""
        return min((self.records[place].until_s for place in self.avoided), default=inf)

    def changed_since(self, before: BackOffs) -> frozenset[Place]:
        """The places whose failures differ from those before."""
        if self.records is before.records:
            return frozenset()
        places = self.records.keys() | before.records.keys()
        return frozenset(place for place in places if self.records.get(place) != before.records.get(place))

    def view(self, now_s: float) -> tuple[BackingOff, ...]:
        """The avoided transformations, sorted by label and host."""
        places = sorted(self.avoided, key=lambda place: (place.label, place.host or ""))
        return tuple(_view(place, self.records[place], now_s) for place in places)

    def _with(self, place: Place, record: Record, *, waits: bool = True) -> BackOffs:
        records, avoided = {**self.records, place: record}, self.avoided | {place} if waits else self.avoided
        return replace(self, records=records, avoided=avoided)


def _view(place: Place, record: Record, now_s: float) -> BackingOff:
    return BackingOff(place.label, record.failures, max(0.0, record.until_s - now_s), record.cause, place.host)
