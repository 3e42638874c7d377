"""How estimators converge on units whose costs are constant, noisy, stepping, drifting or spiky, and on crashing units.

python experiments/estimating/convergence.py [--out experiments/estimating]
"""

from __future__ import annotations

import argparse
import random
import sys
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

sys.path.append(str(Path(__file__).parents[2]))

from cfgplan_runtime import SimulatedBackend, Supervisor
from cfgplan_runtime.estimating.estimator import ESTIMATORS, LearningEstimator
from cfgplan_runtime.estimating.forecasters import Average
from cfgplan_runtime.supervision.events import Event, UnitDied
from cfgplan_runtime.supervision.simulated_backend import Behaviour

from cfgplan.domain import ChangeSet, ComputationUnit, Environment, OutputPort, Transformation
from experiments.estimating.holt import Holt

COMPARED = {**ESTIMATORS, "average": Average, "holt": Holt}
"""The product's forecasters, and the two that are not better."""
WORK = Transformation(
    "work", outputs=(OutputPort("y", "Y"),), labor_us=500_000, upkeep_us=50_000, source="units.py:Work"
)
LENGTH_S = 900
HORIZON_S = 60
CHANGE_S = 300
EVERY_S = 5
NEAR = 0.1


@dataclass(frozen=True)
class Scenario:
    """A unit: `truth` maps a second to its upkeep in microseconds per second, `noise` to a random addition."""

    name: str
    truth: Callable[[int], float]
    noise: Callable[[random.Random, float], float] = lambda _, value: value
    dies_s: float | None = None

    def behaviour(self) -> Behaviour:
        dice = random.Random(7)
        seconds = [max(0.0, self.noise(dice, self.truth(second))) for second in range(LENGTH_S + HORIZON_S + 1)]
        return Behaviour(start_s=0.1, dies_s=self.dies_s, upkeep_us=lambda now_s: seconds[int(now_s)])

    def expected_us(self, now_s: int) -> float:
        """Return the true value to estimate at a moment: the mean upkeep over the horizon, without noise."""
        return sum(self.truth(now_s + second) for second in range(HORIZON_S)) / HORIZON_S


SCENARIOS = (
    Scenario("constant", lambda _: 20_000),
    Scenario("noise of 30 %", lambda _: 20_000, lambda dice, value: dice.gauss(value, 0.3 * value)),
    Scenario("step", lambda second: 20_000 if second < CHANGE_S else 60_000, lambda dice, v: dice.gauss(v, 0.1 * v)),
    Scenario(
        "drift",
        lambda second: 20_000 + 100 * min(max(second - CHANGE_S, 0), 300),
        lambda dice, value: dice.gauss(value, 0.1 * value),
    ),
    Scenario(
        "outliers: 20 times in 2 % of the seconds",
        lambda _: 20_000,
        lambda dice, value: value * (20 if dice.random() < 0.02 else 1),
    ),
    Scenario("a crash every 20 s until 300 s", lambda _: 20_000, dies_s=20.0),
)


def estimates(scenario: Scenario, estimators: dict[str, LearningEstimator]) -> tuple[list[int], dict[str, list[int]]]:
    """Return the times and each estimator's estimates every few seconds; all estimators observe the same unit."""
    events: list[Event] = []
    backend = SimulatedBackend({"work": scenario.behaviour()})
    supervisor = Supervisor(backend, Environment((), (WORK,)), events.append)
    moments: list[int] = []
    found: dict[str, list[int]] = {name: [] for name in estimators}
    starts = 0
    for second in range(LENGTH_S):
        if not supervisor.alive:
            starts += 1
            supervisor.apply(ChangeSet(started=(ComputationUnit(f"work.{starts}", "work"),)))
        while backend.now() < second:
            supervisor.pump(second - backend.now())
        if second >= CHANGE_S:
            backend.behaviours["work"].dies_s = None
        for estimator in estimators.values():
            for event in events:
                if isinstance(event, UnitDied):
                    estimator.failed("work", backend.now())
            estimator.observe(supervisor.observe(), backend.now())
        events.clear()
        if second % EVERY_S == 0:
            moments.append(second)
            for name, estimator in estimators.items():
                found[name].append(estimator.upkeep_us(WORK, HORIZON_S))
    return moments, found


def settled_s(scenario: Scenario, moments: list[int], values: list[int], since_s: int) -> int | None:
    """Return how long after a change all estimates are within a tenth of the true value; None if never."""
    wrong = [
        moment
        for moment, value in zip(moments, values, strict=True)
        if moment >= since_s and abs(value - scenario.expected_us(moment)) > NEAR * scenario.expected_us(moment)
    ]
    if not wrong:
        return 0
    return None if wrong[-1] >= moments[-1] - EVERY_S else wrong[-1] + EVERY_S - since_s


def error(scenario: Scenario, moments: list[int], values: list[int], since_s: int) -> float:
    """Return the mean deviation from the true value, in percent of it."""
    misses = [
        abs(value - scenario.expected_us(moment)) / scenario.expected_us(moment)
        for moment, value in zip(moments, values, strict=True)
        if moment >= since_s
    ]
    return 100 * sum(misses) / len(misses)


def row(scenario: Scenario, name: str, moments: list[int], values: list[int]) -> str:
    """Return one line of the table; estimates after failures are given as they are, since no true value exists."""
    churn = sum(before != after for before, after in pairwise(values))
    if scenario.dies_s is not None:
        most, last = max(values) / 1e3, values[-1] / 1e3
        return f"| {scenario.name} | {name} | at most {most:.0f} ms/s | {last:.0f} ms/s at the end | | {churn} |"
    changes_s = 0 if scenario.truth(0) == scenario.truth(LENGTH_S) else CHANGE_S
    settled = settled_s(scenario, moments, values, changes_s)
    return (
        f"| {scenario.name} | {name} | {error(scenario, moments, values, 0):.1f} %"
        f" | {error(scenario, moments, values, CHANGE_S):.1f} %"
        f" | {'never' if settled is None else f'{settled} s'} | {churn} |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent)
    out = parser.parse_args().out
    import matplotlib

    matplotlib.use("Agg")
    matplotlib.rcParams["svg.hashsalt"] = "cfgplan"
    from matplotlib import pyplot as plt

    figure, panels = plt.subplots(2, 3, figsize=(15, 8), constrained_layout=True)
    lines = [
        "| scenario | estimator | mean error | error from 300 s on | within 10 % after | changes of the estimate |",
        "|---|---|---|---|---|---|",
    ]
    for scenario, panel in zip(SCENARIOS, panels.flat, strict=True):
        moments, found = estimates(
            scenario, {name: LearningEstimator(forecaster) for name, forecaster in COMPARED.items()}
        )
        panel.set_title(scenario.name)
        panel.plot(moments, [scenario.expected_us(moment) / 1e3 for moment in moments], "k:", label="right")
        for name, values in found.items():
            panel.step(moments, [value / 1e3 for value in values], where="post", label=name, linewidth=1.2)
            lines.append(row(scenario, name, moments, values))
        panel.set_ylim(0, max(4 * scenario.expected_us(0), max(max(values) for values in found.values())) / 1e3 + 5)
        panel.set_xlabel("seconds")
        panel.set_ylabel("upkeep handed out, ms/s")
    panels.flat[0].legend()
    for ending in ("svg", "png"):
        figure.savefig(out / f"convergence.{ending}", dpi=110, metadata={"Date": None} if ending == "svg" else None)
    (out / "convergence.md").write_text("\n".join(lines) + "\n")
    print("\n".join(lines))


if __name__ == "__main__":
    main()
