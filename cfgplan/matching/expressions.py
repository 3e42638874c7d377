"""Class expressions as concepts, and whether the fast engine supports them on the left or right of an inclusion."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from cfgplan.matching.concepts import (
    TOP,
    AtLeast,
    AtMost,
    Complement,
    Concept,
    Intersection,
    Named,
    Nominal,
    Only,
    Some,
    Union,
    at_least,
    conjunction,
    disjunction,
    negation,
    some,
    walk,
)
from cfgplan.matching.functional import Tree

BUILT_IN_ROLE: Final = "http://www.w3.org/2002/07/owl#"


class OutsideError(Exception):
    """An expression that the fast engine does not support."""


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
            return some(role_of(arguments[0]), concept_of(arguments[1]))
        case "ObjectAllValuesFrom":
            return Only(role_of(arguments[0]), concept_of(arguments[1]))
        case "ObjectHasValue":
            return Some(role_of(arguments[0]), Nominal(str(arguments[1])))
        case "ObjectMinCardinality" | "ObjectMaxCardinality" | "ObjectExactCardinality":
            number, role = int(str(arguments[0])), role_of(arguments[1])
            filler = concept_of(arguments[2]) if len(arguments) > 2 else TOP
            least, most = at_least(number, role, filler), AtMost(number, role, filler)
            return {"Min": least, "Max": most, "Exa": conjunction((least, most))}[str(keyword)[6:9]]
    raise OutsideError(f"{keyword} is outside the fast fragment")


def role_of(tree: Tree) -> str:
    """The named object property. Raises OutsideError for an inverse and for the built-in ones."""
    if isinstance(tree, tuple):
        raise OutsideError("an inverse property is outside the fast fragment")
    if tree.startswith(BUILT_IN_ROLE):
        raise OutsideError("the universal and the empty property are outside the fast fragment")
    return tree


def is_left_hand(concept: Concept) -> bool:
    """Whether the engine can recognise members of the concept: names, nominals, ⊓, ⊔ and ∃."""
    return all(isinstance(part, Named | Nominal | Intersection | Union | Some) for part in walk(concept))


def right_hand_parts(concept: Concept, reasons: list[str]) -> Iterator[Concept]:
    """The conjuncts inside the fragment that an implied concept has; `reasons` gets why others are outside."""
    match concept:
        case Intersection(parts):
            for part in parts:
                yield from right_hand_parts(part, reasons)
        case Named():
            yield concept
        case Some(role, filler):
            if isinstance(filler, Nominal):
                yield concept
            elif isinstance(filler, Intersection) and any(isinstance(part, Nominal) for part in filler.parts):
                reasons.append("a filler joins an individual with something else")
                yield from (Some(role, part) for part in filler.parts if isinstance(part, Nominal))
            else:
                inner = list(right_hand_parts(filler, reasons))
                if any(isinstance(part, Complement) for part in inner):
                    reasons.append("a filler is a complement")
                yield some(role, conjunction(part for part in inner if not isinstance(part, Complement)))
        case AtLeast(_, role, filler):
            if any(isinstance(part, Nominal) for part in walk(filler)):
                reasons.append("individuals are counted")
            yield from right_hand_parts(Some(role, filler), reasons)
        case Complement(part) if is_left_hand(part):
            yield concept
        case _:
            reasons.append(f"{_WORDS_FOR_KINDS[type(concept)]} on the right-hand side is outside the fast fragment")


_WORDS_FOR_KINDS: Final = {
    Nominal: "an individual",
    Complement: "a complement",
    Union: "a union",
    Only: "∀",
    AtMost: "≤",
}
