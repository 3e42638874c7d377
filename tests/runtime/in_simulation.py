"""A supervisor whose units are there only in thought."""

from __future__ import annotations

from collections.abc import Mapping

from cfgplan_runtime import SimulatedBackend, Supervisor
from cfgplan_runtime.supervision.events import Event
from cfgplan_runtime.supervision.simulated_backend import Behaviour

from cfgplan.domain import Environment


class InSimulation:
    def __init__(self, environment: Environment, behaviours: Mapping[str, Behaviour]) -> None:
        self.backend = SimulatedBackend(dict(behaviours))
        self.events: list[Event] = []
        self.supervisor = Supervisor(self.backend, environment, self.events.append)

    def pass_time(self, seconds: float) -> None:
        end = self.backend.now() + seconds
        while self.backend.now() < end:
            self.supervisor.pump(end - self.backend.now())

    def asked(self, *verbs: str) -> list[tuple[str, ...]]:
        """What the backend was asked to do."""
        return [call for call in self.backend.calls if call[0] in verbs]
