"""Axioms in OWL functional syntax: from text to trees, and which names occur in which role.

Reference: OWL 2 Structural Specification and Functional-Style Syntax (W3C, 2012).
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from typing import Final, NamedTuple, TypeAlias

from cfgplan.matching.concepts import NOTHING_IRI, THING_IRI
from cfgplan.matching.names import short_name

Tree: TypeAlias = "str | tuple[Tree, ...]"
"""An IRI without brackets, a keyword, number or literal; or a keyword followed by its arguments."""

_FUNCTIONAL_TOKEN: Final = re.compile(r'<[^>]*>|"(?:[^"\\]|\\.)*"(?:\^\^<[^>]*>|@[\w-]+)?|[()]|[^\s()<>"]+')

# How the arguments of a keyword are used: c class, r object property, i individual, n number, x anything else.
# The last letter holds for all further arguments.
_USES: Final = {
    "SubClassOf": "c",
    "EquivalentClasses": "c",
    "DisjointClasses": "c",
    "DisjointUnion": "c",
    "ObjectIntersectionOf": "c",
    "ObjectUnionOf": "c",
    "ObjectComplementOf": "c",
    "ObjectOneOf": "i",
    "ObjectSomeValuesFrom": "rc",
    "ObjectAllValuesFrom": "rc",
    "ObjectHasValue": "ri",
    "ObjectHasSelf": "r",
    "ObjectMinCardinality": "nrc",
    "ObjectMaxCardinality": "nrc",
    "ObjectExactCardinality": "nrc",
    "SubObjectPropertyOf": "r",
    "ObjectPropertyChain": "r",
    "ObjectInverseOf": "r",
    "EquivalentObjectProperties": "r",
    "DisjointObjectProperties": "r",
    "InverseObjectProperties": "r",
    "ObjectPropertyDomain": "rc",
    "ObjectPropertyRange": "rc",
    "FunctionalObjectProperty": "r",
    "InverseFunctionalObjectProperty": "r",
    "ReflexiveObjectProperty": "r",
    "IrreflexiveObjectProperty": "r",
    "SymmetricObjectProperty": "r",
    "AsymmetricObjectProperty": "r",
    "TransitiveObjectProperty": "r",
    "ClassAssertion": "ci",
    "ObjectPropertyAssertion": "ri",
    "NegativeObjectPropertyAssertion": "ri",
    "SameIndividual": "i",
    "DifferentIndividuals": "i",
    "DataPropertyDomain": "xc",
    "DataPropertyAssertion": "xix",
    "NegativeDataPropertyAssertion": "xix",
    "HasKey": "cx",
    "ClassAtom": "ci",
    "ObjectPropertyAtom": "ri",
    "DataPropertyAtom": "xix",
    "SameIndividualAtom": "i",
    "DifferentIndividualsAtom": "i",
    "Class": "c",
    "ObjectProperty": "r",
    "NamedIndividual": "i",
}

_FIRST_DISJOINT: Final = {"DisjointUnion": 2, "DisjointClasses": 1, "DisjointObjectProperties": 1}
"""The position of the first disjoint argument, by keyword."""

LOGICAL: Final = frozenset(
    keyword for keyword in _USES if keyword not in {"Class", "ObjectProperty"} and not keyword.endswith("Atom")
) | {
    "SubDataPropertyOf",
    "EquivalentDataProperties",
    "DisjointDataProperties",
    "DataPropertyRange",
    "FunctionalDataProperty",
    "DatatypeDefinition",
    "Declaration",
    "DLSafeRule",
}
"""The keywords of axioms that have a meaning; annotations, imports and headers have none."""


def parse(text: str) -> Tree:
    """The tree of one axiom. Raises ValueError if the brackets don't close."""
    stack: list[list[Tree]] = [[]]
    for token in _FUNCTIONAL_TOKEN.findall(text):
        if token == "(":
            head = stack[-1].pop() if stack[-1] and isinstance(stack[-1][-1], str) else ""
            stack.append([head])
        elif token == ")":
            closed = stack.pop()
            stack[-1].append(_without_repetition(closed))
        else:
            stack[-1].append(token[1:-1] if token[0] == "<" else token)
    if len(stack) != 1 or len(stack[0]) != 1:
        raise ValueError(f"not one axiom in functional syntax: {text!r}")
    return stack[0][0]


