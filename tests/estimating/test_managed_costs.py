"""A manager that learns: what it uses and what it avoids, with units that run only in thought."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from cfgplan_runtime import Manager, SimulatedRuntime
from cfgplan_runtime.estimating.estimates_file import load, save
from cfgplan_runtime.estimating.estimator import LearningEstimator, make_estimator
from cfgplan_runtime.supervision.simulated_backend import Behaviour

from cfgplan import api
from cfgplan.domain import Environment, OutputPort, Target, Transformation

HORIZON_S = 60
CHEAP = Transformation(
    "cheap", outputs=(OutputPort("y", "Y"),), labor_us=100_000, upkeep_us=10_000, source="units.py:Cheap"
)
DEAR = replace(CHEAP, label="dear", upkeep_us=30_000, source="units.py:Dear")


class Life:
    def __init__(self, estimator: LearningEstimator, **behaviours: Behaviour) -> None:
        environment = Environment((), (CHEAP, DEAR), (Target("y", "Y", "/y"),))
        self.runtime = SimulatedRuntime(behaviours=behaviours)
        self.estimator = estimator
        self.manager = Manager(
            api.world(environment, horizon_s=HORIZON_S), self.runtime, clock=self.runtime.clock, estimator=estimator
        )

    def after(self, seconds: float) -> list[str]:
        """What runs so much later."""
        self.manager.run(seconds)
        return [unit.transformation for unit in self.runtime.environment.units]

    def starts(self, label: str) -> int:
        calls = self.runtime.backend.calls
        return sum(call[0] == "start" and call[1].startswith(f"{label}.") for call in calls)


def test_what_turns_out_dearer_than_declared_is_replaced_at_the_horizon() -> None:
    life = Life(make_estimator(), cheap=Behaviour(upkeep_us=lambda _: 90_000))
    assert life.after(HORIZON_S - 5) == ["cheap"]
    assert life.after(10) == ["dear"]


def test_what_is_as_declared_stays() -> None:
    life = Life(make_estimator())
    assert life.after(HORIZON_S - 5) == ["cheap"]
    assert life.after(5 * HORIZON_S) == ["cheap"]
    assert (life.starts("cheap"), life.starts("dear")) == (1, 0)


def test_an_optimist_tries_both_and_stays_with_the_cheaper() -> None:
    life = Life(make_estimator("trend", "optimistic"), cheap=Behaviour(upkeep_us=lambda _: 50_000))
    seen = {label for _ in range(6) for label in life.after(HORIZON_S)}
    assert seen == {"cheap", "dear"}
    assert life.after(HORIZON_S) == ["dear"]


def test_what_keeps_crashing_is_avoided_even_where_nothing_else_is_learned() -> None:
    life = Life(make_estimator("declared"), cheap=Behaviour(dies_s=5.0))
    assert life.after(3) == ["cheap"]
    assert life.after(2 * HORIZON_S) == ["dear"]
    starts = life.starts("cheap")
    assert life.after(10 * HORIZON_S) == ["dear"]
    assert life.starts("cheap") == starts


def test_what_was_learned_counts_from_the_first_review_of_the_next_run(tmp_path: Path) -> None:
    first = Life(make_estimator(), cheap=Behaviour(upkeep_us=lambda _: 90_000))
    first.after(2 * HORIZON_S)
    save(first.estimator, tmp_path / "kept.json", first.runtime.clock.now())
    estimator = make_estimator()
    load(estimator, tmp_path / "kept.json", 0.0)
    assert Life(estimator).after(1) == ["dear"]
