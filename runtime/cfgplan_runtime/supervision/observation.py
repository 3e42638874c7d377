"""Observations of running units: their costs, rates, queues and last errors, and their mean costs over time."""

from __future__ import annotations

import threading
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from cfgplan_runtime.children.messages import PortCounts
from cfgplan_runtime.supervision.backend import Usage
from cfgplan_runtime.supervision.events import UnitFailed, UnitStatus

_SHORTEST_INTERVAL_S = 0.5
"""The rate is counted over at least this long, since signs of life may be read together."""


@dataclass(frozen=True, slots=True)
class Observation:
    """One unit as observed, with the label of its `transformation` and its `host`, if it has one.

    `labor_us` is the CPU time of its start, `cpu_us` that of its whole life, and `upkeep_us` the CPU time per second
    since the last observation, None at the first; all in microseconds. It takes `memory_bytes` now. `steps` and
    `errors` (failed steps) count from its start, and `last_error` is the text of the last one. `steps_per_s` is over
    the time between two signs of life. `inputs` and `outputs` have the counts of each port.
    """

    unit: str
    transformation: str
    labor_us: int
    upkeep_us: int | None
    cpu_us: int = 0
    memory_bytes: int = 0
    steps: int = 0
    steps_per_s: float = 0.0
    errors: int = 0
    last_error: str | None = None
    inputs: Mapping[str, PortCounts] = field(default_factory=dict, hash=False)
    outputs: Mapping[str, PortCounts] = field(default_factory=dict, hash=False)
    pid: int | None = None
    """Its process id, where it has a process."""
    host: str | None = None

    @property
    def dropped(self) -> int:
        """The number of elements that were dropped before they reached this unit."""
        return sum(counts.dropped for counts in self.inputs.values())


@dataclass(slots=True)
class UnitRecord:
    """The supervisor's record of a unit."""

    transformation: str
    host: str | None = None
    labor_us: int = 0
    sign_s: float = 0.0
    """The time of its last sign of life, on `Supervisor.now`."""
    state_name: str | None = None
    """The name of its state, if it has one."""
    status: UnitStatus | None = None
    steps_per_s: float = 0.0
    failure: UnitFailed | None = None
    killed_s: float | None = None
    _last_cpu_us: int = 0
    _last_s: float | None = None
    gave_s: float = 0.0
    """The time when it was last known to have sent an element."""
    _given: int = 0
    _counted: tuple[int, float] | None = None
    """The sign of life from which the rate is counted: its steps, and when it came."""

    @property
    def waiting(self) -> int:
        """How many elements waited at its inputs at its last sign of life."""
        return 0 if self.status is None else sum(counts.waiting for counts in self.status.inputs.values())

    def note_status(self, status: UnitStatus, now_s: float) -> None:
        """Note the counts of a sign of life."""
        steps, at_s = self._counted or (status.steps, now_s)
        if self._counted is None or now_s - at_s >= _SHORTEST_INTERVAL_S:
            self._counted = status.steps, now_s
            self.steps_per_s = (status.steps - steps) / (now_s - at_s) if now_s > at_s else 0.0
        given = sum(counts.elements for counts in status.outputs.values())
        if self.status is None or given != self._given:
            self._given, self.gave_s = given, now_s
        self.status = status

    def observe(self, unit: str, usage: Usage, now_s: float) -> Observation:
        """The unit as it is now. Its upkeep is the mean since the last call, None at the first."""
        upkeep = None
        if self._last_s is not None and now_s > self._last_s:
            upkeep = round((usage.cpu_us - self._last_cpu_us) / (now_s - self._last_s))
        self._last_cpu_us, self._last_s = usage.cpu_us, now_s
        status = self.status
        return Observation(
            unit,
            self.transformation,
            self.labor_us,
            upkeep,
            usage.cpu_us,
            usage.memory_bytes,
            status.steps if status else 0,
            self.steps_per_s,
            status.errors if status else 0,
            self.failure.text if self.failure else None,
            status.inputs if status else {},
            status.outputs if status else {},
            usage.pid,
            self.host,
        )


@dataclass(frozen=True, slots=True)
class LedgerEntry:
    """A unit's last observation, and its mean upkeep since the first one, in microseconds of CPU time per second."""

    seen: Observation
    upkeep_us: int | None


class Ledger:
    """The use of each unit, as of the last observation. Thread-safe."""

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
