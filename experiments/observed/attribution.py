"""Test whether deviations of streams from their declared qualities are attributed to the right transformations.

Each of STAGES stages in a chain has WAYS transformations, whose true errors differ from the declared ones. Some
configurations run, one after the other, and some outputs report their quality. Then the configuration with the least
learned error is chosen. Its regret is the share by which its true error exceeds the least possible one.

    python experiments/observed/attribution.py --draws 200
"""

from __future__ import annotations

import argparse
import itertools
import random
from collections.abc import Callable, Sequence
from math import exp
from statistics import fmean

from cfgplan.domain import (
    ComputationUnit,
    Environment,
    InputPort,
    OutputPort,
    Statement,
    Stream,
    Subscription,
    Transformation,
)
from cfgplan.observed import Estimate, Sample, learned, planned_deviations
from cfgplan.qualities import MICRO, Better, Contribution, QualityAttribute, QualityRule

STAGES, WAYS = 4, 3
DRIFT, NOISE, ELEMENTS = 0.5, 0.2, 100
ERROR = "error"

Configuration = tuple[int, ...]
Table = dict[tuple[int, int], float]
"""By stage and way: the own part."""


def label(stage: int, way: int) -> str:
    """Return the label of a stage's transformation number `way`."""
    return f"t{stage}{way}"


def environment_of(rule: QualityRule, declared: Table) -> Environment:
    """Return the library of the chain, with declared errors."""

    def transformation(stage: int, way: int) -> Transformation:
        stated = Contribution(ERROR, rule, round(declared[stage, way] * MICRO), observe=ERROR)
        inputs = (InputPort("in", f"s{stage - 1}"),) if stage else ()
        return Transformation(label(stage, way), inputs, (OutputPort("out", f"s{stage}", (stated,)),), 1, 1)

    library = tuple(transformation(*place) for place in declared)
    return Environment((), library, (), qualities=(QualityAttribute(ERROR, Better.LOWER),))


def running(environment: Environment, configuration: Configuration) -> Environment:
    """Return the environment with the units of a configuration running."""
    units = []
    for stage, way in enumerate(configuration):
        feeds = (Subscription("in", Stream(units[-1].id, "out")),) if units else ()
        units.append(ComputationUnit(f"{label(stage, way)}.1", label(stage, way), feeds))
    return Environment(tuple(units), environment.library, (), qualities=environment.qualities)


def values(rule: QualityRule, table: Table, configuration: Configuration) -> list[float]:
    """Return the error after each stage of a configuration, by the errors in a table."""
    parts = [table[place] for place in enumerate(configuration)]
    return list(
        itertools.accumulate(parts, (lambda a, b: a * b) if rule is QualityRule.SCALE else (lambda a, b: a + b))
    )


def regret(rule: QualityRule, table: Table, true: Table) -> float:
    """Return the share by which the true error of the best configuration of a table exceeds the least true error."""
    configurations = list(itertools.product(range(WAYS), repeat=STAGES))
    chosen = min(configurations, key=lambda one: values(rule, table, one)[-1])
    truth = [values(rule, true, one)[-1] for one in configurations]
    return values(rule, true, chosen)[-1] / min(truth) - 1


def draw(seed: int, rule: QualityRule, share: float, runs: int) -> tuple[float, float]:
    """Return the regrets of a choice by declared values, and by values learned from `runs` configurations."""
    rng = random.Random(f"{seed} {rule} {share} {runs}")
    low, high = (0.5, 1.5) if rule is QualityRule.SCALE else (0.1, 1.0)
    places = list(itertools.product(range(STAGES), range(WAYS)))
    declared = {place: round(rng.uniform(low, high), 6) for place in places}
    true = {place: value * exp(DRIFT * rng.gauss(0, 1)) for place, value in declared.items()}
    says = [stage for stage in range(STAGES) if rng.random() < share or stage == STAGES - 1]
    environment, estimates = environment_of(rule, declared), dict[Statement, Estimate]()
    for number in range(runs):
        configuration = tuple(rng.randrange(WAYS) for _ in range(STAGES))
        world, samples = running(environment, configuration), {}
        for stage in says:
            said = [values(rule, true, configuration)[stage] * (1 + NOISE * rng.gauss(0, 1)) for _ in range(ELEMENTS)]
            mean = fmean(said)
            variance = sum((one - mean) ** 2 for one in said) / ELEMENTS**2
            stream = Stream(f"{label(stage, configuration[stage])}.1", "out")
            samples[stream, ERROR] = Sample(mean * MICRO, variance * MICRO**2)
        estimates = dict(learned(world, samples, estimates, 10.0 * number, fresh=frozenset(samples)).estimates)
    seen = planned_deviations(environment, estimates, {}, 10.0 * runs, fades=lambda _: True)
    known = {
        (stage, way): value + seen.get(Statement(label(stage, way), "out", ERROR), 0) / MICRO
        for (stage, way), value in declared.items()
    }
    return regret(rule, declared, true), regret(rule, known, true)


def main(arguments: Sequence[str] | None = None, tell: Callable[[str], object] = print) -> None:
    """Print the regrets by rule, by the share of outputs that report their quality, and by the number of
    configurations.
    """
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    tell(f"{'rule':6} {'observed':>9} {'runs':>5} {'declared':>9} {'learned':>9} {'ratio':>6}  mean regrets")
    for rule, share, runs in itertools.product((QualityRule.ADD, QualityRule.SCALE), (1.0, 0.5, 0.0), (2, 4, 8)):
        found = [draw(options.seed + each, rule, share, runs) for each in range(options.draws)]
        before, after = (fmean(column) for column in zip(*found, strict=True))
        name = {1.0: "all", 0.5: "half", 0.0: "the last"}[share]
        tell(f"{rule:6} {name:>9} {runs:5} {before:9.1%} {after:9.1%} {after / before:6.2f}")


if __name__ == "__main__":
    main()
