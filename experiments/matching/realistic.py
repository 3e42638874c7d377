"""Large worlds similar to real ontologies of streams: a taxonomy of information, devices, places and qualities."""

from __future__ import annotations

import random

from small_worlds import World, iri

from cfgplan.matching import Ontology


def realistic_world(tags: int, seed: int = 0) -> World:
    """Return a world with `tags` distinct tags, half of them offered; the ontology grows with the square root of
    `tags`.

    It has definitions (A ≡ B ⊓ ∃r.C), disjointness, a role hierarchy, a transitive part-of with a chain, domains and
    ranges, and individuals: devices in places.
    """
    rng = random.Random(seed)
    size = max(20, int(12 * tags**0.5))
    kinds = _taxonomy("Info", size, rng)
    devices = _taxonomy("Device", size // 3, rng)
    places = _taxonomy("Place", size // 6, rng)
    qualities = _taxonomy("Quality", size // 10, rng)
    axioms = [*kinds.values(), *devices.values(), *places.values(), *qualities.values()]
    axioms += [
        f"TransitiveObjectProperty({iri('partOf')})",
        f"SubObjectPropertyOf(ObjectPropertyChain({iri('locatedIn')} {iri('partOf')}) {iri('locatedIn')})",
        f"SubObjectPropertyOf(ObjectPropertyChain({iri('hasSource')} {iri('locatedIn')}) {iri('about')})",
        f"SubObjectPropertyOf({iri('hasRawSource')} {iri('hasSource')})",
        f"Declaration(ObjectProperty({iri('hasQuality')}))",
        f"ObjectPropertyDomain({iri('hasSource')} {iri('Info0')})",
        f"ObjectPropertyRange({iri('hasSource')} {iri('Device0')})",
        f"ObjectPropertyRange({iri('locatedIn')} {iri('Place0')})",
        f"ObjectPropertyRange({iri('partOf')} {iri('Place0')})",
        f"DisjointClasses({iri('Info0')} {iri('Device0')} {iri('Place0')} {iri('Quality0')})",
    ]
    for number in range(size // 10):
        kind, device = rng.choice(list(kinds)), rng.choice(list(devices))
        definition = f"ObjectIntersectionOf({iri(kind)} ObjectSomeValuesFrom({iri('hasSource')} {iri(device)}))"
        axioms.append(f"EquivalentClasses({iri(f'Defined{number}')} {definition})")
    rooms = [f"room{number}" for number in range(size // 5)]
    for room in rooms:
        axioms.append(f"ClassAssertion({iri(rng.choice(list(places)))} {iri(room)})")
        axioms.append(f"ObjectPropertyAssertion({iri('partOf')} {iri(room)} {iri(rng.choice(rooms[:10]))})")
    machines = [f"device{number}" for number in range(size // 2)]
    for machine in machines:
        axioms.append(f"ClassAssertion({iri(rng.choice(list(devices)))} {iri(machine)})")
        axioms.append(f"ObjectPropertyAssertion({iri('locatedIn')} {iri(machine)} {iri(rng.choice(rooms))})")
    maker = _TagMaker(rng, list(kinds), list(devices), list(places), list(qualities), machines, rooms)
    offered = _distinct(maker.offered, tags // 2)
    demanded = _distinct(maker.demanded, tags - tags // 2)
    return World(Ontology(axioms), offered, demanded)


def _taxonomy(stem: str, size: int, rng: random.Random) -> dict[str, str]:
    """Classes of a random tree, with the axiom that places each below its parent."""
    axioms = {f"{stem}0": f"Declaration(Class({iri(f'{stem}0')}))"}
    for number in range(1, size):
        parent = max(0, (number - 1) // 3 - rng.randint(0, 2))
        axioms[f"{stem}{number}"] = f"SubClassOf({iri(f'{stem}{number}')} {iri(f'{stem}{parent}')})"
    return axioms


class _TagMaker:
    def __init__(self, rng: random.Random, kinds: list[str], devices: list[str], places: list[str],
                 qualities: list[str], machines: list[str], rooms: list[str]) -> None:  # fmt: skip
        self.rng = rng
        self.kinds = kinds
        self.devices = devices
        self.places = places
        self.qualities = qualities
        self.machines = machines
        self.rooms = rooms

    def offered(self) -> str:
        rng = self.rng
        tag = f"{rng.choice(self.kinds)} ⊓ ∃hasRawSource.{{{rng.choice(self.machines)}}}"
        return tag + (f" ⊓ ∃hasQuality.{rng.choice(self.qualities)}" if rng.random() < 0.5 else "")

    def demanded(self) -> str:
        rng = self.rng
        source = rng.random()
        if source < 0.4:
            restriction = f"∃hasSource.{{{rng.choice(self.machines)}}}"
        elif source < 0.8:
            restriction = f"∃hasSource.{rng.choice(self.devices[: len(self.devices) // 2 + 1])}"
        elif source < 0.9:
            restriction = f"∃about.{{{rng.choice(self.rooms)}}}"
        else:
            device, place = rng.choice(self.devices[: len(self.devices) // 4 + 1]), rng.choice(self.places)
            restriction = f"∃hasSource.({device} ⊓ ∃locatedIn.{place})"
        quality = f" ⊓ ∃hasQuality.{rng.choice(self.qualities)}" if rng.random() < 0.3 else ""
        return f"{rng.choice(self.kinds[: len(self.kinds) // 24 + 2])} ⊓ {restriction}{quality}"


def _distinct(make: object, number: int) -> tuple[str, ...]:
    tags: dict[str, None] = {}
    while len(tags) < number:
        tags[make()] = None  # type: ignore[operator]
    return tuple(tags)
