"""Plans with tags that the fast engine does not decide: `python experiments/matching/deciding.py [Brick.ttl]`.

100 transformations and 10 targets are planned by `cfgplan.solve`, with no running units: in a building of 1,000
points, whose ontology is Brick or one of its shape, in the two ontologies of `far_outside.py`, and in one that no
engine decides. Prints the wall time of matching and planning, the answer, the number of pairs of tags that each engine
decided, and the number that HermiT was asked about.
"""

from __future__ import annotations

import argparse
import random
import time
from collections.abc import Sequence
from pathlib import Path

from buildings import brick, brick_shaped, building
from far_outside import KINDS, cpu_s, tagged
from small_worlds import World, iri

from cfgplan import api
from cfgplan.costs import seconds
from cfgplan.domain import Environment, InputPort, OutputPort, Target, Transformation
from cfgplan.matching import Ontology

DRIVERS, DEAR, DERIVED, TARGETS = 20, 20, 60, 10
DEAR_US = 10**8


def planned(tags: World) -> api.World:
    """Return a world to plan: drivers that offer `tags`, expensive drivers, derived streams, and targets."""
    rng = random.Random(0)
    given, derived = tags.offered[:-DERIVED], tags.offered[-DERIVED:]

    def driver(label: str, given: Sequence[str], least_us: int) -> Transformation:
        return _priced(rng, label, (), [OutputPort(f"o{index}", tag) for index, tag in enumerate(given)], least_us)

    def deriving(number: int) -> Transformation:
        demanded = rng.sample(tags.demanded, rng.randint(1, 2))
        inputs = [InputPort(f"i{index}", tag) for index, tag in enumerate(demanded)]
        return _priced(rng, f"derive{number}", inputs, [OutputPort("o", derived[number])])

    library = (
        *(driver(f"driver{number}", given[number::DRIVERS], 0) for number in range(DRIVERS)),
        *(driver(f"dear{number}", tags.demanded[number::DEAR], DEAR_US) for number in range(DEAR)),
        *map(deriving, range(DERIVED)),
    )
    wanted = enumerate(rng.sample(tags.demanded, TARGETS))
    targets = tuple(Target(f"t{index}", tag, f"/t{index}") for index, tag in wanted)
    return api.world(Environment((), library, targets), horizon_s=600, ontology=tags.ontology)


def _priced(
    rng: random.Random, label: str, inputs: Sequence[InputPort], outputs: Sequence[OutputPort], least_us: int = 0
) -> Transformation:
    labor_us, upkeep_us = least_us + rng.randint(10**5, 10**7), rng.randint(10**3, 10**5)
    return Transformation(label, tuple(inputs), tuple(outputs), labor_us, upkeep_us)


def clashing(seed: int = 0, classes: int = 300) -> Ontology:
    """Return random classes whose property restrictions clash, too hard for every engine."""
    rng = random.Random(seed)
    names = [iri(f"C{number}") for number in range(classes)]

    def some(count: int) -> str:
        return f"ObjectUnionOf({' '.join(rng.sample(names, count))})"

    axioms = [f"SubClassOf({name} ObjectSomeValuesFrom({iri('r')} {some(3)}))" for name in names]
    axioms += [f"SubClassOf({name} ObjectAllValuesFrom(ObjectInverseOf({iri('r')}) {some(5)}))" for name in names]
    axioms += [f"SubClassOf({name} {some(2)})" for name in names]
    axioms += [f"DisjointClasses({' '.join(rng.sample(names, 2))})" for _ in names]
    return Ontology(axioms)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("brick", type=Path, nargs="?", metavar="Brick.ttl", help="default: an ontology of its shape")
    parser.add_argument("--kinds", nargs="+", help="only these of building, layered, adversarial and clashing")
    parser.add_argument("--reasoner-timeout", type=float, default=60.0, metavar="S", help="for each of them (60)")
    chosen = parser.parse_args()
    worlds = {"building": building(brick_shaped() if chosen.brick is None else brick(chosen.brick))}
    worlds |= {name: tagged(ontology()) for name, ontology in {**KINDS, "clashing": clashing}.items()}
    for name, tags in worlds.items():
        if chosen.kinds and name not in chosen.kinds:
            continue
        world = planned(tags)
        start, spent = time.perf_counter(), cpu_s()
        matches = api.matches(world, time_limit_s=chosen.reasoner_timeout, use_cache=False)
        _, plan = api.solved(api.problem(world, matches.similarity), matches)
        took = f"{time.perf_counter() - start:.1f} s, {cpu_s() - spent:.1f} CPU seconds"
        cost = "no plan" if plan.cost_us is None else f"cost {seconds(plan.cost_us)} s"
        print(f"{name}: {took}: {plan.status}, {cost}, bound {seconds(plan.bound_us)} s")
        print(f"  {len(plan.undecided)} undecided pairs that it hangs on")
        print(*(f"  {count} {figure}" for figure, count in plan.counts.items() if figure.startswith("pairs")), sep="\n")


if __name__ == "__main__":
    main()
