"""Why an offered tag does or does not feed a demanded one."""

from __future__ import annotations

import re
import time
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Final

from cfgplan.domain import Similarity
from cfgplan.matching.concepts import Concept, Intersection, in_functional_syntax
from cfgplan.matching.derivations import derivation
from cfgplan.matching.faults import ReasonerError
from cfgplan.matching.matrix import match
from cfgplan.matching.ontology import Ontology
from cfgplan.matching.reference import Reference, classify, reference_named
from cfgplan.matching.syntax import parse_tag


@dataclass(frozen=True)
class MatchExplanation:
    """Whether `offered` feeds `demanded`, the steps that prove it, or the demanded conjuncts that it lacks.

    `undecided` are conjuncts that no reasoner has decided: with nothing `missing` beside them, it may match.
    """

    offered: str
    demanded: str
    matches: bool
    steps: tuple[str, ...] = ()
    missing: tuple[str, ...] = ()
    undecided: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()

    def lines(self) -> tuple[str, ...]:
        """The explanation as lines of text."""
        unknown = self.undecided and not self.missing
        verdict = "feeds" if self.matches else "may feed" if unknown else "does not feed"
        return (
            f"{self.offered}  {verdict}  {self.demanded}",
            *(f"  because {step}" for step in self.steps),
            *(f"  it lacks {part}" for part in self.missing),
            *(f"  nobody has decided yet whether it is {part}" for part in self.undecided),
            *(f"  note: {warning}" for warning in self.warnings),
        )


@dataclass(frozen=True)
class Nearest:
    """An offered tag that comes near to a demanded one, the conjuncts it lacks, and those that nobody has decided."""

    offered: str
    missing: tuple[str, ...]
    undecided: tuple[str, ...] = ()

    @property
    def verdict(self) -> str:
        """What it lacks, in words."""
        told = [f"lacks {', '.join(self.missing)}"] if self.missing else []
        if self.undecided:
            told.append(f"nobody has decided yet whether it is {', '.join(self.undecided)}")
        return "; ".join(told) or "would match"


def explain_match(
    offered_tag: str,
    demanded_tag: str,
    ontology: Ontology,
    *,
    reasoner: str = "auto",
    time_limit_s: float | None = None,
) -> MatchExplanation:
    """Why one tag does or does not feed another. Raises TagError and InputError."""
    demanded = parse_tag(demanded_tag, ontology)
    offered = parse_tag(offered_tag, ontology)
    parts = conjuncts(demanded, ontology)
    found = match([offered_tag], [demanded_tag, *parts], ontology, reasoner=reasoner, time_limit_s=time_limit_s)
    holds = found.similarity.holds
    if holds(offered_tag, demanded_tag):
        steps = derivation(offered, demanded, ontology)
        if steps is None:
            steps = _steps_of_the_reference(offered, demanded, ontology, reasoner)
        return MatchExplanation(offered_tag, demanded_tag, True, steps, warnings=found.warnings)
    undecided = tuple(part for part in parts if found.similarity.is_open(offered_tag, part))
    missing = tuple(part for part in parts if not holds(offered_tag, part) and part not in undecided)
    return MatchExplanation(
        offered_tag, demanded_tag, False, missing=missing, undecided=undecided, warnings=found.warnings
    )


def near_offers(
    demanded_tags: Collection[str],
    offered_tags: Collection[str],
    ontology: Ontology,
    *,
    reasoner: str = "auto",
    time_limit_s: float | None = None,
) -> dict[str, tuple[Nearest, ...]]:
    """For each of some demanded tags the offered ones that come near: those that lack the fewest conjuncts first.

    Among those that lack as many, fewer undecided conjuncts go first. What lacks all of them is not near. Raises as
    `match`.
    """
    parts = {tag: conjuncts(parse_tag(tag, ontology), ontology) for tag in demanded_tags}
    every = {part for of_tag in parts.values() for part in of_tag}
    similarity = match(offered_tags, every, ontology, reasoner=reasoner, time_limit_s=time_limit_s).similarity
    return {tag: _near(of_tag, offered_tags, similarity) for tag, of_tag in parts.items()}


def _near(parts: Sequence[str], offered_tags: Collection[str], similarity: Similarity) -> tuple[Nearest, ...]:
    near = []
    for tag in set(offered_tags):
        undecided = tuple(part for part in parts if similarity.is_open(tag, part))
        missing = tuple(part for part in parts if not similarity.holds(tag, part) and part not in undecided)
        if len(missing) < len(parts):
            near.append(Nearest(tag, missing, undecided))
    return tuple(sorted(near, key=lambda one: (len(one.missing), len(one.undecided), one.offered)))


def _steps_of_the_reference(offered: Concept, demanded: Concept, ontology: Ontology, reasoner: str) -> tuple[str, ...]:
    name, reference = reference_named(reasoner)
    axioms = () if reference is None else justification(offered, demanded, ontology, reference)
    if not axioms:
        return (f"it follows from the tags alone, as {name} finds",)
    return (f"it follows from what is listed next, as {name} finds", *map(ontology.shortened, axioms))


def conjuncts(concept: Concept, ontology: Ontology) -> list[str]:
    """The conjuncts of a concept as tags, in alphabetical order; the concept itself if it is no conjunction."""
    return sorted(map(ontology.render, concept.parts if isinstance(concept, Intersection) else (concept,)))


EXPLANATION_PATIENCE_S: Final = 20.0
"""Seconds for leaving out axioms to see whether they are needed; each try is a call of the reasoner."""

_IRI_IN_BRACKETS: Final = re.compile(r"<[^<>\s]+>")


def justification(offered: Concept, demanded: Concept, ontology: Ontology, reference: Reference) -> tuple[str, ...]:
    """Axioms from which offered ⊑ demanded follows, as few as are found in PATIENCE_S; all if none can be left out."""
    deadline = time.monotonic() + EXPLANATION_PATIENCE_S
    axioms = [axiom for axiom in sorted(ontology.axioms) if not axiom.startswith("Declaration(")]

    def follows(some: Sequence[str]) -> bool:
        left_s = deadline - time.monotonic()
        if left_s <= 0:
            return False
        try:
            _, below = classify(reference, Ontology(some), [offered], [demanded], left_s)
        except ReasonerError:
            return False
        return bool(below[demanded])

    for connected in _nearest_first(axioms, in_functional_syntax(offered) + in_functional_syntax(demanded)):
        if follows(connected):
            axioms = connected
            break
    size = max(1, len(axioms) // 2)
    while axioms:
        start = 0
        while start < len(axioms):
            rest = axioms[:start] + axioms[start + size :]
            if follows(rest):
                axioms = rest
            else:
                start += size
        if size == 1:
            break
        size //= 2
    return tuple(axioms)


def _nearest_first(axioms: Sequence[str], tags: str) -> list[list[str]]:
    """Growing parts of the axioms: none, those that share a name with the tags, with those, and so on."""
    parts: list[list[str]] = [[]]
    reached = set(_IRI_IN_BRACKETS.findall(tags))
    while True:
        connected = [axiom for axiom in axioms if not reached.isdisjoint(_IRI_IN_BRACKETS.findall(axiom))]
        if len(connected) == len(parts[-1]):
            return parts
        parts.append(connected)
        reached.update(name for axiom in connected for name in _IRI_IN_BRACKETS.findall(axiom))
