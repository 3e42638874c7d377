"""Class expressions of description logic as hashable values, equal if they are written the same.

Conjunctions and disjunctions are sets: the order of their parts and repetitions don't count. Names are IRIs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final, TypeAlias

THING_IRI = "http://www.w3.org/2002/07/owl#Thing"
NOTHING_IRI = "http://www.w3.org/2002/07/owl#Nothing"


@dataclass(frozen=True, slots=True)
class Named:
    """A named class."""

    iri: str


@dataclass(frozen=True, slots=True)
class Nominal:
    """The class of exactly one individual, {a}."""

    iri: str


@dataclass(frozen=True, slots=True)
class Complement:
    """Complement, ¬C."""

    concept: Concept


@dataclass(frozen=True, slots=True)
class Intersection:
    """Conjunction of two or more, C ⊓ D; made by `conjunction`."""

    parts: frozenset[Concept]


@dataclass(frozen=True, slots=True)
class Union:
    """Disjunction of two or more, C ⊔ D; made by `disjunction`."""

    parts: frozenset[Concept]


@dataclass(frozen=True, slots=True)
class Some:
    """Existential restriction, ∃r.C."""

    role: str
    filler: Concept


@dataclass(frozen=True, slots=True)
class Only:
    """Value restriction, ∀r.C."""

    role: str
    filler: Concept


@dataclass(frozen=True, slots=True)
class AtLeast:
    """Number restriction, ≥n r.C."""

    number: int
    role: str
    filler: Concept


@dataclass(frozen=True, slots=True)
class AtMost:
    """Number restriction, ≤n r.C."""

    number: int
    role: str
    filler: Concept


Concept: TypeAlias = Named | Nominal | Complement | Intersection | Union | Some | Only | AtLeast | AtMost

TOP = Named(THING_IRI)
BOTTOM = Named(NOTHING_IRI)


def conjunction(parts: Iterable[Concept]) -> Concept:
    """C ⊓ D ⊓ ..., flat, without ⊤ and repetitions; ⊤ if nothing is left."""
    return _joined(Intersection, parts, TOP, BOTTOM)


def disjunction(parts: Iterable[Concept]) -> Concept:
    """C ⊔ D ⊔ ..., flat, without ⊥ and repetitions; ⊥ if nothing is left."""
    return _joined(Union, parts, BOTTOM, TOP)


def _joined(kind: type[Intersection | Union], parts: Iterable[Concept], neutral: Concept, dominant: Concept) -> Concept:
    flat: set[Concept] = set()
    for part in parts:
        flat.update(part.parts if isinstance(part, kind) else (part,))
    flat.discard(neutral)
    if dominant in flat:
        return dominant
    if len(flat) > 1:
        return kind(frozenset(flat))
    return flat.pop() if flat else neutral


def negation(concept: Concept) -> Concept:
    """¬C, without double negation."""
    if isinstance(concept, Complement):
        return concept.concept
    if concept == TOP:
        return BOTTOM
    return TOP if concept == BOTTOM else Complement(concept)


def some(role: str, filler: Concept) -> Concept:
    """∃r.C; ⊥ if the filler is."""
    return BOTTOM if filler == BOTTOM else Some(role, filler)


def at_least(number: int, role: str, filler: Concept) -> Concept:
    """≥n r.C, as ⊤ or ∃r.C where that is the same."""
    if number == 0:
        return TOP
    return some(role, filler) if number == 1 else AtLeast(number, role, filler)


def walk(concept: Concept) -> Iterator[Concept]:
    """A concept and all that it is made of."""
    yield concept
    match concept:
        case Intersection(parts) | Union(parts):
            for part in parts:
                yield from walk(part)
        case Some(_, part) | Only(_, part) | AtLeast(_, _, part) | AtMost(_, _, part) | Complement(part):
            yield from walk(part)


def in_description_logic(concept: Concept, name: Callable[[str], str]) -> str:
    """The concept in DL syntax, its parts in alphabetical order; `name` shortens an IRI."""
    match concept:
        case Named(iri):
            return {THING_IRI: "⊤", NOTHING_IRI: "⊥"}.get(iri) or name(iri)
        case Nominal(iri):
            return f"{{{name(iri)}}}"
        case Complement(part):
            return f"¬{_operand(part, name)}"
        case Intersection(parts) | Union(parts):
            sign = " ⊓ " if isinstance(concept, Intersection) else " ⊔ "
            return sign.join(sorted((_operand(part, name) for part in parts), key=_names_first))
        case Some(role, filler) | Only(role, filler):
            return f"{'∃' if isinstance(concept, Some) else '∀'}{name(role)}.{_operand(filler, name)}"
        case AtLeast(number, role, filler) | AtMost(number, role, filler):
            sign = "≥" if isinstance(concept, AtLeast) else "≤"
            return f"{sign}{number} {name(role)}.{_operand(filler, name)}"


_QUANTIFIERS: Final = MappingProxyType({Some: "some", Only: "only", AtLeast: "min", AtMost: "max"})


def in_words(concept: Concept, name: Callable[[str], str]) -> str:
    """The concept in Manchester syntax, its parts in alphabetical order; `name` shortens an IRI."""

    def operand(part: Concept) -> str:
        return in_words(part, name) if isinstance(part, Named | Nominal) else f"({in_words(part, name)})"

    match concept:
        case Complement(part):
            return f"not {operand(part)}"
        case Intersection(parts) | Union(parts):
            sign = " and " if isinstance(concept, Intersection) else " or "
            texts = (in_words(part, name) if isinstance(part, Some) else operand(part) for part in parts)
            return sign.join(sorted(texts, key=lambda text: (" " in text, text)))
        case Some(role, Nominal(iri)):
            return f"{name(role)} value {name(iri)}"
        case Some(role, filler) | Only(role, filler):
            return f"{name(role)} {_QUANTIFIERS[type(concept)]} {operand(filler)}"
        case AtLeast(number, role, filler) | AtMost(number, role, filler):
            return f"{name(role)} {_QUANTIFIERS[type(concept)]} {number} {operand(filler)}"
    return in_description_logic(concept, name)


def in_functional_syntax(concept: Concept) -> str:
    """The concept in OWL functional syntax with full IRIs, the same text for equal concepts."""
    match concept:
        case Named(iri):
            return f"<{iri}>"
        case Nominal(iri):
            return f"ObjectOneOf(<{iri}>)"
        case Complement(part):
            return f"ObjectComplementOf({in_functional_syntax(part)})"
        case Intersection(parts) | Union(parts):
            keyword = f"Object{type(concept).__name__}Of"
            return f"{keyword}({' '.join(sorted(map(in_functional_syntax, parts)))})"
        case Some(role, filler) | Only(role, filler):
            keyword = "ObjectSomeValuesFrom" if isinstance(concept, Some) else "ObjectAllValuesFrom"
            return f"{keyword}(<{role}> {in_functional_syntax(filler)})"
        case AtLeast(number, role, filler) | AtMost(number, role, filler):
            keyword = "ObjectMinCardinality" if isinstance(concept, AtLeast) else "ObjectMaxCardinality"
            return f"{keyword}({number} <{role}> {in_functional_syntax(filler)})"


def _operand(concept: Concept, name: Callable[[str], str]) -> str:
    text = in_description_logic(concept, name)
    return f"({text})" if isinstance(concept, Intersection | Union) else text


def _names_first(text: str) -> tuple[bool, str]:
    return not text[0].isalnum(), text
