"""Seeded random environments of any size, in the shape of stream-processing libraries.

Layered: layer 0 are sources; an input asks for a concept of the layer before (70 %) or of any lower
one (30 %); a share of back edges asks for a concept of the same or a higher layer, which makes
validity cyclic. `branching` transformations offer each concept; 30 % of the inputs ask for a parent
concept of four. Labor is lognormal, upkeep a lognormal share of it, so that reuse pays but is not free.
"""

from __future__ import annotations

import random
from collections.abc import Iterator
from dataclasses import dataclass

from cfgplan.domain import (
    ChangeSet,
    Environment,
    InputPort,
    OutputPort,
    Similarity,
    Target,
    Transformation,
)
from cfgplan.planning import Problem

HORIZON_S = 600


@dataclass(frozen=True)
class Family:
    """A family of random environments; the fields are its parameters."""

    transformations: int
    depth: int = 8
    branching: int = 5
    arity: int = 2
    outputs: int = 1
    back_edges: float = 0.1
    targets: int = 1
    equal_costs: bool = False

    def __str__(self) -> str:
        parts = [f"n={self.transformations}", f"d={self.depth}", f"b={self.branching}", f"a={self.arity}"]
        parts += [f"back={self.back_edges}", f"t={self.targets}"]
        if self.outputs > 1:
            parts.append(f"out={self.outputs}")
        return " ".join(parts)


PARENT = 4
"""How many neighbouring concepts of a layer have a parent concept in common."""


def problem(family: Family, seed: int) -> Problem:
    """One environment of the family without running units; every target can be met."""
    draw = random.Random(f"{family}/{seed}")
    layers = [family.transformations // family.depth] * family.depth
    for extra in range(family.transformations - sum(layers)):
        layers[extra % family.depth] += 1
    concepts = [max(1, size * family.outputs // family.branching) for size in layers]
    library = []
    for layer, size in enumerate(layers):
        for number in range(size):
            outputs = [
                OutputPort(f"out{i}", _concept(layer, (number * family.outputs + i) % concepts[layer]))
                for i in range(family.outputs)
            ]
            inputs = [InputPort(f"in{i}", _demand(draw, family, concepts, layer)) for i in range(family.arity)]
            labor_us = 1_000_000 if family.equal_costs else int(1_000_000 * draw.lognormvariate(0, 1))
            upkeep_us = 0 if family.equal_costs else int(labor_us * draw.lognormvariate(-1, 1) / HORIZON_S)
            library.append(
                Transformation(
                    f"t{layer}_{number}", tuple(inputs if layer else ()), tuple(outputs), labor_us, upkeep_us
                )
            )
    tops = list(range(concepts[-1]))
    draw.shuffle(tops)
    wanted = [_concept(family.depth - 1, tops[i % len(tops)]) for i in range(family.targets)]
    targets = tuple(Target(f"q{i}", tag, f"/q{i}") for i, tag in enumerate(wanted))
    return Problem(Environment((), tuple(library), targets), _similarity(concepts), HORIZON_S)


def _concept(layer: int, number: int) -> str:
    return f"C{layer}_{number}"


def _demand(draw: random.Random, family: Family, concepts: list[int], layer: int) -> str:
    if layer == 0:
        return ""
    if draw.random() < family.back_edges:
        below = draw.randrange(layer, family.depth)
    elif draw.random() < 0.7:
        below = layer - 1
    else:
        below = draw.randrange(layer)
    number = draw.randrange(concepts[below])
    return f"P{below}_{number // PARENT}" if draw.random() < 0.3 else _concept(below, number)


def _similarity(concepts: list[int]) -> Similarity:
    offers: dict[str, frozenset[str]] = {}
    for layer, count in enumerate(concepts):
        for number in range(count):
            offers[_concept(layer, number)] = frozenset({_concept(layer, number)})
        for parent in range((count + PARENT - 1) // PARENT):
            children = range(parent * PARENT, min(count, (parent + 1) * PARENT))
            offers[f"P{layer}_{parent}"] = frozenset(_concept(layer, number) for number in children)
    return Similarity(offers)


def after_failure(problem: Problem, unit_id: str) -> Problem:
    """The same problem when the unit has died: its consumers keep their subscriptions to it."""
    return with_environment(problem, problem.environment.update(ChangeSet(stopped=(unit_id,))))


def with_environment(problem: Problem, environment: Environment) -> Problem:
    return Problem(environment, problem.similarity, problem.horizon_s, problem.max_cost_us)


def failures(problem: Problem, seed: int) -> Iterator[Problem]:
    """Every running unit dies once, in a random order, each time from the same running configuration."""
    ids = [unit.id for unit in problem.environment.units]
    random.Random(seed).shuffle(ids)
    for unit_id in ids:
        yield after_failure(problem, unit_id)
