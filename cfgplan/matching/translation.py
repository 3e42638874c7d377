"""From axioms to the three kinds of statement that the fast engine knows, and what lies outside its fragment.

Inside: ⊤ ⊥ ⊓ ∃, ⊔ and {a, b} on the left, ∃r.{a} on the right, complements of left-hand concepts on the right,
equivalence, disjointness, role hierarchy, chains, transitivity, domain, range (with the restriction of OWL EL),
assertions and negative assertions. An inverse property that is nowhere needed is replaced by the property. What an
outside axiom says inside the fragment is kept: it makes the engine incomplete, never wrong.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from itertools import combinations
from types import MappingProxyType
from typing import Final

from cfgplan.matching.concepts import BOTTOM, TOP, Nominal, Some, conjunction, disjunction
from cfgplan.matching.expressions import BUILT_IN_ROLE, OutsideError, concept_of, role_of
from cfgplan.matching.functional import Tree
from cfgplan.matching.literals import translate_data_properties
from cfgplan.matching.statements import RoleInclusion, Translation, add_range, include, include_all


def translate(trees: Mapping[str, Tree], roles_of_tags: Collection[str] = ()) -> Translation:
    """The statements of some axioms. Of two inverse roles, one that `roles_of_tags` doesn't name is replaced first."""
    result = Translation()
    inverses = replaceable_inverses(trees.values(), roles_of_tags)
    result.replaced_roles = frozenset(inverses)
    for axiom, tree in trees.items():
        try:
            _translate(without_inverses(tree, inverses), axiom, result)
        except OutsideError as reason:
            result.outside[axiom] = str(reason)
    translate_data_properties(trees, result)
    return result


def _translate(tree: Tree, axiom: str, result: Translation) -> None:
    translator = _TRANSLATORS.get(str(tree[0]))
    if translator is None:
        raise OutsideError(f"{tree[0]} is outside the fast fragment")
    translator([*tree[1:]], axiom, result)


def _sub_class_of(arguments: list[Tree], axiom: str, result: Translation) -> None:
    include(concept_of(arguments[0]), concept_of(arguments[1]), axiom, result)


def _equivalent_classes(arguments: list[Tree], axiom: str, result: Translation) -> None:
    concepts = [concept_of(argument) for argument in arguments]
    include_all(zip(concepts, [*concepts[1:], concepts[0]], strict=True), axiom, result)


def _disjoint_classes(arguments: list[Tree], axiom: str, result: Translation) -> None:
    for one, other in combinations(map(concept_of, arguments), 2):
        include(conjunction((one, other)), BOTTOM, axiom, result)


def _disjoint_union(arguments: list[Tree], axiom: str, result: Translation) -> None:
    whole, *parts = map(concept_of, arguments)
    include_all([(part, whole) for part in parts], axiom, result)
    _disjoint_classes(arguments[1:], axiom, result)
    include(whole, disjunction(parts), axiom, result)


def _sub_property(arguments: list[Tree], axiom: str, result: Translation) -> None:
    sub, sup = arguments
    chain = sub[1:] if isinstance(sub, tuple) and sub[0] == "ObjectPropertyChain" else (sub,)
    result.role_inclusions.append(RoleInclusion(tuple(map(role_of, chain)), role_of(sup), axiom))


def _equivalent_properties(arguments: list[Tree], axiom: str, result: Translation) -> None:
    roles = [role_of(argument) for argument in arguments]
    for sub, sup in zip(roles, [*roles[1:], roles[0]], strict=True):
        result.role_inclusions.append(RoleInclusion((sub,), sup, axiom))


def _transitive(arguments: list[Tree], axiom: str, result: Translation) -> None:
    role = role_of(arguments[0])
    result.role_inclusions.append(RoleInclusion((role, role), role, axiom))


def _domain(arguments: list[Tree], axiom: str, result: Translation) -> None:
    include(Some(role_of(arguments[0]), TOP), concept_of(arguments[1]), axiom, result)


def _range(arguments: list[Tree], axiom: str, result: Translation) -> None:
    add_range(role_of(arguments[0]), concept_of(arguments[1]), axiom, result)


def _class_assertion(arguments: list[Tree], axiom: str, result: Translation) -> None:
    include(Nominal(str(arguments[1])), concept_of(arguments[0]), axiom, result)


def _property_assertion(arguments: list[Tree], axiom: str, result: Translation) -> None:
    role, one, other = arguments
    if isinstance(role, tuple):
        role, one, other = role[1], other, one
    include(Nominal(str(one)), Some(role_of(role), Nominal(str(other))), axiom, result)


def _negative_property_assertion(arguments: list[Tree], axiom: str, result: Translation) -> None:
    role, one, other = arguments
    if isinstance(role, tuple):
        role, one, other = role[1], other, one
    include(conjunction((Nominal(str(one)), Some(role_of(role), Nominal(str(other))))), BOTTOM, axiom, result)


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


def replaceable_inverses(trees: Collection[Tree], roles_of_tags: Collection[str]) -> dict[str, str]:
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
            if uses[role] == 1 and role != other and other not in replaced and not role.startswith(BUILT_IN_ROLE):
                replaced[role] = other
                break
    return replaced


def _words(trees: Collection[Tree]) -> Iterator[str]:
    for tree in trees:
        if isinstance(tree, str):
            yield tree
        else:
            yield from _words(tree)


def without_inverses(tree: Tree, inverses: Mapping[str, str]) -> Tree:
    """An axiom with its replaceable inverses replaced. Raises OutsideError for inverses that stay."""
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
