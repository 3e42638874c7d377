"""The axioms that a match rests on where only a reference reasoner finds it: it does not without any one of them."""

from __future__ import annotations

import re
import time
from collections.abc import Sequence
from typing import Final

from cfgplan.matching.concepts import Concept, in_functional_syntax
from cfgplan.matching.faults import ReasonerError
from cfgplan.matching.ontology import Ontology
from cfgplan.matching.reference import Reference, classify

PATIENCE_S: Final = 20.0
"""How long axioms are left out to see whether they are needed; each try is a call of the reasoner."""

_NAME: Final = re.compile(r"<[^<>\s]+>")


def justification(offered: Concept, demanded: Concept, ontology: Ontology, reference: Reference) -> tuple[str, ...]:
    """Axioms from which offered ⊑ demanded follows, as few as are found in PATIENCE_S; all if none can be left out."""
    deadline = time.monotonic() + PATIENCE_S
    axioms = [axiom for axiom in sorted(ontology.axioms) if not axiom.startswith("Declaration(")]

    def follows(some: Sequence[str]) -> bool:
        left_s = deadline - time.monotonic()
        if left_s <= 0:
            return False
        try:
            answer = classify(reference, Ontology(some), [offered], [demanded], left_s)
        except ReasonerError:
            return False
        return bool(answer.below(offered, [demanded]))

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
    reached = set(_NAME.findall(tags))
    while True:
        connected = [axiom for axiom in axioms if not reached.isdisjoint(_NAME.findall(axiom))]
        if len(connected) == len(parts[-1]):
            return parts
        parts.append(connected)
        reached.update(name for axiom in connected for name in _NAME.findall(axiom))
