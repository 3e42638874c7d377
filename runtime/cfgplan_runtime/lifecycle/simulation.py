"""A runtime in thought: the supervisor's own logic on a clock that jumps. No process, no waiting."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Mapping

from cfgplan.domain import ChangeSet, Environment, Target, Transformation
from cfgplan_runtime.supervision.applying import Patience
from cfgplan_runtime.supervision.events import Applied, Event
from cfgplan_runtime.supervision.observation import Observation
from cfgplan_runtime.supervision.simulated_backend import Behaviour, SimulatedBackend
from cfgplan_runtime.supervision.supervisor import Supervisor


class SimulatedRuntime:
    """A `Middleware` whose units run only in thought. Give its `clock` to the manager, without a thread."""

    def __init__(
        self,
        library: Iterable[Transformation] = (),
        targets: Iterable[Target] = (),
        *,
        behaviours: Mapping[str, Behaviour] | None = None,
        patience: Patience | None = None,
    ) -> None:
        self._listeners: list[Callable[[Event], None]] = []
        self._patience = patience
        self.backend = SimulatedBackend(dict(behaviours or {}))
        self.supervisor = Supervisor(self.backend, Environment((), tuple(library), tuple(targets)), self._report)
        self.clock = SimulatedClock(self.supervisor)

    @property
    def environment(self) -> Environment:
        """What runs now."""
        return self.supervisor.environment

    def apply(self, change_set: ChangeSet, *, basis: Environment | None = None) -> Applied:
        """See `Supervisor.apply`."""
        return self.supervisor.apply(change_set, basis=basis, patience=self._patience)

    def attempt(self, change_set: ChangeSet, *, basis: Environment | None = None) -> Applied:
        """As `apply`, but new units that have not failed stay when the update is undone, unconnected."""
        return self.supervisor.apply(change_set, basis=basis, patience=self._patience, keeps_new=True)

    def observe(self) -> tuple[Observation, ...]:
        """See `Supervisor.observe`."""
        return self.supervisor.observe()

    def abandon(self) -> None:
        """See `Supervisor.abandon`."""
        self.supervisor.abandon()

    def kill(self, unit: str) -> None:
        """End a unit at once."""
        self.backend.kill(unit)

    def cut(self, unit: str | None, port: str) -> None:
        """See `Supervisor.cut`."""
        self.supervisor.cut(unit, port)

    def listen(self, listener: Callable[[Event], None]) -> None:
        """Have every event told, in order."""
        self._listeners.append(listener)

    def stop(self) -> None:
        """Stop every unit."""
        self.apply(ChangeSet(stopped=tuple(unit.id for unit in self.environment.units)))

    def _report(self, event: Event) -> None:
        for listener in self._listeners:
            listener(event)


class SimulatedClock:
    """The time of a simulated backend, which moves only while somebody waits."""

    def __init__(self, supervisor: Supervisor) -> None:
        self._supervisor = supervisor

    def now(self) -> float:
        return self._supervisor.backend.now()

    def wait(self, bell: threading.Event, timeout_s: float) -> None:
        end = self.now() + timeout_s
        while not bell.is_set() and self.now() < end:
            self._supervisor.pump(end - self.now())
