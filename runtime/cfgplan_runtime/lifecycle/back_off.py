"""Transformations that keep failing: how long each is left alone before it is started again."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import inf

from cfgplan_runtime.lifecycle.reports import BackingOff
from cfgplan_runtime.supervision.delays import doubling_s


@dataclass(frozen=True, slots=True)
class BackOffRules:
    """Times in seconds. The first failure in a row causes no wait, the second `first_s`, each further one twice that.

    The failure of a unit that had lived for `good_life_s` is a first one. A transformation that nothing can replace
    waits `alone_s` at most.
    """

    first_s: float = 1.0
    most_s: float = 300.0
    good_life_s: float = 60.0
    alone_s: float = 3.0

    def delay_s(self, failures: int) -> float:
        """How long to wait after so many failures in a row."""
        return doubling_s(failures, self.first_s, self.most_s)


@dataclass(frozen=True, slots=True)
class _Record:
    failures: int
    until_s: float
    cause: str


@dataclass(frozen=True, slots=True)
class BackOffs:
    """The failures of transformations by label, and the labels that must not be started now. Immutable."""

    rules: BackOffRules
    records: Mapping[str, _Record] = field(default_factory=dict)
    avoided: frozenset[str] = frozenset()

    def after_failure(
        self, label: str, lived_s: float, now_s: float, cause: str, *, is_costly: bool = False
    ) -> BackOffs:
        """Count a failure of a unit that has lived for `lived_s`.

        After a costly one, which undid a whole update, even the first in a row causes a wait.
        """
        before = self.records.get(label)
        is_new = before is None or lived_s >= self.rules.good_life_s
        failures = 1 if is_new or before is None else before.failures + 1
        delay_s = self.rules.delay_s(failures + is_costly)
        return self._with(label, _Record(failures, now_s + delay_s, cause), waits=delay_s > 0)

    def refusing(self, label: str, cause: str) -> BackOffs:
        """Never start a transformation again, until it changes."""
        return self._with(label, _Record(1, inf, cause))

    def postponing(self, label: str, until_s: float) -> BackOffs:
        """Do not start a transformation before `until_s`; this counts no failure."""
        before = self.records.get(label, _Record(0, until_s, "its start would hold up another update"))
        return self._with(label, replace(before, until_s=max(before.until_s, until_s)))

    def shortening(self, label: str, now_s: float) -> BackOffs:
        """Cut the wait of a transformation that nothing can replace to `alone_s`. Returns self if nothing changes."""
        until_s = now_s + self.rules.alone_s
        if label not in self.avoided or not until_s < self.records[label].until_s < inf:
            return self
        return self._with(label, replace(self.records[label], until_s=until_s))

    def refusals(self) -> BackOffs:
        """The same failures, but avoid only transformations that are refused until they change."""
        return replace(self, avoided=frozenset(label for label in self.avoided if self.records[label].until_s == inf))

    def refusal(self, label: str) -> str | None:
        """Why a transformation is refused until it changes; None if it is not."""
        record = self.records.get(label)
        return record.cause if record is not None and record.until_s == inf else None

    def forgiving(self, *labels: str) -> BackOffs:
        """Forget the failures of transformations."""
        left = {label: record for label, record in self.records.items() if label not in labels}
        return replace(self, records=left, avoided=self.avoided.difference(labels))

    def forgiving_all(self) -> BackOffs:
        """Forget all failures but refusals."""
        return self.forgiving(*(label for label, record in self.records.items() if record.until_s != inf))

    def at(self, now_s: float) -> BackOffs:
        """Avoid no longer what has waited long enough."""
        return replace(self, avoided=frozenset(one for one in self.avoided if self.records[one].until_s > now_s))

    @property
    def next_end_s(self) -> float:
        """When the next avoided transformation may be started again; inf if none is avoided."""
        return min((self.records[label].until_s for label in self.avoided), default=inf)

    def view(self, now_s: float) -> tuple[BackingOff, ...]:
        """The avoided transformations, sorted by label."""
        return tuple(_view(label, self.records[label], now_s) for label in sorted(self.avoided))

    def _with(self, label: str, record: _Record, *, waits: bool = True) -> BackOffs:
        records, avoided = {**self.records, label: record}, self.avoided | {label} if waits else self.avoided
        return replace(self, records=records, avoided=avoided)


def _view(label: str, record: _Record, now_s: float) -> BackingOff:
    return BackingOff(label, record.failures, max(0.0, record.until_s - now_s), record.cause)
