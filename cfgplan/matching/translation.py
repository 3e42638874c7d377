"""From axioms to the three kinds of statement that the fast engine knows, and what lies outside its fragment.

Inside: ⊤ ⊥ ⊓ ∃, ⊔ and {a, b} on the left, ∃r.{a} on the right, complements of left-hand concepts on the right,
equivalence, disjointness, role hierarchy, chains, transitivity, domain, range (with the restriction of OWL EL),
assertions and negative assertions. An inverse property that is nowhere needed is replaced by the property. What an
outside axiom says inside the fragment is kept: it makes the engine incomplete, never wrong.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import combinations
from types import MappingProxyType
from typing import Final

from cfgplan.matching.concepts import (
    BOTTOM,
    TOP,
    And,
    AtLeast,
    AtMost,
    Concept,
    Named,
    Nominal,
    Not,
    Only,
    Or,
    Some,
    at_least,
    conjunction,
    disjunction,
    negation,
    some,
)
from cfgplan.matching.functional import Tree

_BUILT_IN_ROLE: Final = "http://www.w3.org/2002/07/owl#"


class OutsideError(Exception):
    """An expression that the fast engine has no words for."""


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
    """Whatever `role` points to is a `concept`."""

    role: str
    concept: Concept
    axiom: str


@dataclass
class Translation:
    """The statements, the axioms outside the fragment with the reason, and roles that inverses replaced."""

    inclusions: list[Inclusion] = field(default_factory=list)
    role_inclusions: list[RoleInclusion] = field(default_factory=list)
    ranges: list[Range] = field(default_factory=list)
    outside: dict[str, str] = field(default_factory=dict)
    replaced_roles: frozenset[str] = frozenset()


def translate(trees: Mapping[str, Tree], roles_of_tags: Collection[str] = ()) -> Translation:
    """The statements of some axioms. Inverses that `roles_of_tags` doesn't name are rather replaced than others."""
    result = Translation()
    inverses = _replaceable_inverses(trees.values(), roles_of_tags)
    result.replaced_roles = frozenset(inverses)
    for axiom, tree in trees.items():
        try:
            _translate(_without_inverses(tree, inverses), axiom, result)
        except OutsideError as reason:
            result.outside[axiom] = str(reason)
    _translate_data_properties(trees, result)
    return result


def concept_of(tree: Tree) -> Concept:
    """The concept that a class expression means. Raises OutsideError for one without a concept."""
    if isinstance(tree, str):
        return Named(tree)
    keyword, arguments = tree[0], tree[1:]
    match keyword:
        case "ObjectIntersectionOf":
            return conjunction(map(concept_of, arguments))
        case "ObjectUnionOf":
            return disjunction(map(concept_of, arguments))
        case "ObjectComplementOf":
            return negation(concept_of(arguments[0]))
        case "ObjectOneOf":
            return disjunction(Nominal(str(name)) for name in arguments)
        case "ObjectSomeValuesFrom":
            return some(_role(arguments[0]), concept_of(arguments[1]))
        case "ObjectAllValuesFrom":
            return Only(_role(arguments[0]), concept_of(arguments[1]))
        case "ObjectHasValue":
            return Some(_role(arguments[0]), Nominal(str(arguments[1])))
        case "ObjectMinCardinality" | "ObjectMaxCardinality" | "ObjectExactCardinality":
            number, role = int(str(arguments[0])), _role(arguments[1])
            filler = concept_of(arguments[2]) if len(arguments) > 2 else TOP
            least, most = at_least(number, role, filler), AtMost(number, role, filler)
            return {"Min": least, "Max": most, "Exa": conjunction((least, most))}[str(keyword)[6:9]]
    raise OutsideError(f"{keyword} is outside the fast fragment")


def _role(tree: Tree) -> str:
    if isinstance(tree, tuple):
        raise OutsideError("an inverse property is outside the fast fragment")
    if tree.startswith(_BUILT_IN_ROLE):
        raise OutsideError("the universal and the empty property are outside the fast fragment")
    return tree


