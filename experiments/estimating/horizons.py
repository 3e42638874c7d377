"""The trade-off of a horizon's length between reaction and churn, and the benefit of exploring.

Two stages with three interchangeable transformations each, whose upkeep jumps every few minutes; a manager with a
simulated runtime reviews at each horizon. Its cost is compared with that of an omniscient planner, which knows the
whole future and may switch at any second (dynamic programming, exact).

    python experiments/estimating/horizons.py [--out experiments/estimating] [--hours 1] [--worlds 4]
"""

from __future__ import annotations

import argparse
import random
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from statistics import mean

from cfgplan_runtime import Manager, SimulatedRuntime
from cfgplan_runtime.estimating.estimator import LearningEstimator, make_estimator
from cfgplan_runtime.estimating.settings import Learning
from cfgplan_runtime.lifecycle.reports import Report, UnitEvent
from cfgplan_runtime.supervision.events import UnitReady
from cfgplan_runtime.supervision.observation import Observation
from cfgplan_runtime.supervision.simulated_backend import Behaviour

from cfgplan import api
from cfgplan.domain import Environment, InputPort, OutputPort, Target, Transformation

STAGES = (("raw", "detector", "ball"), ("ball", "tracker", "track"))
CHOICES = "abc"
LABOR_US = 2_000_000
USUAL_US = 40_000
CHANGE_S = 300
NOISE = 0.1
HORIZONS_S = (10, 30, 60, 120, 240, 480, 960)


def labels(stage: int) -> list[str]:
    return [f"{STAGES[stage][1]}_{choice}" for choice in CHOICES]


def library() -> tuple[Transformation, ...]:
    workers = [
        Transformation(
            label, (InputPort("x", needs),), (OutputPort("y", gives),), LABOR_US, USUAL_US, source=f"units.py:{label}"
        )
        for stage, (needs, _, gives) in enumerate(STAGES)
        for label in labels(stage)
    ]
    return (Transformation("camera", outputs=(OutputPort("y", "raw"),), source="units.py:camera"), *workers)


def upkeeps(seed: int, length_s: int) -> dict[str, list[float]]:
    """Return the true upkeep of each transformation at each second; it jumps at random moments."""
    dice, found = random.Random(seed), {}
    for stage in range(len(STAGES)):
        for label in labels(stage):
            level, values = USUAL_US * dice.lognormvariate(0, 0.5), []
            for _ in range(length_s):
                if dice.random() < 1 / CHANGE_S:
                    level = USUAL_US * dice.lognormvariate(0, 0.5)
                values.append(level)
            found[label] = values
    return found


def least_us(options: Sequence[Sequence[float]]) -> list[float]:
    """Return the least cost of one stage up to each second, for an omniscient planner; each switch is a start."""
    best = [LABOR_US + values[0] for values in options]
    course = [min(best)]
    for second in range(1, len(options[0])):
        elsewhere = course[-1] + LABOR_US
        best = [min(stay, elsewhere) + values[second] for stay, values in zip(best, options, strict=True)]
        course.append(min(best))
    return course


class Knowing:
    """An estimator that knows every upkeep of the present second, so that only the horizon causes regret."""

    def __init__(self, truth: dict[str, list[float]]) -> None:
        self._truth = truth
        self._now_s = 0.0

    def observe(self, observations: Sequence[Observation], now_s: float) -> None:  # noqa: ARG002
        self._now_s = now_s

    def failed(self, transformation: str, now_s: float) -> None:
        """Ignore failures: no unit fails here."""

    def labor_us(self, transformation: Transformation, horizon_s: int) -> int:  # noqa: ARG002
        return transformation.labor_us

    def upkeep_us(self, transformation: Transformation, horizon_s: int) -> int:  # noqa: ARG002
        values = self._truth.get(transformation.label)
        return 0 if values is None else round(values[min(int(self._now_s), len(values) - 1)])


def _learning(forget_s: float, guess: str = "declared") -> LearningEstimator:
    return make_estimator("trend", guess, Learning(memory_s=30, forget_s=forget_s))


ESTIMATORS: dict[str, Callable[[dict[str, list[float]]], Knowing | LearningEstimator]] = {
    "knows the present": Knowing,
    "declared": lambda _: make_estimator("declared"),
    "trend, forgets in 6 h": lambda _: _learning(6 * 3600),
    "the same, optimistic": lambda _: _learning(6 * 3600, "optimistic"),
    "trend, forgets in 5 min": lambda _: _learning(300),
}


@dataclass(frozen=True)
class Outcome:
    """The result of one run of a manager.

    `regret` is the cost beyond the omniscient planner's, as a fraction of the latter; `course` is how it grew, in CPU
    seconds at each second.
    """

    estimator: str
    horizon_s: int
    seed: int
    switches_per_h: float
    regret: float
    course: tuple[float, ...]


