"""Replanning: a running system of a random library loses units, and perhaps their transformations."""

from __future__ import annotations

from random import Random

from cfgplan.comparing.families.random_library import random_library
from cfgplan.comparing.families.running import cheap_configuration, without
from cfgplan.domain import Environment
from cfgplan.errors import InvalidValueError
from cfgplan.planning import Problem
from cfgplan.reasons import Givers, startable


def replanning(
    seed: int,
    *,
    transformations: int = 100,
    failures: int = 1,
    gone: float = 0.0,
    depth: int = 5,
    branching: int = 4,
    arity: int = 2,
    back: float = 0.1,
    targets: int = 3,
    horizon_s: int = 60,
) -> Problem:
    """A library as `random_library` makes it, with a valid configuration that runs, after random failures.

    `failures` units die; what they fed has gaps. With probability `gone` a dead unit's transformation
    leaves the library too, unless a target could not be met without it.
    """
    if failures < 0:
        raise InvalidValueError("the number of failures is negative")
    fresh = random_library(
        seed,
        transformations=transformations,
        depth=depth,
        branching=branching,
        arity=arity,
        back=back,
        targets=targets,
        horizon_s=horizon_s,
    )
    random = Random(seed)
    running = cheap_configuration(fresh.environment, fresh.similarity, horizon_s)
    dead = random.sample(running.units, min(failures, len(running.units)))
    left = Environment(without(running.units, {unit.id for unit in dead}), running.library, running.targets)
    for unit in dead:
        if random.random() < gone:
            smaller = tuple(t for t in left.library if t.label != unit.transformation)
            candidate = Environment(left.units, smaller, left.targets)
            givers = Givers(smaller, fresh.similarity)
            possible = startable(candidate, givers)
            if all(not possible.isdisjoint(givers.of(target.tag)) for target in left.targets):
                left = candidate
    return Problem(left, fresh.similarity, horizon_s)
