"""Translates axioms to the three kinds of statement that the fast engine knows, and finds axioms outside its fragment.

Inside: ⊤ ⊥ ⊓ ∃, ⊔ and {a, b} on the left, ∃r.{a} on the right, complements of left-hand concepts on the right,
equivalence, disjointness, role hierarchy, chains, transitivity, domain, range (with the restriction of OWL EL),
assertions and negative assertions. An inverse property that is not needed anywhere is replaced by the property. If an
axiom is partly outside, the part inside is kept: the engine is then incomplete, never wrong.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import combinations
from typing import Final

from cfgplan.matching.axioms import DisjointExpressions, Statement, Subclass, Subrole, statements_of
from cfgplan.matching.concepts import BOTTOM, THING_IRI, TOP, Complement, Concept, Nominal, Only, Union, conjunction
from cfgplan.matching.expressions import (
    BUILT_IN_ROLE,
    OutsideError,
    concept_of,
    is_left_hand,
    right_hand_parts,
    role_of,
)
from cfgplan.matching.functional import Tree, leaves
from cfgplan.matching.literals import above_of, reached_from

_ABOUT_LITERALS: Final = frozenset(
    (
        *("DataPropertyAssertion", "SubDataPropertyOf", "EquivalentDataProperties"),
        *("DataPropertyDomain", "DataPropertyRange", "FunctionalDataProperty"),
    )
)
"""The axioms that `_translate_literals` takes together."""


@dataclass(frozen=True, slots=True)
class Inclusion:
    """`sub` ⊑ `sup`, by the axiom given as text."""

    sub: Concept
    sup: Concept
    axiom: str


@dataclass(frozen=True, slots=True)
class RoleInclusion:
    """`chain[0]` ∘ `chain[1]` ∘ ... ⊑ `role`."""

    chain: tuple[str, ...]
    role: str
    axiom: str


@dataclass(frozen=True, slots=True)
class Range:
    """All things that `role` points to are in `concept`."""

    role: str
    concept: Concept
    axiom: str


@dataclass
class Translation:
    """The statements, the axioms outside the fragment with the reason, and the roles that inverses replaced.

    If an axiom is partly outside, the statements have the part inside.
    """

    inclusions: list[Inclusion] = field(default_factory=list)
    role_inclusions: list[RoleInclusion] = field(default_factory=list)
    ranges: list[Range] = field(default_factory=list)
    outside: dict[str, str] = field(default_factory=dict)
    replaced_roles: frozenset[str] = frozenset()

    def include(self, sub: Concept, sup: Concept, axiom: str) -> None:
        """Add the statement sub ⊑ sup, or the part of it inside the fragment."""
        if sup == TOP or sub == BOTTOM:
            return
        if isinstance(sub, Union):
            for part in sub.parts:
                self.include(part, sup, axiom)
        elif sub == TOP and isinstance(sup, Only):
            self.add_range(sup.role, sup.filler, axiom)
        elif not is_left_hand(sub):
            self.outside.setdefault(axiom, "its left-hand side is outside the fast fragment")
        else:
            for part in self._right_hand_parts(sup, axiom):
                if isinstance(part, Complement):
                    self.inclusions.append(Inclusion(conjunction((sub, part.concept)), BOTTOM, axiom))
                else:
                    self.inclusions.append(Inclusion(sub, part, axiom))

    def add_range(self, role: str, concept: Concept, axiom: str) -> None:
        """Add a range of a role, or the part of it inside the fragment."""
        for part in self._right_hand_parts(concept, axiom):
            if isinstance(part, Complement):
                self.outside.setdefault(axiom, "a complement as a range is outside the fast fragment")
            else:
                self.ranges.append(Range(role, part, axiom))

    def _right_hand_parts(self, concept: Concept, axiom: str) -> Iterator[Concept]:
        reasons: list[str] = []
        yield from right_hand_parts(concept, reasons)
        if reasons:
            self.outside.setdefault(axiom, reasons[0])


def translate(trees: Mapping[str, Tree], roles_of_tags: Collection[str] = ()) -> Translation:
    """Translate axioms to statements. If one of two inverse roles is replaced, it is preferably one not in
    `roles_of_tags`.
    """
    result = Translation()
    inverses = replaceable_inverses(trees.values(), roles_of_tags)
    result.replaced_roles = frozenset(inverses)
    for axiom, tree in trees.items():
        if tree[0] not in _ABOUT_LITERALS:
            try:
                _translate(without_inverses(tree, inverses), axiom, result)
            except OutsideError as reason:
                result.outside[axiom] = str(reason)
    _translate_literals(trees, result)
    return result


def _translate(tree: Tree, axiom: str, result: Translation) -> None:
    if tree[0] == "DifferentIndividuals" and len(set(tree)) == len(tree):
        return  # The fragment can't make individuals equal, except by a tag, which is then not certified.
    statements = statements_of(tree)
    if statements is None:
        raise OutsideError(f"{tree[0]} is outside the fast fragment")
    for statement in statements:
        try:
            _say(statement, axiom, result)
        except OutsideError as reason:
            result.outside.setdefault(axiom, str(reason))


def _say(statement: Statement, axiom: str, result: Translation) -> None:
    match statement:
        case Subclass(("ObjectSomeValuesFrom", (_, role), sub), sup) if sub == THING_IRI:
            result.add_range(role_of(role), concept_of(sup), axiom)
        case Subclass(sub, sup):
            result.include(concept_of(sub), concept_of(sup), axiom)
        case DisjointExpressions(parts):
            for one, other in combinations(map(concept_of, parts), 2):
                result.include(conjunction((one, other)), BOTTOM, axiom)
        case Subrole(sub, sup):
            chain = sub[1:] if isinstance(sub, tuple) and sub[0] == "ObjectPropertyChain" else (sub,)
            result.role_inclusions.append(RoleInclusion(tuple(map(role_of, chain)), role_of(sup), axiom))
        case _:
            raise OutsideError("disjoint properties are outside the fast fragment")


def _translate_literals(trees: Mapping[str, Tree], result: Translation) -> None:
    """Add the domains that literals imply for their individuals. Axioms that could contradict literals are outside."""
    above = above_of(trees.values())
    individuals: defaultdict[Tree, set[str]] = defaultdict(set)
    for tree in trees.values():
        if tree[0] == "DataPropertyAssertion":
            for name in reached_from(tree[1], above):
                individuals[name].add(str(tree[2]))
    for axiom, tree in trees.items():
        if tree[0] == "DataPropertyDomain":
            try:
                for individual in sorted(individuals[tree[1]]):
                    result.include(Nominal(individual), concept_of(tree[2]), axiom)
            except OutsideError as reason:
                result.outside[axiom] = str(reason)
        elif tree[0] in ("DataPropertyRange", "FunctionalDataProperty") and individuals[tree[1]]:
            result.outside[axiom] = "a restriction of literals that are in use is outside the fast fragment"


def replaceable_inverses(trees: Collection[Tree], roles_of_tags: Collection[str]) -> dict[str, str]:
    """Roles that only name the inverse of another: nothing but a declaration, domain, range or assertion uses them."""
    uses: Counter[str] = Counter()
    pairs: list[tuple[str, str]] = []
    for tree in trees:
        keyword = tree[0]
        if keyword == "InverseObjectProperties" and isinstance(tree[1], str) and isinstance(tree[2], str):
            pairs.append((tree[1], tree[2]))
            uses.update((tree[1], tree[2]))
        elif keyword in ("ObjectPropertyDomain", "ObjectPropertyRange"):
            uses.update(leaves(tree[2]))
        elif keyword == "ObjectPropertyAssertion":
            uses.update(() if isinstance(tree[1], str) else (str(tree[1][1]), str(tree[1][1])))
        elif keyword != "Declaration":
            uses.update(leaves(tree))
    replaced: dict[str, str] = {}
    for pair in pairs:
        for role, other in sorted((pair, pair[::-1]), key=lambda turn: (turn[0] in roles_of_tags, turn)):
            if uses[role] == 1 and role != other and other not in replaced and not role.startswith(BUILT_IN_ROLE):
                replaced[role] = other
                break
    return replaced


def without_inverses(tree: Tree, inverses: Mapping[str, str]) -> Tree:
    """An axiom with its replaceable inverses replaced. Raises OutsideError for inverses that stay."""
    assert not isinstance(tree, str), "an axiom is a keyword with arguments"
    keyword, rest = tree[0], tree[1:]
    if keyword == "InverseObjectProperties":
        if rest[0] in inverses or rest[1] in inverses:
            return ("Declaration",)  # nothing is left to say
        raise OutsideError("inverse properties that are both in use are outside the fast fragment")
    role = inverses.get(str(rest[0])) if rest and isinstance(rest[0], str) else None
    if role is None:
        return tree
    match keyword:
        case "ObjectPropertyDomain":
            return ("ObjectPropertyRange", role, *rest[1:])
        case "ObjectPropertyRange":
            return ("ObjectPropertyDomain", role, *rest[1:])
        case "ObjectPropertyAssertion":
            return (keyword, role, rest[2], rest[1])
    return tree
