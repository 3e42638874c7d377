"""Matches tags in ontologies far outside the fast fragment: one that HermiT can classify, and one that it can't.

    python experiments/matching/far_outside.py [--kind adversarial] [--limit 60]

To compare two versions, run them alternately, each with its own PYTHONPATH.
"""

from __future__ import annotations

import argparse
import random
import resource
import time

from small_worlds import World, iri

from cfgplan.matching import Matcher, Ontology


def layered(seed: int = 0, classes: int = 300) -> Ontology:
    """Return random classes with unions, restrictions, disjointness, and a transitive and an inverse property."""
    rng = random.Random(seed)
    axioms = [
        f"TransitiveObjectProperty({iri('p')})",
        f"InverseObjectProperties({iri('r')} {iri('s')})",
        *(f"Declaration(Class({iri(f'C{number}')}))" for number in range(classes)),
    ]
    for number in range(classes - 12):

        def later(number: int = number) -> str:
            return iri(f"C{rng.randrange(number + 1, min(classes, number + 30))}")

        name = iri(f"C{number}")
        axioms.append(f"SubClassOf({name} {later()})")
        if rng.random() < 0.2:
            axioms.append(f"SubClassOf({name} ObjectUnionOf({later()} {later()}))")
        if rng.random() < 0.2:
            axioms.append(f"SubClassOf({name} ObjectSomeValuesFrom({iri(rng.choice('rp'))} {later()}))")
        if rng.random() < 0.1:
            axioms.append(f"SubClassOf({name} ObjectAllValuesFrom({iri('r')} {later()}))")
        if rng.random() < 0.02:
            axioms.append(f"DisjointClasses({name} {later()})")
    return Ontology(axioms)


def adversarial(seed: int = 0, classes: int = 300) -> Ontology:
    """Return classes with unions and with restrictions of a property and its inverse to arbitrary other classes."""
    rng = random.Random(seed)
    axioms = [f"InverseObjectProperties({iri('r')} {iri('s')})"]
    for number in range(classes):
        name, some, one, other = (iri(f"C{each}") for each in (number, *(rng.randrange(classes) for _ in range(3))))
        axioms.append(f"SubClassOf({name} ObjectSomeValuesFrom({iri(rng.choice('rs'))} {some}))")
        if rng.random() < 0.5:
            axioms.append(f"SubClassOf({name} ObjectUnionOf({one} {other}))")
    return Ontology(axioms)


def tagged(ontology: Ontology, tags: int = 300, seed: int = 1) -> World:
    """Return the ontology with offered and demanded tags: names, and conjunctions of a name and a restriction."""
    rng = random.Random(seed)
    names = sorted(ontology.classes)

    def tag() -> str:
        return rng.choice(names) + (f" and r some {rng.choice(names)}" if rng.random() < 0.7 else "")

    offered, demanded = ([tag() for _ in range(tags)] for _ in range(2))
    return World(ontology, tuple(dict.fromkeys(offered)), tuple(dict.fromkeys(demanded)))


KINDS = {"layered": layered, "adversarial": adversarial}


def main() -> None:
    """Match the tags of one ontology; print the time, and the number of pairs that each engine decided."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kind", choices=KINDS, default="layered")
    parser.add_argument("--tags", type=int, default=300)
    parser.add_argument("--limit", type=float, default=None, help="seconds")
    options = parser.parse_args()
    world = tagged(KINDS[options.kind](), options.tags)
    matcher = Matcher(world.ontology)
    started, spent = time.perf_counter(), cpu_s()
    matcher.add(offered=world.offered, demanded=world.demanded)
    matching = matcher.matching(time_limit_s=options.limit)
    took = f"{time.perf_counter() - started:.1f} s, {cpu_s() - spent:.1f} CPU seconds"
    print(f"{options.kind}: {took}, {len(list(matching.similarity.open_pairs()))} pairs open")
    print(dict(matching.answered_by))


def cpu_s() -> float:
    """Return the CPU seconds of this process and of its ended children."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


if __name__ == "__main__":
    main()
