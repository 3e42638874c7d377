"""The benefit of observing the quality of streams, in worlds whose true errors drift.

Several sources can meet one target. Each has upkeep, labor and a declared error, and the true errors drift. A second
costs the upkeep of all running units and the target's price of the true error; a start costs its labor. A run (the
real manager, with simulated units) that observes streams is compared with a run that uses the declared errors, and
with a clairvoyant. The clairvoyant knows all true errors, and each second chooses the cheapest source as if the errors
stayed constant.

    python experiments/observed/drifting.py --worlds 50 --kind walk
"""

from __future__ import annotations

import argparse
import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import exp, sqrt
from statistics import fmean, quantiles

from cfgplan_runtime import Manager, Policy, SimulatedRuntime
from cfgplan_runtime.children.messages import Qualities, Quality
from cfgplan_runtime.supervision.simulated_backend import Behaviour

from cfgplan import api
from cfgplan.domain import Environment, OutputPort, Target, Transformation
from cfgplan.qualities import MICRO, Better, Contribution, QualityAttribute, QualityRule, Wish

HORIZON_S = 60
WEIGHT_S = 20.0
"""CPU seconds over the horizon for each unit of error."""
SPAN_S = 900
NOISE, ELEMENTS = 0.2, 5
WINNABLE = 0.01
"""Worlds in which declared errors cost less than this more than the clairvoyant are also listed apart."""
SPREAD = 0.5
"""The standard deviation of the logarithm of a true error against the declared one."""
WORST = 5.0
KINDS = ("walk", "away", "still")
"""Random walks of the logarithm; walks that return within 300 s, around a constant offset; no drift at all."""


@dataclass(frozen=True)
class Drift:
    """By source: declared error, upkeep (CPU seconds per second), labor (CPU seconds), and the true error by second."""

    declared: list[float]
    upkeep: list[float]
    labor: list[float]
    true: list[list[float]]

    def second(self, source: int) -> Callable[[float], float]:
        """Return the true error of a source as a function of time in seconds."""
        return lambda at_s: self.true[min(int(at_s), SPAN_S - 1)][source]


def drawn(seed: int, kind: str) -> Drift:
    """Return a random world of three to five sources; `kind` is how their errors drift."""
    chance = random.Random(f"{seed} {kind}")
    number = chance.randint(3, 5)
    declared = [round(chance.uniform(0.2, 1.0), 6) for _ in range(number)]
    upkeep = [chance.uniform(0.02, 0.2) for _ in range(number)]
    labor = [chance.uniform(0.1, 1.0) for _ in range(number)]
    offset = [chance.gauss(0, 0.4) if kind == "away" else 0.0 for _ in range(number)]
    log, true = [0.0] * number, []
    for _ in range(SPAN_S):
        if kind == "walk":
            log = [one + 0.7 * SPREAD / sqrt(300) * chance.gauss(0, 1) for one in log]
        elif kind == "away":
            log = [one - one / 300 + SPREAD * sqrt(2 / 300) * chance.gauss(0, 1) for one in log]
        true.append([min(d * exp(x + o), WORST) for d, x, o in zip(declared, log, offset, strict=True)])
    return Drift(declared, upkeep, labor, true)


