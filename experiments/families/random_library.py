"""Random layered libraries: size, depth, branching, sharing, cycles, running units and failures can be set.

The layers and the lognormal costs follow the benchmarks of web-service composition; parent concepts
stand for what a reasoner adds to equal names.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from random import Random

from cfgplan.domain import Environment, InputPort, OutputPort, Similarity, Target, Transformation
from cfgplan.errors import InvalidValueError
from cfgplan.planning import Problem
from cfgplan.reasons import Providers, startable
from experiments.families.configurations import MILLISECONDS, cheap_configuration, wired_where_possible, without

CHILDREN = 4
"""Concepts of one parent."""


def random_library(
    seed: int,
    *,
    transformations: int = 100,
    depth: int = 5,
    branching: int = 4,
    arity: int = 2,
    outputs: int = 1,
    back: float = 0.1,
    parents: float = 0.3,
    sharing: float = 0.0,
    targets: int = 3,
    running: float = 0.0,
    distinct: float = 0.0,
    horizon_s: int = 60,
) -> Problem:
    """Return a library of `depth` layers, whose first has no inputs, with satisfiable targets in the last layer.

    About `branching` outputs offer each concept. An input demands a concept of the layer before (70 %) or of any lower
    one; with probability `back`, one of its own layer or a higher one, which closes cycles. With probability `parents`
    it demands a parent of four concepts, with probability `sharing` a concept among the most popular tenth of the
    layer. With probability `distinct`, all inputs of a transformation demand one concept from different
    transformations. A unit of each transformation runs with probability `running`. Costs are whole milliseconds.
    """
    if min(transformations, depth, branching, outputs) < 1 or transformations < depth:
        raise InvalidValueError("a random library needs a transformation for each layer, a branching and an output")
    random = Random(seed)
    layers = _layers(transformations, depth, branching, outputs)
    library: list[Transformation] = []
    for number, layer in enumerate(layers):
        given = layer.given(random, outputs)
        for position, concepts in enumerate(given):
            asked = [_asked(random, layers, number, back, parents, sharing) for _ in range(arity if number else 0)]
            group = "sources" if distinct and asked and random.random() < distinct else None
            library.append(
                Transformation(
                    f"t{number}_{position}",
                    tuple(InputPort(f"in{i}", asked[0] if group else tag, group) for i, tag in enumerate(asked)),
                    tuple(OutputPort(f"out{i}", tag) for i, tag in enumerate(concepts)),
                    labor_us=max(1, round(1000 * random.lognormvariate(0, 1))) * MILLISECONDS,
                    upkeep_us=max(1, round(10 * random.lognormvariate(0, 1))) * MILLISECONDS,
                )
            )
    similarity = Similarity({tag: frozenset(offered) for layer in layers for tag, offered in layer.offers().items()})
    environment = Environment((), tuple(library), ())
    wanted = _meetable(random, environment, similarity, layers, targets)
    environment = Environment((), tuple(library), tuple(Target(t, t, f"/{t}") for t in wanted))
    labels = [t.label for t in environment.library if random.random() < running]
    return Problem(
        Environment(wired_where_possible(environment, similarity, labels), environment.library, environment.targets),
        similarity,
        horizon_s,
    )


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
    """Return a library as of `random_library`, with a valid running configuration, after random failures.

    `failures` units die; the inputs that they fed lose their subscriptions. With probability `gone` a dead unit's
    transformation leaves the library too, unless a target could not be met without it.
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
            providers = Providers(smaller, fresh.similarity)
            possible = startable(candidate, providers)
            if all(not possible.isdisjoint(providers.of(target.tag)) for target in left.targets):
                left = candidate
    return Problem(left, fresh.similarity, horizon_s)


@dataclass(frozen=True)
class _Layer:
    number: int
    size: int
    concepts: tuple[str, ...]

    def given(self, random: Random, outputs: int) -> list[list[str]]:
        """The concepts that each transformation of the layer gives, each concept about equally often."""
        deck: list[str] = []
        hands: list[list[str]] = []
        for _ in range(self.size):
            hand: list[str] = []
            while len(hand) < min(outputs, len(self.concepts)):
                if not deck:
                    deck = random.sample(self.concepts, len(self.concepts))
                concept = deck.pop()
                if concept not in hand:
                    hand.append(concept)
            hands.append(hand)
        return hands

    def parent(self, concept: str) -> str:
        return f"p{self.number}_{self.concepts.index(concept) // CHILDREN}"

    def offers(self) -> dict[str, set[str]]:
        offers: dict[str, set[str]] = {concept: {concept} for concept in self.concepts}
        for concept in self.concepts:
            offers.setdefault(self.parent(concept), set()).add(concept)
        return offers


def _layers(transformations: int, depth: int, branching: int, outputs: int) -> list[_Layer]:
    layers = []
    for number in range(depth):
        size = transformations // depth + (number < transformations % depth)
        concepts = max(1, round(size * outputs / branching))
        layers.append(_Layer(number, size, tuple(f"c{number}_{i}" for i in range(concepts))))
    return layers


def _asked(random: Random, layers: Sequence[_Layer], number: int, back: float, parents: float, sharing: float) -> str:
    if random.random() < back:
        layer = layers[random.randrange(number, len(layers))]
    elif random.random() < 0.7:
        layer = layers[number - 1]
    else:
        layer = layers[random.randrange(number)]
    liked = layer.concepts[: max(1, len(layer.concepts) // 10)] if random.random() < sharing else layer.concepts
    concept = random.choice(liked)
    return layer.parent(concept) if random.random() < parents else concept


def _meetable(
    random: Random, environment: Environment, similarity: Similarity, layers: Sequence[_Layer], count: int
) -> list[str]:
    """Concepts that something startable gives, from the last layer downwards."""
    providers = Providers(environment.library, similarity)
    possible = startable(environment, providers)
    found: list[str] = []
    for layer in reversed(layers):
        for concept in random.sample(layer.concepts, len(layer.concepts)):
            if len(found) < count and not possible.isdisjoint(providers.of(concept)):
                found.append(concept)
    return found
