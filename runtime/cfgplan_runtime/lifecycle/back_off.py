"""Transformations that keep failing: how long each is left alone before it is started again."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

from cfgplan_runtime.lifecycle.reports import BackingOff


@dataclass(frozen=True, slots=True)
class BackOffRules:
    """Times in seconds. The first failure costs no time, the next `first_s`, each further one twice as much.

    A unit that had lived for `good_life_s` fails as if for the first time.
    """

    first_s: float = 1.0
    most_s: float = 300.0
    good_life_s: float = 60.0

    def delay_s(self, failures: int) -> float:
        """How long to wait after so many failures in a row."""
        if failures < 2:
            return 0.0
        return min(self.most_s, self.first_s * 2.0 ** min(failures - 2, 60))


@dataclass(slots=True)
class _Record:
    failures: int
    until_s: float
    cause: str


class BackOffs:
    """The failures of transformations, by label."""

    def __init__(self, rules: BackOffRules) -> None:
        self._rules = rules
        self._records: dict[str, _Record] = {}
        self._waiting: set[str] = set()

    def failed(self, label: str, lived_s: float, now_s: float, cause: str, *, is_costly: bool = False) -> None:
        """A unit has failed after so long a life. A failure that `is_costly` is not repeated at once."""
        before = self._records.get(label)
        is_new = before is None or lived_s >= self._rules.good_life_s
        failures = (0 if is_new or before is None else before.failures) + (2 if is_costly else 1)
        delay_s = self._rules.delay_s(failures)
        self._records[label] = _Record(failures, now_s + delay_s, cause)
        if delay_s:
            self._waiting.add(label)

    def refuse(self, label: str, cause: str) -> None:
        """Never start a transformation again, until it changes."""
        self._records[label] = _Record(1, inf, cause)
        self._waiting.add(label)

    def forgive(self, label: str) -> None:
        """Forget the failures of a transformation."""
        self._records.pop(label, None)
        self._waiting.discard(label)

    def forgive_all(self) -> None:
        """Forget all failures but refusals."""
        for label in [label for label, record in self._records.items() if record.until_s != inf]:
            self.forgive(label)

    def ended(self, now_s: float) -> tuple[str, ...]:
        """The transformations whose time has come since the last call."""
        ended = sorted(label for label in self._waiting if self._records[label].until_s <= now_s)
        self._waiting.difference_update(ended)
        return tuple(ended)

    @property
    def avoided(self) -> frozenset[str]:
        """The transformations that must not be started now."""
        return frozenset(self._waiting)

    @property
    def next_end_s(self) -> float:
        """When the next of them may be started again; inf if none."""
        return min((self._records[label].until_s for label in self._waiting), default=inf)

    def view(self, now_s: float) -> tuple[BackingOff, ...]:
        """Those that are waiting, by label."""
        return tuple(self._view(label, now_s) for label in sorted(self._waiting))

    def of(self, label: str, now_s: float) -> BackingOff | None:
        """How it stands with one that is waiting."""
        return self._view(label, now_s) if label in self._waiting else None

    def _view(self, label: str, now_s: float) -> BackingOff:
        record = self._records[label]
        return BackingOff(label, record.failures, max(0.0, record.until_s - now_s), record.cause)