def run(case: tuple[str, int, int, int]) -> Outcome:
    """Run one manager through one world."""
    name, horizon_s, seed, length_s = case
    truth = upkeeps(seed, length_s + 1)
    dice = random.Random(seed)
    noisy = {label: [max(0.0, dice.gauss(us, NOISE * us)) for us in values] for label, values in truth.items()}
    behaviours = {
        label: Behaviour(upkeep_us=lambda now_s, values=values: values[min(int(now_s), length_s)])
        for label, values in noisy.items()
    }
    world = api.world(Environment((), library(), (Target("track", "track", "/track"),)), horizon_s=horizon_s)
    runtime = SimulatedRuntime(behaviours=behaviours)
    starts = 0

    def count(report: Report) -> None:
        nonlocal starts
        if isinstance(report, UnitEvent) and isinstance(report.event, UnitReady):
            starts += not report.event.unit.startswith("camera")

    manager = Manager(world, runtime, clock=runtime.clock, estimator=ESTIMATORS[name](truth), report=count)
    upkeep_us, spent_us = 0.0, []
    for second in range(length_s):
        manager.run(second + 1 - runtime.clock.now())
        running = [unit.transformation for unit in runtime.environment.units]
        upkeep_us += sum(truth[label][second] for label in running if label in truth)
        spent_us.append(upkeep_us + starts * LABOR_US)
    stages = [least_us([truth[label][:length_s] for label in labels(stage)]) for stage in range(len(STAGES))]
    least = [sum(costs) for costs in zip(*stages, strict=True)]
    course = tuple((spent - best) / 1e6 for spent, best in zip(spent_us, least, strict=True))
    switches_per_h = (starts - len(STAGES)) * 3600 / length_s
    return Outcome(name, horizon_s, seed, switches_per_h, spent_us[-1] / least[-1] - 1, course)


def table(outcomes: Sequence[Outcome]) -> list[str]:
    lines = [
        "| estimator | " + " | ".join(f"{horizon} s" for horizon in HORIZONS_S) + " |",
        "|---|" + "---|" * len(HORIZONS_S),
    ]
    for name in ESTIMATORS:
        cells = []
        for horizon in HORIZONS_S:
            found = [one for one in outcomes if (one.estimator, one.horizon_s) == (name, horizon)]
            cells.append(f"{100 * mean(o.regret for o in found):.0f} %, {mean(o.switches_per_h for o in found):.0f}/h")
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent)
    parser.add_argument("--hours", type=float, default=1)
    parser.add_argument("--worlds", type=int, default=4)
    given = parser.parse_args()
    length_s = round(3600 * given.hours)
    cases = [(*case, length_s) for case in product(ESTIMATORS, HORIZONS_S, range(given.worlds))]
    with ProcessPoolExecutor() as pool:
        outcomes = list(pool.map(run, cases))
    lines = table(outcomes)
    (given.out / "horizons.md").write_text("\n".join(lines) + "\n")
    print("\n".join(lines))
    plot(outcomes, given.out)


def plot(outcomes: Sequence[Outcome], folder: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    matplotlib.rcParams["svg.hashsalt"] = "cfgplan"
    from matplotlib import pyplot as plt

    figure, (regret, churn, growth) = plt.subplots(1, 3, figsize=(18, 5), constrained_layout=True)
    for name in ESTIMATORS:
        by_horizon = [[one for one in outcomes if (one.estimator, one.horizon_s) == (name, h)] for h in HORIZONS_S]
        regret.plot(HORIZONS_S, [100 * mean(o.regret for o in found) for found in by_horizon], "o-", label=name)
        churn.plot(HORIZONS_S, [mean(o.switches_per_h for o in found) for found in by_horizon], "o-", label=name)
    for panel, title in ((regret, "spent beyond an omniscient planner, %"), (churn, "switches per hour")):
        panel.set_xscale("log")
        panel.set_xticks(HORIZONS_S, [str(horizon) for horizon in HORIZONS_S])
        panel.set_xlabel("horizon, s")
        panel.set_title(title)
        panel.set_ylim(bottom=0)
    regret.legend()
    for horizon in HORIZONS_S[::2]:
        courses = [one.course for one in outcomes if (one.estimator, one.horizon_s) == ("knows the present", horizon)]
        growth.plot([mean(at_once) for at_once in zip(*courses, strict=True)], label=f"horizon {horizon} s")
    growth.set_xlabel("time, s")
    growth.set_title('CPU seconds beyond it so far, for "knows the present"')
    growth.legend()
    for ending in ("svg", "png"):
        figure.savefig(folder / f"horizons.{ending}", dpi=110, metadata={"Date": None} if ending == "svg" else None)


if __name__ == "__main__":
    main()
