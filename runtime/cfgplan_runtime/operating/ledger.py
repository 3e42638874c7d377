"""What each unit has cost over the time that it was observed."""

from __future__ import annotations

import threading
from collections.abc import Iterable
from dataclasses import dataclass

from cfgplan_runtime.supervision.observation import Observation


@dataclass(frozen=True, slots=True)
class LedgerEntry:
    """A unit's last observation, and its mean upkeep since the first one, in microseconds of CPU time per second."""

    seen: Observation
    upkeep_us: int | None


class Ledger:
    """What each unit used, as of the last observation. Thread-safe."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._first: dict[str, tuple[float, int]] = {}
        self._entries: tuple[LedgerEntry, ...] = ()

    def note(self, observations: Iterable[Observation], now_s: float) -> None:
        """Note an observation of all units: a missing one has ended. An observation without units is ignored."""
        found = tuple(observations)
        if not found:
            return
        with self._lock:
            known = {seen.unit: self._first.get(seen.unit, (now_s, seen.cpu_us)) for seen in found}
            # A unit that has used less CPU time than before is a new one of the same id.
            self._first = {s.unit: known[s.unit] if s.cpu_us >= known[s.unit][1] else (now_s, s.cpu_us) for s in found}
            self._entries = tuple(LedgerEntry(seen, self._upkeep_us(seen, now_s)) for seen in found)

    def entries(self) -> tuple[LedgerEntry, ...]:
        """The units of the last observation, by id."""
        with self._lock:
            return self._entries

    def _upkeep_us(self, seen: Observation, now_s: float) -> int | None:
        since_s, cpu_us = self._first[seen.unit]
        return round((seen.cpu_us - cpu_us) / (now_s - since_s)) if now_s > since_s else None
