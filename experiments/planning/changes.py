"""Single changes of a running configuration: failures, costs, the library, the targets."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from dataclasses import replace

from cfgplan.domain import ChangeSet, Environment, Target, Transformation
from cfgplan.planning import Problem

DEARER, CHEAPER = 1.1, 0.9


def a_unit_dies(problem: Problem, draw: random.Random) -> Iterator[Environment]:
    """Yield an environment without one unit, for each running unit, in random order."""
    units = [unit.id for unit in problem.environment.units]
    draw.shuffle(units)
    for unit in units:
        yield problem.environment.update(ChangeSet(stopped=(unit,)))


def two_units_die(problem: Problem, draw: random.Random) -> Iterator[Environment]:
    while len(problem.environment.units) > 1:
        pair = draw.sample([unit.id for unit in problem.environment.units], 2)
        yield problem.environment.update(ChangeSet(stopped=tuple(pair)))


def a_running_one_gets_dearer(problem: Problem, draw: random.Random) -> Iterator[Environment]:
    """Yield environments in which a running transformation costs a tenth more."""
    for label in _running(problem, draw):
        yield _with(problem, _times(problem.environment.transformation[label], DEARER))


def a_running_one_gets_cheaper(problem: Problem, draw: random.Random) -> Iterator[Environment]:
    for label in _running(problem, draw):
        yield _with(problem, _times(problem.environment.transformation[label], CHEAPER))


def another_one_gets_cheaper(problem: Problem, draw: random.Random) -> Iterator[Environment]:
    for label in _others(problem, draw):
        yield _with(problem, _times(problem.environment.transformation[label], CHEAPER))


def all_costs_move(problem: Problem, draw: random.Random) -> Iterator[Environment]:
    """Yield environments with all costs changed by up to 1 %, as by new estimates."""
    while True:
        library = tuple(_times(t, draw.uniform(0.99, 1.01)) for t in problem.environment.library)
        yield replace(problem.environment, library=library)


def a_transformation_joins(problem: Problem, draw: random.Random) -> Iterator[Environment]:
    """Yield environments with a cheaper version of an existing transformation added."""
    for label in _others(problem, draw):
        joins = replace(_times(problem.environment.transformation[label], CHEAPER), label=f"{label}_new")
        yield replace(problem.environment, library=(*problem.environment.library, joins))


def an_unused_one_is_withdrawn(problem: Problem, draw: random.Random) -> Iterator[Environment]:
    for label in _others(problem, draw):
        yield _without(problem, label)


def a_running_one_is_withdrawn(problem: Problem, draw: random.Random) -> Iterator[Environment]:
    for label in _running(problem, draw):
        yield _without(problem, label)


def a_target_comes(problem: Problem, draw: random.Random) -> Iterator[Environment]:
    """Yield environments with a new target for a tag that some transformation offers."""
    wanted = {target.tag for target in problem.environment.targets}
    offered = sorted({port.tag for t in problem.environment.library for port in t.outputs} - wanted)
    draw.shuffle(offered)
    for tag in offered:
        target = Target("late", tag, "/late")
        yield replace(problem.environment, targets=(*problem.environment.targets, target))


def a_target_goes(problem: Problem, draw: random.Random) -> Iterator[Environment]:
    targets = problem.environment.targets
    for target in draw.sample(targets, len(targets)):
        yield replace(problem.environment, targets=tuple(each for each in targets if each != target))


CHANGES: dict[str, Callable[[Problem, random.Random], Iterator[Environment]]] = {
    change.__name__.replace("_", " "): change
    for change in (
        a_unit_dies,
        two_units_die,
        a_running_one_gets_dearer,
        a_running_one_gets_cheaper,
        another_one_gets_cheaper,
        all_costs_move,
        a_transformation_joins,
        an_unused_one_is_withdrawn,
        a_running_one_is_withdrawn,
        a_target_comes,
        a_target_goes,
    )
}


def _running(problem: Problem, draw: random.Random) -> list[str]:
    labels = sorted({unit.transformation for unit in problem.environment.units})
    return draw.sample(labels, len(labels))


def _others(problem: Problem, draw: random.Random) -> list[str]:
    running = set(_running(problem, draw))
    labels = [t.label for t in problem.environment.library if t.label not in running]
    return draw.sample(labels, len(labels))


def _times(transformation: Transformation, factor: float) -> Transformation:
    return replace(
        transformation,
        labor_us=round(factor * transformation.labor_us),
        upkeep_us=round(factor * transformation.upkeep_us),
    )


def _with(problem: Problem, changed: Transformation) -> Environment:
    library = tuple(changed if t.label == changed.label else t for t in problem.environment.library)
    return replace(problem.environment, library=library)


def _without(problem: Problem, label: str) -> Environment:
    library = tuple(t for t in problem.environment.library if t.label != label)
    return replace(problem.environment, library=library)
