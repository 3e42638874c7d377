"""A manager of simulated units, for the tests of the life-cycle."""

from __future__ import annotations

from concurrent.futures import Future
from typing import Any, TypeVar

from cfgplan_runtime import Manager, Policy, SimulatedRuntime
from cfgplan_runtime.lifecycle.changes import Change
from cfgplan_runtime.lifecycle.perturbations import Perturbation
from cfgplan_runtime.lifecycle.reports import Perturbed, Report, Review
from cfgplan_runtime.supervision.simulated_backend import Behaviour

from cfgplan import api
from cfgplan.domain import Environment, InputPort, OutputPort, Target, Transformation

P = TypeVar("P")
RESULT = Target("result", "Y", "/result")
HORIZON_S = 60


def source(label: str = "count", *, tag: str = "N", labor_us: int = 1000, **more: Any) -> Transformation:
    more.setdefault("source", f"units.py:{label}")
    return Transformation(label, outputs=(OutputPort("n", tag),), labor_us=labor_us, **more)


def worker(
    label: str = "work", *, needs: str = "N", gives: str = "Y", labor_us: int = 1000, upkeep_us: int = 100, **more: Any
) -> Transformation:
    more.setdefault("source", f"units.py:{label}")
    ports = (InputPort("x", needs),), (OutputPort("y", gives),)
    return Transformation(label, *ports, labor_us=labor_us, upkeep_us=upkeep_us, **more)


class Life:
    """A library, the target /result unless others are given, and what the manager has told so far."""

    def __init__(
        self,
        *library: Transformation,
        targets: tuple[Target, ...] = (RESULT,),
        behaviours: dict[str, Behaviour] | None = None,
        policy: Policy | None = None,
        horizon_s: int = HORIZON_S,
        max_cost_us: int | None = None,
        world: api.World | None = None,
        runtime: SimulatedRuntime | None = None,
        **parts: Any,
    ) -> None:
        library = library or (source(), worker())
        environment = Environment((), library, targets)
        world = world or api.world(environment, horizon_s=horizon_s, max_cost_us=max_cost_us)
        self.runtime = runtime or SimulatedRuntime(behaviours=behaviours)
        self.reports: list[Report] = []
        self.manager = Manager(
            world, self.runtime, clock=self.runtime.clock, policy=policy, report=self.reports.append, **parts
        )

    def pass_time(self, seconds: float) -> None:
        self.manager.run(seconds)

    def settle(self, patience_s: float = 5.0) -> None:
        """Let time pass until nothing is to be reviewed."""
        end = self.now + patience_s
        self.manager.step()
        while not self.manager.is_settled:
            self.manager.step(patience_s)
            assert self.now < end, "it does not settle"

    def ask(self, change: Change) -> Review | None:
        """Request a change and let it be reviewed."""
        outcome: Future[Review | None] = self.manager.request(change)
        self.settle()
        return outcome.result(timeout=0)

    def reviewed(self, change: Change) -> Review:
        review = self.ask(change)
        assert review is not None
        return review

    def fail(self, *units: str) -> None:
        """Let units die at the same time, and what follows happen."""
        for unit in units:
            self.runtime.backend.fail(unit)
        self.pass_time(0.001)
        self.settle()

    @property
    def now(self) -> float:
        return self.runtime.clock.now()

    @property
    def units(self) -> set[str]:
        return set(self.runtime.environment.unit)

    @property
    def reviews(self) -> tuple[Review, ...]:
        return self.manager.snapshot().reviews

    @property
    def met(self) -> set[str]:
        return {view.label for view in self.manager.snapshot().targets if view.is_met}

    def perturbations(self, kind: type[P]) -> list[P]:
        found: list[Perturbation] = [report.perturbation for report in self.reports if isinstance(report, Perturbed)]
        return [perturbation for perturbation in found if isinstance(perturbation, kind)]

    def starts(self, label: str) -> int:
        return sum(1 for call in self.runtime.backend.calls if call[0] == "start" and call[1].startswith(f"{label}."))


def started(*library: Transformation, **more: Any) -> Life:
    """A life whose first review is over."""
    life = Life(*library, **more)
    life.settle()
    return life
