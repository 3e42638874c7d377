"""Random libraries with quality, hosts and spares laid over them, for measuring planners at scale."""

from __future__ import annotations

from dataclasses import replace
from random import Random

from cfgplan.domain import ComputationUnit, Environment, Host, OutputPort, Transformation
from cfgplan.planning import Failures, Problem
from cfgplan.qualities import MICRO, Better, Contribution, Over, QualityAttribute, QualityRule, Wish
from experiments.families.random_library import random_library

ERROR = QualityAttribute("error", Better.LOWER, worst=100 * MICRO)
LATENCY = QualityAttribute("latency", Better.LOWER, worst=1000 * MICRO)
SIZES = (64, 1_000, 20_000, 300_000)
"""Bytes of an element: a number, a list, a scan, an image."""


def plain(seed: int, transformations: int = 415, targets: int = 8) -> Problem:
    """The library that the others are made from."""
    return random_library(seed, transformations=transformations, targets=targets)


def weighted(seed: int, transformations: int = 415, targets: int = 8) -> Problem:
    """Each target charges for latency, about as much as a good part of the plan costs."""
    problem = _with_quality(plain(seed, transformations, targets), seed)
    return _asking(problem, Wish("latency", weight_us=3 * MICRO))


def bounded(seed: int, transformations: int = 415, targets: int = 8, *, most_latency: int = 10 * MICRO) -> Problem:
    """Each target bounds latency."""
    problem = _with_quality(plain(seed, transformations, targets), seed)
    return _asking(problem, Wish("latency", most_latency))


def both(seed: int, transformations: int = 415, targets: int = 8) -> Problem:
    """Each target bounds latency and charges for error."""
    problem = _with_quality(plain(seed, transformations, targets), seed)
    return _asking(problem, Wish("latency", 10 * MICRO), Wish("error", weight_us=2 * MICRO))


def hosted(seed: int, transformations: int = 415, targets: int = 8, *, hosts: int = 3, tight: bool = True) -> Problem:
    """Units are placed on some alike hosts, which bear about twice what the cheapest plan needs if it is `tight`."""
    problem = plain(seed, transformations, targets)
    random = Random(seed)
    names = [f"h{i}" for i in range(hosts)]
    library = tuple(_placed(random, t, names) for t in problem.environment.library)
    share = 2 * 10_000 * 3 * targets * 5 // hosts
    there = tuple(Host(name, share if tight else None) for name in names)
    targets_at = tuple(replace(t, host=random.choice([None, *names])) for t in problem.environment.targets)
    environment = Environment((), library, targets_at, there, (), transfer_us=20_000)
    return replace(problem, environment=environment)


def surviving(seed: int, transformations: int = 60, targets: int = 3) -> Problem:
    """Any unit may fail; half of the transformations can be cold spares."""
    problem = plain(seed, transformations, targets)
    random = Random(seed)
    library = tuple(
        replace(t, standby_us=t.upkeep_us // 10) if random.random() < 0.5 else t for t in problem.environment.library
    )
    return replace(problem, environment=replace(problem.environment, library=library), survive=Failures.UNITS)


def running(problem: Problem, units: tuple[ComputationUnit, ...]) -> Problem:
    """The problem with these units running."""
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


def _placed(random: Random, transformation: Transformation, names: list[str]) -> Transformation:
    """A tenth is bound to one host, a fifth to some, the others may be anywhere."""
    kind = random.random()
    host = random.choice(names) if kind < 0.1 else None
    hosts = tuple(random.sample(names, 2)) if 0.1 <= kind < 0.3 and len(names) > 2 else ()
    outputs = tuple(
        OutputPort(p.name, p.tag, rate_uhz=random.choice((1, 10, 30)) * MICRO, size_bytes=random.choice(SIZES))
        for p in transformation.outputs
    )
    return replace(transformation, host=host, hosts=hosts, outputs=outputs)


def _asking(problem: Problem, *wishes: Wish) -> Problem:
    targets = tuple(replace(t, quality=wishes) for t in problem.environment.targets)
    return replace(problem, environment=replace(problem.environment, targets=targets))