def _translate(tree: Tree, axiom: str, result: Translation) -> None:
    translator = _TRANSLATORS.get(str(tree[0]))
    if translator is None:
        raise OutsideError(f"{tree[0]} is outside the fast fragment")
    translator([*tree[1:]], axiom, result)


def _sub_class_of(arguments: list[Tree], axiom: str, result: Translation) -> None:
    _include(concept_of(arguments[0]), concept_of(arguments[1]), axiom, result)


def _equivalent_classes(arguments: list[Tree], axiom: str, result: Translation) -> None:
    concepts = [concept_of(argument) for argument in arguments]
    _include_all(zip(concepts, [*concepts[1:], concepts[0]], strict=True), axiom, result)


def _disjoint_classes(arguments: list[Tree], axiom: str, result: Translation) -> None:
    for one, other in combinations(map(concept_of, arguments), 2):
        _include(conjunction((one, other)), BOTTOM, axiom, result)


def _disjoint_union(arguments: list[Tree], axiom: str, result: Translation) -> None:
    whole, *parts = map(concept_of, arguments)
    _include_all([(part, whole) for part in parts], axiom, result)
    _disjoint_classes(arguments[1:], axiom, result)
    _include(whole, disjunction(parts), axiom, result)


def _sub_property(arguments: list[Tree], axiom: str, result: Translation) -> None:
    sub, sup = arguments
    chain = sub[1:] if isinstance(sub, tuple) and sub[0] == "ObjectPropertyChain" else (sub,)
    result.role_inclusions.append(RoleInclusion(tuple(map(_role, chain)), _role(sup), axiom))


def _equivalent_properties(arguments: list[Tree], axiom: str, result: Translation) -> None:
    roles = [_role(argument) for argument in arguments]
    for sub, sup in zip(roles, [*roles[1:], roles[0]], strict=True):
        result.role_inclusions.append(RoleInclusion((sub,), sup, axiom))


def _transitive(arguments: list[Tree], axiom: str, result: Translation) -> None:
    role = _role(arguments[0])
    result.role_inclusions.append(RoleInclusion((role, role), role, axiom))


def _domain(arguments: list[Tree], axiom: str, result: Translation) -> None:
    _include(Some(_role(arguments[0]), TOP), concept_of(arguments[1]), axiom, result)


def _range(arguments: list[Tree], axiom: str, result: Translation) -> None:
    _add_range(_role(arguments[0]), concept_of(arguments[1]), axiom, result)


def _class_assertion(arguments: list[Tree], axiom: str, result: Translation) -> None:
    _include(Nominal(str(arguments[1])), concept_of(arguments[0]), axiom, result)


def _property_assertion(arguments: list[Tree], axiom: str, result: Translation) -> None:
    role, one, other = arguments
    if isinstance(role, tuple):
        role, one, other = role[1], other, one
    _include(Nominal(str(one)), Some(_role(role), Nominal(str(other))), axiom, result)


def _negative_property_assertion(arguments: list[Tree], axiom: str, result: Translation) -> None:
    role, one, other = arguments
    if isinstance(role, tuple):
        role, one, other = role[1], other, one
    _include(conjunction((Nominal(str(one)), Some(_role(role), Nominal(str(other))))), BOTTOM, axiom, result)


def _different_individuals(arguments: list[Tree], axiom: str, result: Translation) -> None:  # noqa: ARG001
    # Nothing to add: the fragment can't make individuals equal, except by a tag, which is then not certified.
    if len(set(arguments)) != len(arguments):
        raise OutsideError("an individual is said to differ from itself")


def _nothing(arguments: list[Tree], axiom: str, result: Translation) -> None:
    """An axiom that says nothing about classes by itself."""


