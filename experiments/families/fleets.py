"""Fleets: a random library on a few identical hosts with limited capacity and a price for transfers."""

from __future__ import annotations

from dataclasses import replace
from random import Random

from cfgplan.domain import Environment, Host, OutputPort, Transformation
from cfgplan.planning import Problem
from cfgplan.qualities import MICRO
from experiments.families.random_library import random_library

SIZES = (64, 1_000, 20_000, 300_000)
"""Bytes of an element: a number, a list, a scan, an image."""
MEMORY_MB = (50, 100, 200, 400)
UNITS, UPKEEP_US, UNIT_MB = 15, 10_000, 150
"""So many units are reckoned for each target, each with so much CPU time a second and memory."""


def fleet(
    seed: int,
    *,
    transformations: int = 150,
    targets: int = 8,
    hosts: int = 3,
    room: float = 2.0,
    memory: float = 0.0,
    transfer_us: int = 20_000,
) -> Problem:
    """Return a random library on identical hosts, with most targets on one of them.

    All hosts together have `room` times the CPU time and `memory` times the memory estimated for the targets; 0 means
    no limit. A transfer costs `transfer_us` microseconds of CPU time per megabyte.
    """
    problem = random_library(seed, transformations=transformations, targets=targets)
    random = Random(seed)
    names = [f"h{i}" for i in range(hosts)]
    library = tuple(_placed(random, t, names) for t in problem.environment.library)
    targets_at = tuple(replace(t, host=random.choice([None, *names])) for t in problem.environment.targets)
    cpu_us = int(room * UPKEEP_US * UNITS * targets) // hosts if room else None
    memory_mb = int(memory * UNIT_MB * UNITS * targets) // hosts if memory else None
    if memory:
        library = tuple(replace(t, memory_mb=random.choice(MEMORY_MB)) for t in library)
    there = tuple(Host(name, cpu_us, memory_mb) for name in names)
    return replace(problem, environment=Environment((), library, targets_at, there, (), transfer_us))


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
