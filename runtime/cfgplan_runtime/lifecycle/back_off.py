"""Transformations that keep failing: how long each is left alone before it is started again."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import inf

from cfgplan_runtime.lifecycle.reports import BackingOff
from cfgplan_runtime.supervision.delays import doubling_s


@dataclass(frozen=True, slots=True)
class BackOffRules:
    """Times in seconds. The first failure costs no time, the next `first_s`, each further one twice as much.

    A unit that had lived for `good_life_s` fails as if for the first time. Where nothing else can take a unit's place,
    it waits no longer than `alone_s`.
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


class BackOffs:
    """The failures of transformations, by label. One thread changes them, any may look."""

    def __init__(self, rules: BackOffRules) -> None:
        self._rules = rules
        self._records: Mapping[str, _Record] = {}
        self._waiting: frozenset[str] = frozenset()

    def failed(self, label: str, lived_s: float, now_s: float, cause: str, *, is_costly: bool = False) -> None:
        """A unit has failed after so long a life.

        One that `is_costly`, since it took a whole update with it, is not repeated at once.
        """
        before = self._records.get(label)
        is_new = before is None or lived_s >= self._rules.good_life_s
        failures = 1 if is_new or before is None else before.failures + 1
        delay_s = self._rules.delay_s(failures + is_costly)
        self._note(label, _Record(failures, now_s + delay_s, cause), waits=delay_s > 0)

    def refuse(self, label: str, cause: str) -> None:
        """Never start a transformation again, until it changes."""
        self._note(label, _Record(1, inf, cause), waits=True)

    def postpone(self, label: str, until_s: float) -> None:
        """Leave a transformation alone for a while; nobody is to blame."""
        before = self._records.get(label, _Record(0, until_s, "its start would hold up another update"))
        self._note(label, replace(before, until_s=max(before.until_s, until_s)), waits=True)

    def shorten(self, label: str, now_s: float) -> bool:
        """Nothing else can take a transformation's place: it waits for `alone_s` at most. Whether that is shorter."""
        record = self._records[label]
        until_s = now_s + self._rules.alone_s
        if label not in self._waiting or not until_s < record.until_s < inf:
            return False
        self._note(label, replace(record, until_s=until_s), waits=True)
        return True

    def refusals(self) -> BackOffs:
        """Only what is never to be started until it changes."""
        refusals = BackOffs(self._rules)
        refusals._records = self._records
        refusals._waiting = frozenset(label for label in self._waiting if self._records[label].until_s == inf)
        return refusals

    def refusal(self, label: str) -> str | None:
        """Why a transformation is not to be started until it changes, if so it is."""
        record = self._records.get(label)
        return record.cause if record is not None and record.until_s == inf else None

    def forgive(self, label: str) -> None:
        """Forget the failures of a transformation."""
        self._waiting -= {label}
        self._records = {other: record for other, record in self._records.items() if other != label}

    def forgive_all(self) -> None:
        """Forget all failures but refusals."""
        for label in [label for label, record in self._records.items() if record.until_s != inf]:
            self.forgive(label)

    def ended(self, now_s: float) -> tuple[str, ...]:
        """The transformations whose time has come since the last call."""
        ended = sorted(label for label in self._waiting if self._records[label].until_s <= now_s)
        self._waiting = self._waiting.difference(ended)
        return tuple(ended)

    @property
    def avoided(self) -> frozenset[str]:
        """The transformations that must not be started now."""
        return self._waiting

    @property
    def next_end_s(self) -> float:
        """When the next of them may be started again; inf if none."""
        return min((self._records[label].until_s for label in self._waiting), default=inf)

    def view(self, now_s: float) -> tuple[BackingOff, ...]:
        """Those that are waiting, by label."""
        records = self._records
        return tuple(_view(label, records[label], now_s) for label in sorted(self._waiting & records.keys()))

    def of(self, label: str, now_s: float) -> BackingOff | None:
        """How it stands with one that is waiting."""
        return _view(label, self._records[label], now_s) if label in self._waiting else None

    def _note(self, label: str, record: _Record, *, waits: bool) -> None:
        self._records = {**self._records, label: record}
        if waits:
            self._waiting |= {label}


def _view(label: str, record: _Record, now_s: float) -> BackingOff:
    return BackingOff(label, record.failures, max(0.0, record.until_s - now_s), record.cause)