def lived(drift: Drift, *, observes: bool, seed: int = 0) -> tuple[float, int]:
    """Return the cost of a run in CPU seconds, and how often the source that meets the target changes; a run that does
    not observe takes no looks.
    """
    sources = range(len(drift.declared))

    def behaviour(source: int) -> Behaviour:
        chance, truth = random.Random(f"{seed} {source}"), drift.second(source)

        def says(at_s: float) -> Qualities:
            values = [truth(at_s) * (1 + NOISE * chance.gauss(0, 1)) for _ in range(ELEMENTS)]
            mean = fmean(values)
            return {"p": {"error": Quality(ELEMENTS, mean, sum((one - mean) ** 2 for one in values))}}

        return Behaviour(says=says if observes else None)

    def transformation(source: int) -> Transformation:
        stated = Contribution(
            "error", QualityRule.SET, round(drift.declared[source] * MICRO), observe="error" if observes else None
        )
        costs = round(drift.labor[source] * 1e6), round(drift.upkeep[source] * 1e6)
        return Transformation(
            f"s{source}", (), (OutputPort("p", "P", (stated,)),), *costs, source=f"units.py:s{source}"
        )

    target = Target("t", "P", "/t", quality=(Wish("error", None, round(WEIGHT_S * 1e6)),))
    attribute = QualityAttribute("error", Better.LOWER, worst=round(WORST * MICRO))
    environment = Environment((), tuple(map(transformation, sources)), (target,), qualities=(attribute,))
    runtime = SimulatedRuntime(behaviours={f"s{source}": behaviour(source) for source in sources})
    manager = Manager(
        api.world(environment, horizon_s=HORIZON_S), runtime, clock=runtime.clock, policy=Policy(reviews_kept=10_000)
    )
    cost, used, changes = 0.0, "", 0
    for _ in range(SPAN_S):
        manager.run(1.0)
        now, units = runtime.clock.now(), runtime.environment.units
        cost += sum(drift.upkeep[int(unit.transformation[1:])] for unit in units)
        provider = next((unit for unit in units if unit.publications), None)
        if provider is not None and provider.transformation != used:
            used, changes = provider.transformation, changes + 1
        error = WORST if provider is None else drift.second(int(provider.transformation[1:]))(now)
        cost += WEIGHT_S / HORIZON_S * error
    started = [unit for review in manager.snapshot().reviews if review.change_set for unit in review.change_set.started]
    return cost + sum(drift.labor[int(unit.transformation[1:])] for unit in started), changes


def clairvoyant(drift: Drift) -> tuple[float, int]:
    """Return the clairvoyant's cost in CPU seconds, and how often it changes the source."""
    sources = range(len(drift.declared))

    def foreseen(source: int, errors: Sequence[float], runs: int | None) -> float:
        labor = 0.0 if source == runs else drift.labor[source]
        return drift.upkeep[source] * HORIZON_S + WEIGHT_S * errors[source] + labor

    runs, cost, started = None, 0.0, 0
    for errors in drift.true:
        best = min(sources, key=lambda source: foreseen(source, errors, runs))
        if runs is None or foreseen(best, errors, runs) < foreseen(runs, errors, runs) - 1e-9:
            runs, cost, started = best, cost + drift.labor[best], started + 1
        cost += drift.upkeep[runs] + WEIGHT_S / HORIZON_S * errors[runs]
    return cost, started


def main(arguments: Sequence[str] | None = None, tell: Callable[[str], object] = print) -> None:
    """Print costs relative to the clairvoyant's, the share of the difference that observing saves, and changes."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--worlds", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kind", choices=KINDS, action="append")
    options = parser.parse_args(arguments)
    for kind in options.kind or KINDS:
        rows = []
        for seed in range(options.seed, options.seed + options.worlds):
            drift = drawn(seed, kind)
            rows.append((lived(drift, observes=False), lived(drift, observes=True, seed=seed), clairvoyant(drift)))
        declared, observed, known = (sum(row[column][0] for row in rows) for column in range(3))
        ratios = [row[1][0] / row[2][0] for row in rows]
        most = quantiles(ratios, n=10)[-1] if len(ratios) > 1 else ratios[0]
        won = f"{(declared - observed) / (declared - known):.0%}" if declared - known > 0.01 * known else "-"
        winnable = [row for row in rows if row[0][0] > (1 + WINNABLE) * row[2][0]]
        others = [row for row in rows if row not in winnable]
        changes = " / ".join(f"{fmean(row[column][1] for row in rows):.1f}" for column in range(3))
        tell(
            f"{kind:6} of the clairvoyant's cost: declared {declared / known:.3f}, observed {fmean(ratios):.3f} "
            f"(90 % of worlds {most:.3f}); {won} of the gap won; changes {changes}; "
            f"in {len(others)} worlds there is less than {WINNABLE:.0%} to win, observed {_ratio(others):.3f} there"
        )


def _ratio(rows: Sequence[tuple[tuple[float, int], ...]]) -> float:
    """The cost of runs that observe, as a multiple of the clairvoyant's; 1 without rows."""
    return sum(row[1][0] for row in rows) / sum(row[2][0] for row in rows) if rows else 1.0


if __name__ == "__main__":
    main()
