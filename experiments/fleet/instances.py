"""Random libraries with quality, hosts and spares added, to measure planners at scale."""

from __future__ import annotations

from dataclasses import replace
from random import Random

from cfgplan.domain import ComputationUnit, Transformation
from cfgplan.planning import Failures, Problem
from cfgplan.qualities import MICRO, Better, Contribution, Over, QualityAttribute, QualityRule, Wish
from experiments.families.fleets import fleet
from experiments.families.random_library import random_library

ERROR = QualityAttribute("error", Better.LOWER, worst=100 * MICRO)
LATENCY = QualityAttribute("latency", Better.LOWER, worst=1000 * MICRO)


def plain(seed: int, transformations: int = 415, targets: int = 8) -> Problem:
    """Return the library that the other instances extend."""
    return random_library(seed, transformations=transformations, targets=targets)


def weighted(seed: int, transformations: int = 415, targets: int = 8) -> Problem:
    """Return the library with a price of latency at each target, which amounts to a large part of the plan's cost."""
    problem = _with_quality(plain(seed, transformations, targets), seed)
    return _asking(problem, Wish("latency", weight_us=3 * MICRO))


def bounded(seed: int, transformations: int = 415, targets: int = 8, *, most_latency: int = 10 * MICRO) -> Problem:
    """Return the library with a bound on latency at each target; `most_latency` is in millionths of the unit."""
    problem = _with_quality(plain(seed, transformations, targets), seed)
    return _asking(problem, Wish("latency", most_latency))


def both(seed: int, transformations: int = 415, targets: int = 8) -> Problem:
    """Return the library with a bound on latency and a price of error at each target."""
    problem = _with_quality(plain(seed, transformations, targets), seed)
    return _asking(problem, Wish("latency", 10 * MICRO), Wish("error", weight_us=2 * MICRO))


def hosted(seed: int, transformations: int = 415, targets: int = 8, *, hosts: int = 3, tight: bool = True) -> Problem:
    """Return a fleet of identical hosts; if it is `tight`, their capacity is about twice the cheapest plan's load."""
    return fleet(seed, transformations=transformations, targets=targets, hosts=hosts, room=2 if tight else 0)


def surviving(seed: int, transformations: int = 60, targets: int = 3) -> Problem:
    """Return a problem in which any unit may fail, and half of the transformations can be cold spares."""
    problem = plain(seed, transformations, targets)
    random = Random(seed)
    library = tuple(
        replace(t, standby_us=t.upkeep_us // 10) if random.random() < 0.5 else t for t in problem.environment.library
    )
    return replace(problem, environment=replace(problem.environment, library=library), survive=Failures.UNITS)


def running(problem: Problem, units: tuple[ComputationUnit, ...]) -> Problem:
    """Return the problem with these units as the running configuration."""
    return replace(problem, environment=replace(problem.environment, units=units))


def _with_quality(problem: Problem, seed: int) -> Problem:
    random = Random(seed)
    library = tuple(_stating(random, t) for t in problem.environment.library)
    environment = replace(problem.environment, library=library, qualities=(ERROR, LATENCY))
    return replace(problem, environment=environment)


def _stating(random: Random, transformation: Transformation) -> Transformation:
    """Latency adds up, error is made worse by most, and better by a few that have several inputs."""
    latency = random.randrange(1, 40) * MICRO // 10
    if not transformation.inputs:
        error = Contribution("error", QualityRule.ADD, random.randrange(1, 30) * MICRO // 10)
    elif random.random() < 0.2:
        error = Contribution("error", QualityRule.SCALE, random.randrange(5, 10) * MICRO // 10, Over.MEAN)
    else:
        error = Contribution("error", QualityRule.SCALE, random.randrange(100, 130) * MICRO // 100)
    stated = (error, Contribution("latency", QualityRule.ADD, latency))
    outputs = tuple(replace(port, quality=stated) for port in transformation.outputs)
    return replace(transformation, outputs=outputs)


def _asking(problem: Problem, *wishes: Wish) -> Problem:
    targets = tuple(replace(t, quality=wishes) for t in problem.environment.targets)
    return replace(problem, environment=replace(problem.environment, targets=targets))
