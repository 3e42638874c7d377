"""Justifications by the reference reasoner: few axioms from which something follows (Kalyanpur et al., ISWC 2007)."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from typing import Final

from cfgplan.matching.concepts import TOP, Concept, conjunction, in_functional_syntax, negation
from cfgplan.matching.derivations import fewest
from cfgplan.matching.faults import InconsistentOntologyError, ReasonerError
from cfgplan.matching.ontology import Ontology
from cfgplan.matching.reference import Reference, first_answered
from cfgplan.matching.verdicts import countdown

EXPLANATION_PATIENCE_S: Final = 20.0
"""Seconds for leaving out axioms to see whether they are needed."""

_FEW: Final = 8
"""Up to this many axioms are minimised at once: to search the nearest ones first would be one more call."""
_IRI_IN_BRACKETS: Final = re.compile(r"<[^<>\s]+>")


def justification(offered: Concept, demanded: Concept, ontology: Ontology, reference: Reference) -> tuple[str, ...]:
    """Axioms from which offered ⊑ demanded follows, as few as are found in PATIENCE_S; all if none can be left out."""
    axioms = _but_declarations(ontology)
    question = conjunction((offered, negation(demanded)))
    first = _first(question, reference, lambda answer: answer is False)
    if len(axioms) > _FEW:
        nearest = _nearest_first(axioms, in_functional_syntax(offered) + in_functional_syntax(demanded))
        place = first(nearest)
        axioms = axioms if place is None else nearest[place]
    return tuple(fewest(axioms, first))


def clash(ontology: Ontology, reference: Reference) -> tuple[str, ...]:
    """Axioms that contradict each other, as few as are found in PATIENCE_S; () if the reference finds none in it."""
    axioms = _but_declarations(ontology)
    first = _first(TOP, reference, lambda answer: isinstance(answer, InconsistentOntologyError))
    return () if first([axioms]) is None else tuple(fewest(axioms, first))


def _but_declarations(ontology: Ontology) -> list[str]:
    return [axiom for axiom in sorted(ontology.axioms) if not axiom.startswith("Declaration(")]


def _first(
    question: Concept, reference: Reference, is_sought: Callable[[bool | ReasonerError], bool]
) -> Callable[[Iterable[Sequence[str]]], int | None]:
    """Return a function that returns the index of the first set of axioms with a sought answer to the question; None if
    there is none, if time runs out, or if the reasoner fails.
    """
    left_s = countdown(EXPLANATION_PATIENCE_S)

    def first(parts: Iterable[Sequence[str]]) -> int | None:
        with suppress(ReasonerError):
            return first_answered(reference, map(Ontology, parts), question, left_s, is_sought)
        return None

    return first


def _nearest_first(axioms: Sequence[str], tags: str) -> list[list[str]]:
    """Yield growing parts of the axioms: none, axioms that share a name with the tags, with these axioms, and so on."""
    parts: list[list[str]] = [[]]
    reached = set(_IRI_IN_BRACKETS.findall(tags))
    while True:
        connected = [axiom for axiom in axioms if not reached.isdisjoint(_IRI_IN_BRACKETS.findall(axiom))]
        if len(connected) == len(parts[-1]):
            return parts
        parts.append(connected)
        reached.update(name for axiom in connected for name in _IRI_IN_BRACKETS.findall(axiom))