_TRANSLATORS: Final[Mapping[str, Callable[[list[Tree], str, Translation], None]]] = MappingProxyType(
    {
        "SubClassOf": _sub_class_of,
        "EquivalentClasses": _equivalent_classes,
        "DisjointClasses": _disjoint_classes,
        "DisjointUnion": _disjoint_union,
        "SubObjectPropertyOf": _sub_property,
        "EquivalentObjectProperties": _equivalent_properties,
        "TransitiveObjectProperty": _transitive,
        "ObjectPropertyDomain": _domain,
        "ObjectPropertyRange": _range,
        "ClassAssertion": _class_assertion,
        "ObjectPropertyAssertion": _property_assertion,
        "NegativeObjectPropertyAssertion": _negative_property_assertion,
        "DifferentIndividuals": _different_individuals,
        "InverseObjectProperties": _nothing,
        "Declaration": _nothing,
        "DatatypeDefinition": _nothing,
        "DataPropertyAssertion": _nothing,
        "SubDataPropertyOf": _nothing,
        "EquivalentDataProperties": _nothing,
        "DataPropertyDomain": _nothing,
        "DataPropertyRange": _nothing,
        "FunctionalDataProperty": _nothing,
    }
)


def _include_all(pairs: Iterable[tuple[Concept, Concept]], axiom: str, result: Translation) -> None:
    """Add every sub ⊑ sup, and then raise the first OutsideError there was."""
    reasons: list[OutsideError] = []
    for sub, sup in pairs:
        try:
            _include(sub, sup, axiom, result)
        except OutsideError as reason:
            reasons.append(reason)
    if reasons:
        raise reasons[0]


def _include(sub: Concept, sup: Concept, axiom: str, result: Translation) -> None:
    """Add sub ⊑ sup as far as it is inside the fragment. Raises OutsideError at the end if something is not."""
    if sup == TOP or sub == BOTTOM:
        return
    if isinstance(sub, Or):
        for part in sub.parts:
            _include(part, sup, axiom, result)
        return
    if sub == TOP and isinstance(sup, Only):
        _add_range(sup.role, sup.filler, axiom, result)
        return
    if not is_left_hand(sub):
        raise OutsideError("its left-hand side is outside the fast fragment")
    reasons: list[str] = []
    for part in _right_hand_parts(sup, reasons):
        if isinstance(part, Not):
            result.inclusions.append(Inclusion(conjunction((sub, part.concept)), BOTTOM, axiom))
        else:
            result.inclusions.append(Inclusion(sub, part, axiom))
    if reasons:
        raise OutsideError(reasons[0])


def _add_range(role: str, concept: Concept, axiom: str, result: Translation) -> None:
    reasons: list[str] = []
    for part in _right_hand_parts(concept, reasons):
        if isinstance(part, Not):
            reasons.append("a complement as a range is outside the fast fragment")
        else:
            result.ranges.append(Range(role, part, axiom))
    if reasons:
        raise OutsideError(reasons[0])


def is_left_hand(concept: Concept) -> bool:
    """Whether the engine can recognise members of the concept: names, nominals, ⊓, ⊔ and ∃."""
    match concept:
        case Named() | Nominal():
            return True
        case And(parts) | Or(parts):
            return all(map(is_left_hand, parts))
        case Some(_, filler):
            return is_left_hand(filler)
    return False


def _right_hand_parts(concept: Concept, reasons: list[str]) -> Iterator[Concept]:
    """Conjuncts inside the fragment that the concept implies; `reasons` tells what they leave out."""
    match concept:
        case And(parts):
            for part in parts:
                yield from _right_hand_parts(part, reasons)
        case Named():
            yield concept
        case Some(role, filler):
            if isinstance(filler, Nominal):
                yield concept
            elif isinstance(filler, And) and any(isinstance(part, Nominal) for part in filler.parts):
                reasons.append("a filler joins an individual with something else")
                yield from (Some(role, part) for part in filler.parts if isinstance(part, Nominal))
            else:
                inner = list(_right_hand_parts(filler, reasons))
                if any(isinstance(part, Not) for part in inner):
                    reasons.append("a filler is a complement")
                yield some(role, conjunction(part for part in inner if not isinstance(part, Not)))
        case AtLeast(_, role, filler):
            if _mentions_nominal(filler):
                reasons.append("individuals are counted")
            yield from _right_hand_parts(Some(role, filler), reasons)
        case Not(part) if is_left_hand(part):
            yield concept
        case _:
            reasons.append(f"{_WORDS[type(concept)]} on the right-hand side is outside the fast fragment")


