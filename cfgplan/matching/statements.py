"""The three kinds of statement that the fast engine knows."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

from cfgplan.matching.concepts import BOTTOM, TOP, Complement, Concept, Only, Union, conjunction
from cfgplan.matching.expressions import OutsideError, is_left_hand, right_hand_parts


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


def include_all(pairs: Iterable[tuple[Concept, Concept]], axiom: str, result: Translation) -> None:
    """Add every sub ⊑ sup, and then raise the first OutsideError there was."""
    reasons: list[OutsideError] = []
    for sub, sup in pairs:
        try:
            include(sub, sup, axiom, result)
        except OutsideError as reason:
            reasons.append(reason)
    if reasons:
        raise reasons[0]


def include(sub: Concept, sup: Concept, axiom: str, result: Translation) -> None:
    """Add sub ⊑ sup as far as it is inside the fragment. Raises OutsideError at the end if something is not."""
    if sup == TOP or sub == BOTTOM:
        return
    if isinstance(sub, Union):
        for part in sub.parts:
            include(part, sup, axiom, result)
        return
    if sub == TOP and isinstance(sup, Only):
        add_range(sup.role, sup.filler, axiom, result)
        return
    if not is_left_hand(sub):
        raise OutsideError("its left-hand side is outside the fast fragment")
    reasons: list[str] = []
    for part in right_hand_parts(sup, reasons):
        if isinstance(part, Complement):
            result.inclusions.append(Inclusion(conjunction((sub, part.concept)), BOTTOM, axiom))
        else:
            result.inclusions.append(Inclusion(sub, part, axiom))
    if reasons:
        raise OutsideError(reasons[0])


def add_range(role: str, concept: Concept, axiom: str, result: Translation) -> None:
    """Add a range as far as it is inside the fragment. Raises OutsideError at the end if something is not."""
    reasons: list[str] = []
    for part in right_hand_parts(concept, reasons):
        if isinstance(part, Complement):
            reasons.append("a complement as a range is outside the fast fragment")
        else:
            result.ranges.append(Range(role, part, axiom))
    if reasons:
        raise OutsideError(reasons[0])
