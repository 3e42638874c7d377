"""Justifications by the reference reasoner: few axioms from which something follows (Kalyanpur et al., ISWC 2007)."""

from __future__ import annotations

import re
import time
from collections.abc import Sequence
from typing import Final

from cfgplan.matching.concepts import TOP, Concept, conjunction, in_functional_syntax, negation
from cfgplan.matching.derivations import fewest
from cfgplan.matching.faults import InconsistentOntologyError, ReasonerError
from cfgplan.matching.ontology import Ontology
from cfgplan.matching.reference import Reference, satisfiable

EXPLANATION_PATIENCE_S: Final = 20.0
"""Seconds for leaving out axioms to see whether they are needed; each try is a call of the reasoner."""

_IRI_IN_BRACKETS: Final = re.compile(r"<[^<>\s]+>")


def justification(offered: Concept, demanded: Concept, ontology: Ontology, reference: Reference) -> tuple[str, ...]:
    """Axioms from which offered ⊑ demanded follows, as few as are found in PATIENCE_S; all if none can be left out."""
    deadline = time.monotonic() + EXPLANATION_PATIENCE_S
    axioms = [axiom for axiom in sorted(ontology.axioms) if not axiom.startswith("Declaration(")]

    question = conjunction((offered, negation(demanded)))

    def follows(some: Sequence[str]) -> bool:
        left_s = deadline - time.monotonic()
        if left_s <= 0:
            return False
        try:
            return satisfiable(reference, Ontology(some), [question], left_s).get(question) is False
        except ReasonerError:
            return False

    for connected in _nearest_first(axioms, in_functional_syntax(offered) + in_functional_syntax(demanded)):
        if follows(connected):
            axioms = connected
            break
    return tuple(fewest(axioms, follows))


def clash(ontology: Ontology, reference: Reference) -> tuple[str, ...]:
    """Axioms that contradict each other, as few as are found in PATIENCE_S; () if the reference finds none in it."""
    deadline = time.monotonic() + EXPLANATION_PATIENCE_S

    def contradicts(some: Sequence[str]) -> bool:
        left_s = deadline - time.monotonic()
        try:
            if left_s > 0:
                satisfiable(reference, Ontology(some), [TOP], left_s)
        except InconsistentOntologyError:
            return True
        except ReasonerError:
            return False
        return False

    axioms = [axiom for axiom in sorted(ontology.axioms) if not axiom.startswith("Declaration(")]
    return tuple(fewest(axioms, contradicts)) if contradicts(axioms) else ()


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