_WORDS: Final = {Nominal: "an individual", Not: "a complement", Or: "a union", Only: "∀", AtMost: "≤"}


def _mentions_nominal(concept: Concept) -> bool:
    match concept:
        case Nominal():
            return True
        case And(parts) | Or(parts):
            return any(map(_mentions_nominal, parts))
        case Some(_, filler) | Only(_, filler) | AtLeast(_, _, filler) | AtMost(_, _, filler):
            return _mentions_nominal(filler)
        case Not(part):
            return _mentions_nominal(part)
    return False


def _replaceable_inverses(trees: Collection[Tree], roles_of_tags: Collection[str]) -> dict[str, str]:
    """Roles that only name the inverse of another: declared, with domain, range and assertions, nothing else."""
    uses: Counter[str] = Counter()
    pairs: list[tuple[str, str]] = []
    for tree in trees:
        keyword = tree[0]
        if keyword == "InverseObjectProperties" and isinstance(tree[1], str) and isinstance(tree[2], str):
            pairs.append((tree[1], tree[2]))
            uses.update((tree[1], tree[2]))
        elif keyword in ("ObjectPropertyDomain", "ObjectPropertyRange"):
            uses.update(_words(tree[2:]))
        elif keyword == "ObjectPropertyAssertion":
            uses.update(() if isinstance(tree[1], str) else (str(tree[1][1]), str(tree[1][1])))
        elif keyword != "Declaration":
            uses.update(_words(tree[1:]))
    replaced: dict[str, str] = {}
    for pair in pairs:
        for role, other in sorted((pair, pair[::-1]), key=lambda turn: (turn[0] in roles_of_tags, turn)):
            if uses[role] == 1 and role != other and other not in replaced and not role.startswith(_BUILT_IN_ROLE):
                replaced[role] = other
                break
    return replaced


def _words(trees: Collection[Tree]) -> Iterator[str]:
    for tree in trees:
        if isinstance(tree, str):
            yield tree
        else:
            yield from _words(tree)


def _without_inverses(tree: Tree, inverses: Mapping[str, str]) -> Tree:
    assert not isinstance(tree, str), "an axiom is a keyword with arguments"
    keyword, rest = tree[0], tree[1:]
    if keyword == "InverseObjectProperties":
        if rest[0] in inverses or rest[1] in inverses:
            return tree
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


def _translate_data_properties(trees: Mapping[str, Tree], result: Translation) -> None:
    """What literals say about their individuals: the domains; what could contradict them is outside."""
    above: defaultdict[Tree, set[Tree]] = defaultdict(set)
    for tree in trees.values():
        if tree[0] == "SubDataPropertyOf":
            above[tree[1]].add(tree[2])
        elif tree[0] == "EquivalentDataProperties":
            for one in tree[1:]:
                above[one].update(tree[1:])
    individuals: defaultdict[Tree, set[str]] = defaultdict(set)
    for tree in trees.values():
        if tree[0] == "DataPropertyAssertion":
            reached, waiting = {tree[1]}, [tree[1]]
            while waiting:
                news = above[waiting.pop()] - reached
                reached |= news
                waiting += news
            for name in reached:
                individuals[name].add(str(tree[2]))
    for axiom, tree in trees.items():
        if tree[0] == "DataPropertyDomain":
            try:
                for individual in sorted(individuals[tree[1]]):
                    _include(Nominal(individual), concept_of(tree[2]), axiom, result)
            except OutsideError as reason:
                result.outside[axiom] = str(reason)
        elif tree[0] in ("DataPropertyRange", "FunctionalDataProperty") and individuals[tree[1]]:
            result.outside[axiom] = "a restriction of literals that are in use is outside the fast fragment"
