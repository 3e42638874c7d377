"""Buildings whose points are described by Brick, or by an ontology of its shape.

Brick itself is not part of this project: `pip download brickschema --no-deps` has it, as
`brickschema/ontologies/1.2/Brick.ttl` in the wheel.

    python experiments/matching/buildings.py [Brick.ttl]
"""

from __future__ import annotations

import random
import sys
import time
from itertools import pairwise
from pathlib import Path

from small_worlds import World

from cfgplan.matching import Matcher, Ontology, load_ontology

BRICK = "https://brickschema.org/schema/Brick#"
BUILDING = "http://building.example/#"
_PAIRS = (("feeds", "isFedBy"), ("hasPart", "isPartOf"), ("hasPoint", "isPointOf"), ("hasLocation", "isLocationOf"))


def brick_shaped(seed: int = 0, classes: int = 1000) -> Ontology:
    """Return classes in deep trees below Point, Equipment and Location, and Brick's relations with their axioms."""
    rng = random.Random(seed)
    axioms = [f"SubClassOf(<{BRICK}{name}> <{BRICK}Entity>)" for name in ("Point", "Equipment", "Location")]
    names = {"Point": ["Point"], "Equipment": ["Equipment"], "Location": ["Location"]}
    for number in range(classes):
        kind = rng.choices(list(names), (6, 3, 1))[0]
        name = f"{kind}_{number}"
        parents = [rng.choice(names[kind][-40:]), *rng.sample(names[kind], int(rng.random() < 0.1))]
        axioms += [f"SubClassOf(<{BRICK}{name}> <{BRICK}{parent}>)" for parent in parents]
        names[kind].append(name)
    for one, other in _PAIRS:
        axioms.append(f"InverseObjectProperties(<{BRICK}{one}> <{BRICK}{other}>)")
        for role in (one, other):
            axioms += [f"{kind}ObjectProperty(<{BRICK}{role}>)" for kind in ("Asymmetric", "Irreflexive")]
    axioms += [
        f"ObjectPropertyDomain(<{BRICK}isPointOf> <{BRICK}Point>)",
        f"ObjectPropertyRange(<{BRICK}hasPoint> <{BRICK}Point>)",
        f"ObjectPropertyRange(<{BRICK}hasLocation> <{BRICK}Location>)",
        f"DisjointClasses(<{BRICK}Point> <{BRICK}Equipment> <{BRICK}Location>)",
    ]
    return Ontology(axioms, {"brick": BRICK, "": BUILDING})


def brick(path: Path) -> Ontology:
    """Return Brick from its published file."""
    ontology = load_ontology([path], {"": None})
    return Ontology(ontology.axioms, {"brick": BRICK, "": BUILDING}, dropped=ontology.dropped)


def building(ontology: Ontology, points: int = 1000, tags: int = 100, seed: int = 0) -> World:
    """Return a building with `points` points; each tag is a kind of point of some equipment or location."""
    rng = random.Random(seed)
    below: dict[str, list[str]] = {kind: [] for kind in ("Point", "Equipment", "Location")}
    above: dict[str, list[str]] = {}
    for tree in ontology.trees.values():
        if tree[0] == "SubClassOf" and isinstance(tree[1], str) and isinstance(tree[2], str):
            above.setdefault(tree[1], []).append(tree[2])
    for name in sorted(above):
        reached, waiting = {name}, [name]
        while waiting:
            news = set(above.get(waiting.pop(), ())) - reached
            reached |= news
            waiting += news
        for kind, members in below.items():
            if BRICK + kind in reached and name.startswith(BRICK):
                members.append(name)
    inner = {parent for uppers in above.values() for parent in uppers}
    general = [name for name in below["Point"] if name in inner]
    axioms: list[str] = []

    def individuals(stem: str, count: int, kind: str) -> list[str]:
        made = [f"{BUILDING}{stem}{number}" for number in range(count)]
        axioms.extend(f"ClassAssertion(<{rng.choice(below[kind])}> <{one}>)" for one in made)
        return made

    rooms, machines = individuals("room", 35, "Location"), individuals("machine", 20, "Equipment")
    sensors = individuals("point", points, "Point")
    for sensor in sensors:
        axioms.append(f"ObjectPropertyAssertion(<{BRICK}isPointOf> <{sensor}> <{rng.choice(machines)}>)")
        axioms.append(f"ObjectPropertyAssertion(<{BRICK}hasLocation> <{sensor}> <{rng.choice(rooms)}>)")
    axioms += [f"ObjectPropertyAssertion(<{BRICK}feeds> <{one}> <{other}>)" for one, other in pairwise(machines)]

    def tag(kinds: list[str]) -> str:
        belongs = rng.choice(
            (
                f"brick:isPointOf value <{rng.choice(machines)}>",
                f"brick:isPointOf some <{rng.choice(below['Equipment'])}>",
                f"brick:hasLocation value <{rng.choice(rooms)}>",
            )
        )
        return f"<{rng.choice(kinds)}>" + (f" and {belongs}" if rng.random() < 0.8 else "")

    offered = [f"{{<{sensor}>}}" for sensor in sensors] + [tag(below["Point"]) for _ in range(tags)]
    demanded = [tag(general) for _ in range(tags)]
    whole = Ontology([*ontology.axioms, *axioms], ontology.prefixes, dropped=ontology.dropped)
    return World(whole, tuple(dict.fromkeys(offered)), tuple(dict.fromkeys(demanded)))


def main() -> None:
    """Match the tags of a building; print the time, and the number of pairs that each engine decided."""
    paths = list(map(Path, sys.argv[1:]))
    world = building(brick(paths[0]) if paths else brick_shaped())
    matcher = Matcher(world.ontology)
    started = time.perf_counter()
    matcher.add(offered=world.offered, demanded=world.demanded)
    matching = matcher.matching(decide=False)
    pairs = len(list(matching.similarity.open_pairs()))
    print(f"{len(world.ontology.axioms)} axioms, {time.perf_counter() - started:.1f} s, {pairs} pairs open")
    print(dict(matching.answered_by), *matching.warnings, sep="\n")


if __name__ == "__main__":
    main()