def leaves(tree: Tree) -> Iterator[str]:
    """The arguments of an axiom or expression at any depth: names, numbers and literals, but no keyword."""
    if isinstance(tree, str):
        yield tree
    else:
        for part in tree[1:]:
            yield from leaves(part)


def symbols(tree: Tree) -> frozenset[str]:
    """The classes, properties and datatypes in an axiom or expression: all names but those of individuals."""
    return frozenset(_symbols(tree)) - {THING_IRI, NOTHING_IRI}


def _symbols(tree: Tree) -> Iterator[str]:
    if tree[0] == "Variable":
        return
    if tree[0] == "HasKey":
        yield from _strings(tree[1:])  # the class of a key may stand where a keyword does
    uses = _USES.get(str(tree[0]), "x")
    for position, argument in enumerate(tree[1:]):
        if isinstance(argument, tuple):
            yield from _symbols(argument)
        elif uses[min(position, len(uses) - 1)] in "crx" and not argument.startswith('"'):
            yield argument


def _strings(tree: Tree) -> Iterator[str]:
    if isinstance(tree, str):
        yield tree
    else:
        for part in tree:
            yield from _strings(part)


def _without_repetition(closed: list[Tree]) -> Tree:
    """Remove repeated operands of a disjointness axiom, which are a set (OWL 2, 2.1), if two or more are left."""
    first = _FIRST_DISJOINT.get(str(closed[0]))
    if first is None:
        return tuple(closed)
    parts = dict.fromkeys(closed[first:])
    return tuple(closed) if len(parts) < 2 and first == 1 else (*closed[:first], *parts)


def rule_text(tree: Tree) -> str:
    """A rule as `A(x), r(x, y) → B(y)`, with short names."""
    body, head = (", ".join(map(_atom_text, part[1:])) for part in tree[1:])
    return f"{body} → {head}"


def _atom_text(atom: Tree) -> str:
    keyword = atom[0]
    names = [short_name(str(part[1])) if isinstance(part, tuple) else _argument_text(part) for part in atom[1:]]
    if str(keyword) in ("SameIndividualAtom", "DifferentIndividualsAtom"):
        return (" = " if keyword == "SameIndividualAtom" else " ≠ ").join(names)
    return f"{names[0]}({', '.join(names[1:])})"


def _argument_text(argument: str) -> str:
    return argument.partition("^^")[0] if argument.startswith('"') else short_name(argument)


class Signature(NamedTuple):
    """The names that occur in axioms, by their use as class, role or individual."""

    classes: frozenset[str]
    roles: frozenset[str]
    individuals: frozenset[str]


def signature_of(trees: Iterable[Tree]) -> Signature:
    """The names in the trees of axioms."""
    names: dict[str, set[str]] = {"c": set(), "r": set(), "i": set()}
    ahead = [*trees]
    for tree in ahead:
        uses = _USES.get(str(tree[0]), "x")
        for position, argument in enumerate(tree[1:]):
            if isinstance(argument, tuple):
                ahead.append(argument)
            elif not argument.startswith("_:"):
                names.setdefault(uses[min(position, len(uses) - 1)], set()).add(argument)
    return Signature(frozenset(names["c"] - {THING_IRI, NOTHING_IRI}), frozenset(names["r"]), frozenset(names["i"]))


def joined(signatures: Iterable[Signature]) -> Signature:
    """The names of several signatures."""
    return Signature(*(frozenset[str]().union(*names) for names in zip(*signatures, strict=True)))
