"""Random small ontologies with every construct, and tags, to find errors of the matching."""

from __future__ import annotations

import random
from dataclasses import dataclass

from cfgplan.matching import Ontology

NAMESPACE = "http://world.example/#"


@dataclass(frozen=True)
class World:
    """An ontology, with offered and demanded tags to match."""

    ontology: Ontology
    offered: tuple[str, ...]
    demanded: tuple[str, ...]


def small_world(seed: int, tags: int = 40, *, outside: float = 0.0, far: bool = False) -> World:
    """Return a small, dense ontology of the fast fragment, with a share `outside` of axioms outside of it.

    With `far` these axioms, and the tags, are of every kind that OWL has for classes, properties and individuals.
    """
    return _Small(random.Random(seed), outside, far).world(tags)


class _Small:
    def __init__(self, rng: random.Random, outside: float, far: bool) -> None:
        self.rng = rng
        self.outside = outside
        self.far = far
        self.classes = [f"C{n}" for n in range(rng.randint(3, 9))]
        self.roles = [f"r{n}" for n in range(rng.randint(1, 4))]
        self.individuals = [f"a{n}" for n in range(rng.randint(0, 4))]
        self.with_nominals = bool(self.individuals) and rng.random() < 0.7
        self.with_bottom = rng.random() < 0.4
        self.with_ranges = rng.random() < 0.5
        self.with_chains = rng.random() < 0.5

    def world(self, tags: int) -> World:
        axioms = {self.axiom() for _ in range(self.rng.randint(3, 22))}
        for name in self.individuals:
            axioms.add(f"Declaration(NamedIndividual({iri(name)}))")
        axioms.update(f"Declaration(Class({iri(name)}))" for name in self.classes)
        axioms.update(f"Declaration(ObjectProperty({iri(name)}))" for name in self.roles)
        offered = dict.fromkeys(self.tag(self.rng.randint(0, 2)) for _ in range(tags // 2))
        demanded = dict.fromkeys(self.tag(self.rng.randint(0, 2)) for _ in range(tags // 2))
        return World(Ontology(sorted(axioms)), tuple(offered), tuple(demanded))

    def axiom(self) -> str:
        rng = self.rng
        if rng.random() < self.outside:
            return self.outside_axiom()
        kind = rng.random()
        if kind < 0.35:
            return f"SubClassOf({self.left(rng.randint(0, 2))} {self.right(rng.randint(0, 2))})"
        if kind < 0.43:
            return f"EquivalentClasses({iri(rng.choice(self.classes))} {self.equivalent(rng.randint(1, 2))})"
        if kind < 0.50 and self.with_bottom and len(self.classes) > 1:
            return f"DisjointClasses({' '.join(map(iri, rng.sample(self.classes, 2)))})"
        if kind < 0.58:
            return f"SubObjectPropertyOf({iri(rng.choice(self.roles))} {iri(rng.choice(self.roles))})"
        if kind < 0.66 and self.with_chains:
            if rng.random() < 0.4:
                return f"TransitiveObjectProperty({iri(self.roles[0])})"
            chain = " ".join(iri(rng.choice(self.roles[:2])) for _ in range(2))
            return f"SubObjectPropertyOf(ObjectPropertyChain({chain}) {iri(self.roles[min(1, len(self.roles) - 1)])})"
        if kind < 0.72:
            return f"ObjectPropertyDomain({iri(rng.choice(self.roles))} {self.right(0)})"
        if kind < 0.78 and self.with_ranges:
            return f"ObjectPropertyRange({iri(rng.choice(self.roles))} {self.right(rng.randint(0, 1))})"
        if self.individuals:
            return self.assertion()
        return f"SubClassOf({self.left(1)} {self.right(1)})"

    def assertion(self) -> str:
        rng = self.rng
        one, other = rng.choice(self.individuals), rng.choice(self.individuals)
        kind = rng.random()
        if kind < 0.45:
            return f"ClassAssertion({self.right(rng.randint(0, 1))} {iri(one)})"
        if kind < 0.9:
            return f"ObjectPropertyAssertion({iri(rng.choice(self.roles))} {iri(one)} {iri(other)})"
        if one != other and kind < 0.95:
            return f"DifferentIndividuals({iri(one)} {iri(other)})"
        return f"NegativeObjectPropertyAssertion({iri(self.roles[-1])} {iri(one)} {iri(other)})"

    def outside_axiom(self) -> str:
        rng = self.rng
        role, name = iri(rng.choice(self.roles)), iri(rng.choice(self.classes))
        choices = [
            f"SubClassOf({name} ObjectAllValuesFrom({role} {self.right(0)}))",
            f"SubClassOf({name} ObjectUnionOf({self.right(0)} {self.right(1)}))",
            f"InverseObjectProperties({role} {iri('inverse_' + role[-3:-1])})",
            f"SubClassOf({name} ObjectComplementOf({self.left(1)}))",
        ]
        if not self.with_chains:
            choices.append(f"FunctionalObjectProperty({role})")
        if len(self.individuals) > 1:
            one, other = map(iri, rng.sample(self.individuals, 2))
            choices.append(f"SameIndividual({one} {other})")
            choices.append(f"EquivalentClasses({name} ObjectOneOf({one} {other}))")
        return rng.choice([*choices, *(self.far_axioms(role, name) if self.far else ())])

    def far_axioms(self, role: str, name: str) -> list[str]:
        rng = self.rng
        one, other = map(iri, rng.sample([each for each in self.classes if iri(each) != name], 2))
        back = f"ObjectInverseOf({iri(rng.choice(self.roles))})"
        result = [
            f"DisjointClasses({name} {other})",
            f"DisjointUnion({name} {one} {other})",
            f"EquivalentClasses({name} ObjectUnionOf({one} {self.right(1)}))",
            f"EquivalentClasses({name} ObjectAllValuesFrom({role} {one}))",
            f"SubClassOf({one} ObjectSomeValuesFrom({back} {other}))",
            f"SubClassOf(ObjectSomeValuesFrom({back} {one}) {other})",
            f"SubClassOf(ObjectComplementOf({one}) {self.right(1)})",
            f"SubClassOf(ObjectAllValuesFrom({role} {one}) {other})",
            f"SymmetricObjectProperty({role})",
        ]
        if self.individuals:
            thing = iri(rng.choice(self.individuals))
            result += [
                f"ClassAssertion(ObjectUnionOf({one} {other}) {thing})",
                f"ClassAssertion(ObjectAllValuesFrom({role} {other}) {thing})",
            ]
        if self.with_chains:
            return result
        counted = [f"Object{kind}Cardinality({rng.randint(1, 2)} {role} {one})" for kind in ("Min", "Max", "Exact")]
        result += [f"SubClassOf({name} {restriction})" for restriction in counted]
        result += [f"SubClassOf({restriction} {other})" for restriction in counted]
        result += [f"{kind}ObjectProperty({role})" for kind in ("Asymmetric", "Irreflexive", "InverseFunctional")]
        return [
            *result,
            f"SubClassOf({name} ObjectHasSelf({role}))",
            f"SubClassOf(ObjectHasSelf({role}) {name})",
            f"DisjointObjectProperties({role} {back})",
        ]

    def left(self, depth: int) -> str:
        kind = self.rng.random()
        if depth == 0 or kind < 0.2:
            if self.with_nominals and self.rng.random() < 0.2:
                return f"ObjectOneOf({iri(self.rng.choice(self.individuals))})"
            return iri(self.rng.choice(self.classes))
        if kind < 0.55:
            return f"ObjectSomeValuesFrom({iri(self.rng.choice(self.roles))} {self.left(depth - 1)})"
        joined = "ObjectIntersectionOf" if kind < 0.9 else "ObjectUnionOf"
        return f"{joined}({self.left(depth - 1)} {self.left(depth - 1)})"

    def right(self, depth: int) -> str:
        kind = self.rng.random()
        if self.with_bottom and kind < 0.03:
            return "<http://www.w3.org/2002/07/owl#Nothing>"
        if depth == 0 or kind < 0.25:
            return iri(self.rng.choice(self.classes))
        if kind < 0.4 and self.with_nominals:
            return f"ObjectHasValue({iri(self.rng.choice(self.roles))} {iri(self.rng.choice(self.individuals))})"
        if kind < 0.75:
            return f"ObjectSomeValuesFrom({iri(self.rng.choice(self.roles))} {self.right(depth - 1)})"
        return f"ObjectIntersectionOf({self.right(depth - 1)} {self.right(depth - 1)})"

    def equivalent(self, depth: int) -> str:
        role, other = iri(self.rng.choice(self.roles)), iri(self.rng.choice(self.classes))
        restriction = f"ObjectSomeValuesFrom({role} {other})"
        if self.with_nominals and self.rng.random() < 0.3:
            restriction = f"ObjectHasValue({role} {iri(self.rng.choice(self.individuals))})"
        return (
            restriction if depth == 1 else f"ObjectIntersectionOf({iri(self.rng.choice(self.classes))} {restriction})"
        )

    def tag(self, depth: int) -> str:
        rng = self.rng
        if self.far and depth and rng.random() < 0.4:
            kinds = ["∀", "¬"] if self.with_chains else ["∀", "¬", "≥2 ", "≤1 ", "≤0 "]
            kind = rng.choice(kinds)
            return f"{kind}{'' if kind == '¬' else f'{rng.choice(self.roles)}.'}({self.tag(depth - 1)})"
        kind = rng.random()
        if depth == 0 or kind < 0.15:
            if self.individuals and rng.random() < 0.15:
                return f"{{{rng.choice(self.individuals)}}}"
            return rng.choice([*self.classes, "⊤"]) if rng.random() < 0.97 else "⊥"
        if kind < 0.45:
            return f"∃{rng.choice(self.roles)}.({self.tag(depth - 1)})"
        if kind < 0.55 and self.individuals:
            return f"∃{rng.choice(self.roles)}.{{{rng.choice(self.individuals)}}}"
        if kind < 0.62 and len(self.individuals) > 1:
            return f"∃{rng.choice(self.roles)}.{{{', '.join(rng.sample(self.individuals, 2))}}}"
        if kind < 0.66:
            return f"¬({self.tag(depth - 1)})"
        if kind < 0.69:
            return f"∀{rng.choice(self.roles)}.({self.tag(depth - 1)})"
        joined = " ⊓ " if kind < 0.92 else " ⊔ "
        return joined.join(f"({self.tag(depth - 1)})" for _ in range(rng.randint(2, 3)))


def iri(name: str) -> str:
    """Return a name of a world as an IRI in angle brackets."""
    return f"<{NAMESPACE}{name}>"
