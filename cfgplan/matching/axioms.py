"""Each axiom of OWL 2 as statements of five kinds: the one table by which the fast engine, the finite models and the
check of models read axioms.

Reference: OWL 2 Direct Semantics (W3C, 2012), section 2.3.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Final, TypeAlias

from cfgplan.frozen import dataclass
from cfgplan.matching.concepts import NOTHING_IRI, THING_IRI
from cfgplan.matching.functional import Tree

INVERSE: Final = "ObjectInverseOf"
LITERAL: Final = "http://www.w3.org/2000/01/rdf-schema#Literal"


@dataclass(frozen=True, slots=True)
class Subclass:
    """Every member of the class expression `sub` is one of `sup`."""

    sub: Tree
    sup: Tree


@dataclass(frozen=True, slots=True)
class DisjointExpressions:
    """Nothing is a member of two of these class expressions."""

    parts: tuple[Tree, ...]


@dataclass(frozen=True, slots=True)
class Subrole:
    """Every pair linked by the role `sub`, or by a chain of roles, is also linked by the role `sup`."""

    sub: Tree
    sup: Tree


@dataclass(frozen=True, slots=True)
class DisjointRoles:
    """No two things are linked by two of these roles."""

    roles: tuple[Tree, ...]


@dataclass(frozen=True, slots=True)
class Subvalue:
    """Every literal of the data property `sub` is one of `sup`."""

    sub: Tree
    sup: Tree


Statement: TypeAlias = Subclass | DisjointExpressions | Subrole | DisjointRoles | Subvalue


def statements_of(axiom: Tree) -> Sequence[Statement] | None:
    """Return an axiom's statements; None for an axiom of an unsupported kind, such as rules and keys."""
    said = _SAID.get(str(axiom[0]))
    return None if said is None else said(axiom[1:])


def inverse(role: Tree) -> Tree:
    """The inverse of a role."""
    return role[1] if isinstance(role, tuple) else (INVERSE, role)


def _ring(kind: Callable[[Tree, Tree], Statement], parts: Sequence[Tree]) -> Sequence[Statement]:
    """Each part below the next one, and the last below the first: so all of them are the same."""
    return tuple(map(kind, parts, (*parts[1:], parts[0])))


def _disjoint_union(parts: Sequence[Tree]) -> Sequence[Statement]:
    whole, *others = parts
    return *_ring(Subclass, (whole, ("ObjectUnionOf", *others))), DisjointExpressions(tuple(others))


def _linked(parts: Sequence[Tree]) -> tuple[Tree, Tree]:
    """The nominal of the individual that an assertion is about, and the class of all things that have such a link."""
    role, one, other = parts if isinstance(parts[0], str) else (inverse(parts[0]), parts[2], parts[1])
    return ("ObjectOneOf", one), ("ObjectHasValue", role, other)


def _valued(parts: Sequence[Tree]) -> tuple[Tree, Tree]:
    name, individual, value = parts
    return ("ObjectOneOf", individual), ("DataHasValue", name, value)


def _denied(sub: Tree, sup: Tree) -> Statement:
    return Subclass(sub, ("ObjectComplementOf", sup))


_SAID: Final[Mapping[str, Callable[[Sequence[Tree]], Sequence[Statement]]]] = {
    "Declaration": lambda _: (),
    "DatatypeDefinition": lambda _: (),
    "SubClassOf": lambda p: (Subclass(p[0], p[1]),),
    "EquivalentClasses": lambda p: _ring(Subclass, p),
    "DisjointClasses": lambda p: (DisjointExpressions(tuple(p)),),
    "DisjointUnion": _disjoint_union,
    "ClassAssertion": lambda p: (Subclass(("ObjectOneOf", p[1]), p[0]),),
    "SameIndividual": lambda p: _ring(Subclass, [("ObjectOneOf", name) for name in p]),
    "DifferentIndividuals": lambda p: (DisjointExpressions(tuple(("ObjectOneOf", name) for name in p)),),
    "SubObjectPropertyOf": lambda p: (Subrole(p[0], p[1]),),
    "EquivalentObjectProperties": lambda p: _ring(Subrole, p),
    "InverseObjectProperties": lambda p: _ring(Subrole, (p[0], inverse(p[1]))),
    "DisjointObjectProperties": lambda p: (DisjointRoles(tuple(p)),),
    "SymmetricObjectProperty": lambda p: (Subrole(p[0], inverse(p[0])),),
    "AsymmetricObjectProperty": lambda p: (DisjointRoles((p[0], inverse(p[0]))),),
    "TransitiveObjectProperty": lambda p: (Subrole(("ObjectPropertyChain", p[0], p[0]), p[0]),),
    "ReflexiveObjectProperty": lambda p: (Subclass(THING_IRI, ("ObjectHasSelf", p[0])),),
    "IrreflexiveObjectProperty": lambda p: (Subclass(("ObjectHasSelf", p[0]), NOTHING_IRI),),
    "FunctionalObjectProperty": lambda p: (Subclass(THING_IRI, ("ObjectMaxCardinality", "1", p[0])),),
    "InverseFunctionalObjectProperty": lambda p: (Subclass(THING_IRI, ("ObjectMaxCardinality", "1", inverse(p[0]))),),
    "ObjectPropertyDomain": lambda p: (Subclass(("ObjectSomeValuesFrom", p[0], THING_IRI), p[1]),),
    "ObjectPropertyRange": lambda p: (Subclass(("ObjectSomeValuesFrom", inverse(p[0]), THING_IRI), p[1]),),
    "ObjectPropertyAssertion": lambda p: (Subclass(*_linked(p)),),
    "NegativeObjectPropertyAssertion": lambda p: (_denied(*_linked(p)),),
    "SubDataPropertyOf": lambda p: (Subvalue(p[0], p[1]),),
    "EquivalentDataProperties": lambda p: _ring(Subvalue, p),
    "DisjointDataProperties": lambda p: (DisjointExpressions(tuple(("DataSomeValuesFrom", x, LITERAL) for x in p)),),
    "DataPropertyDomain": lambda p: (Subclass(("DataSomeValuesFrom", p[0], LITERAL), p[1]),),
    "DataPropertyRange": lambda p: (Subclass(THING_IRI, ("DataAllValuesFrom", p[0], p[1])),),
    "FunctionalDataProperty": lambda p: (Subclass(THING_IRI, ("DataMaxCardinality", "1", p[0])),),
    "DataPropertyAssertion": lambda p: (Subclass(*_valued(p)),),
    "NegativeDataPropertyAssertion": lambda p: (_denied(*_valued(p)),),
}
"""The function from the arguments of each kind of axiom to its statements."""
