"""Why an offered tag does or does not feed a demanded one."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Final

from cfgplan.arguments import Seconds, checked
from cfgplan.domain import Similarity
from cfgplan.errors import close_names
from cfgplan.matching.concepts import BOTTOM, Concept, Intersection
from cfgplan.matching.derivations import Derivation, derivation, is_minimal
from cfgplan.matching.justifications import justification
from cfgplan.matching.matrix import match
from cfgplan.matching.ontology import Ontology
from cfgplan.matching.reference import reference_named
from cfgplan.matching.syntax import parse_tag


@dataclass(frozen=True)
class MatchExplanation:
    """Whether `offered` feeds `demanded`, the steps that prove it, or the demanded conjuncts that it lacks.

    `undecided` are conjuncts that no reasoner has decided: with nothing `missing` beside them, it may match. If
    `is_impossible`, nothing can have the offered tag, and the steps prove that. `axioms` are those of the steps in
    functional syntax: the match follows from all of them together, but not without any one of them.
    """

    offered: str
    demanded: str
    matches: bool
    steps: tuple[str, ...] = ()
    missing: tuple[str, ...] = ()
    undecided: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    is_impossible: bool = False
    axioms: tuple[str, ...] = ()

    def lines(self) -> tuple[str, ...]:
        """The explanation as lines of text."""
        unknown = self.undecided and not self.missing
        verdict = "feeds" if self.matches else "may feed" if unknown else "does not feed"
        return (
            f"{self.offered}  {verdict}  {self.demanded}",
            *((f"  nothing can be {self.offered}, so that no unit may give it",) if self.is_impossible else ()),
            *(f"  because {step}" for step in self.steps),
            *(f"  it lacks {part}" for part in self.missing),
            *(f"  not decided yet whether it is {part}" for part in self.undecided),
            *(f"  note: {warning}" for warning in self.warnings),
        )


@dataclass(frozen=True)
class Nearest:
    """An offered tag that comes near to a demanded one, the conjuncts it lacks, and those that are not decided.

    One that is near `by_name` lacks them all, and is only spelt much the same.
    """

    offered: str
    missing: tuple[str, ...]
    undecided: tuple[str, ...] = ()
    by_name: bool = False

    @property
    def verdict(self) -> str:
        """The missing and the undecided conjuncts, in words."""
        told = [f"lacks {', '.join(self.missing)}"] if self.missing else []
        if self.undecided:
            told.append(f"not decided yet whether it is {', '.join(self.undecided)}")
        return "; ".join(told) or "would match"


@checked
def explain_match(
    offered_tag: str,
    demanded_tag: str,
    ontology: Ontology,
    *,
    reasoner: str = "auto",
    time_limit_s: Seconds | None = None,
) -> MatchExplanation:
    """Why one tag does or does not feed another. Raises TagError and InputError."""
    demanded = parse_tag(demanded_tag, ontology)
    offered = parse_tag(offered_tag, ontology)
    parts = conjuncts(demanded, ontology)
    found = match([offered_tag], [demanded_tag, *parts], ontology, reasoner=reasoner, time_limit_s=time_limit_s)
    holds = found.similarity.holds
    if holds(offered_tag, demanded_tag):
        reason = _reason(offered, demanded, ontology, reasoner)
        return MatchExplanation(
            offered_tag, demanded_tag, True, reason.steps, warnings=found.warnings, axioms=reason.axioms
        )
    if offered_tag in found.impossible:
        reason = _reason(offered, BOTTOM, ontology, reasoner)
        return MatchExplanation(
            offered_tag,
            demanded_tag,
            False,
            reason.steps,
            warnings=found.other_warnings,
            is_impossible=True,
            axioms=reason.axioms,
        )
    undecided = tuple(part for part in parts if found.similarity.is_open(offered_tag, part))
    missing = tuple(part for part in parts if not holds(offered_tag, part) and part not in undecided)
    return MatchExplanation(
        offered_tag, demanded_tag, False, missing=missing, undecided=undecided, warnings=found.warnings
    )


@checked
def near_offers(
    demanded_tags: Collection[str],
    offered_tags: Collection[str],
    ontology: Ontology,
    *,
    reasoner: str = "auto",
    time_limit_s: Seconds | None = None,
) -> dict[str, tuple[Nearest, ...]]:
    """Return the offered tags nearest to each demanded tag: fewest missing conjuncts first, then fewest undecided ones.

    A tag that lacks all conjuncts is returned only if no other is near and its spelling is similar. Raises as `match`.
    """
    if not demanded_tags:
        return {}
    parts = {tag: conjuncts(parse_tag(tag, ontology), ontology) for tag in demanded_tags}
    every = {part for of_tag in parts.values() for part in of_tag}
    similarity = match(offered_tags, every, ontology, reasoner=reasoner, time_limit_s=time_limit_s).similarity
    return {
        tag: _near(of_tag, offered_tags, similarity) or _spelt_alike(tag, of_tag, offered_tags)
        for tag, of_tag in parts.items()
    }


def _near(parts: Sequence[str], offered_tags: Collection[str], similarity: Similarity) -> tuple[Nearest, ...]:
    near = []
    for tag in set(offered_tags):
        undecided = tuple(part for part in parts if similarity.is_open(tag, part))
        missing = tuple(part for part in parts if not similarity.holds(tag, part) and part not in undecided)
        if len(missing) < len(parts):
            near.append(Nearest(tag, missing, undecided))
    return tuple(sorted(near, key=lambda one: (len(one.missing), len(one.undecided), one.offered)))


def _spelt_alike(tag: str, parts: Sequence[str], offered_tags: Collection[str]) -> tuple[Nearest, ...]:
    return tuple(
        Nearest(offered, tuple(parts), by_name=True) for offered in close_names(tag, offered_tags, _MOST_SPELT_ALIKE)
    )


def _reason(offered: Concept, demanded: Concept, ontology: Ontology, reasoner: str) -> Derivation:
    """Why offered ⊑ demanded, as the fast engine derives it or as the reference finds it."""
    derived = derivation(offered, demanded, ontology)
    name, reference = reference_named(reasoner)
    if derived is not None and (reference is None or is_minimal(derived, offered, demanded, ontology)):
        return derived
    known = ontology if derived is None else Ontology(derived.axioms)
    axioms = () if reference is None else justification(offered, demanded, known, reference)
    if derived is not None and len(axioms) == len(derived.axioms):
        return derived
    if not axioms:
        return Derivation((f"it follows from the tags alone, as {name} finds",), ())
    said = f"it follows from the axioms listed next, as {name} finds"
    return Derivation((said, *map(ontology.shortened, axioms)), axioms)


def conjuncts(concept: Concept, ontology: Ontology) -> list[str]:
    """The conjuncts of a concept as tags, in alphabetical order; the concept itself if it is no conjunction."""
    return sorted(map(ontology.render, concept.parts if isinstance(concept, Intersection) else (concept,)))


_MOST_SPELT_ALIKE: Final = 3
