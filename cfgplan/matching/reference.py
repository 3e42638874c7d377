"""Questions to a reference reasoner: which tags are below which, what can exist, and which ontology it is told.

Names are written in ASCII, tags as classes `t:N`, so that the answer can't be garbled by a locale.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Final, Protocol

from cfgplan.matching.concepts import Concept, in_functional_syntax
from cfgplan.matching.functional import Signature
from cfgplan.matching.ontology import Ontology
from cfgplan.matching.taxonomy import Taxonomy


class Reference(Protocol):
    """A reasoner that is told a document in functional syntax, such as the module `hermit`."""

    def classify(self, document: str, *, time_limit_s: float | None = None) -> Taxonomy:
        """The classes by what they are subclasses of. Raises ReasonerError, ReasonerTimeoutError where time is over."""
        ...

    def satisfiable(
        self, document: str, classes: Sequence[str], *, time_limit_s: float | None = None
    ) -> dict[str, bool]:
        """Whether each class can have members, as far as it was found out in time. Raises ReasonerError."""
        ...


_NON_ASCII: Final = re.compile(r"[^\x00-\x7f]")


class Classification:
    """The order of some concepts under an ontology, as a reference reasoner sees it."""

    def __init__(self, taxonomy: Taxonomy, number: Mapping[Concept, int]) -> None:
        self._taxonomy = taxonomy
        self._number = number

    def is_unsatisfiable(self, concept: Concept) -> bool:
        """Whether nothing can be described by the concept."""
        return self._taxonomy.is_unsatisfiable(_tag_iri(self._number[concept]))

    def below(self, lower: Concept, uppers: Iterable[Concept]) -> set[Concept]:
        """Those of `uppers` that subsume `lower`."""
        name = _tag_iri(self._number[lower])
        return {upper for upper in uppers if self._taxonomy.subsumes(_tag_iri(self._number[upper]), name)}


def classify(
    reference: Reference, ontology: Ontology, concepts: Collection[Concept], time_limit_s: float | None
) -> Classification:
    """Ask a reasoner for the order of `concepts`. Raises what the reasoner raises."""
    number = {concept: index for index, concept in enumerate(dict.fromkeys(concepts))}
    document = _document(ontology, number, "EquivalentClasses")
    return Classification(reference.classify(document, time_limit_s=time_limit_s), number)


def satisfiable(
    reference: Reference, ontology: Ontology, concepts: Collection[Concept], time_limit_s: float | None
) -> dict[Concept, bool]:
    """Whether something can have each of `concepts`, as far as it was answered in time, in this order.

    Raises what the reasoner raises.
    """
    number = {concept: index for index, concept in enumerate(dict.fromkeys(concepts))}
    # A class that is only below its concept costs the questions about others nothing.
    document = _document(ontology, number, "SubClassOf")
    told = reference.satisfiable(document, list(map(_tag_iri, number.values())), time_limit_s=time_limit_s)
    return {concept: told[name] for concept, index in number.items() if (name := _tag_iri(index)) in told}


def _document(ontology: Ontology, number: Mapping[Concept, int], keyword: str) -> str:
    """The ontology, and each concept as a class that is equivalent to it or below it, as the keyword says."""
    tags = [f"{keyword}(<{_tag_iri(index)}> {in_functional_syntax(concept)})" for concept, index in number.items()]
    trees = [*ontology.trees.values()]
    signature = Signature(trees)
    declared = [
        *(f"Declaration(Class(<{iri}>))" for iri in sorted(signature.classes)),
        *(f"Declaration(ObjectProperty(<{iri}>))" for iri in sorted(signature.roles)),
        *(f"Declaration(NamedIndividual(<{iri}>))" for iri in sorted(signature.individuals)),
        *(f"Declaration(Class(<{_tag_iri(index)}>))" for index in number.values()),
    ]
    axioms = [axiom for axiom in sorted(ontology.told) if not axiom.startswith("Declaration(")]
    lines = ["Ontology(<t:ontology>", *declared, *axioms, *tags, ")", ""]
    return _NON_ASCII.sub(lambda found: f"_u{ord(found.group()):x}_", "\n".join(lines))


def _tag_iri(number: int) -> str:
    return f"t:{number}"
