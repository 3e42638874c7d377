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
        self,
        document: str,
        classes: Sequence[str],
        *,
        time_limit_s: float | None = None,
        patience_s: float | None = None,
    ) -> dict[str, bool]:
        """Whether each class can have members, until an answer takes longer than the patience. Raises ReasonerError."""
        ...


_NON_ASCII: Final = re.compile(r"[^\x00-\x7f]")


class Classification:
    """Which offered concepts are below which demanded ones, as a reference reasoner sees it."""

    def __init__(self, taxonomy: Taxonomy, number: Mapping[Concept, int]) -> None:
        self._taxonomy = taxonomy
        self._number = number

    def is_unsatisfiable(self, concept: Concept) -> bool:
        """Whether nothing can have an offered concept."""
        return self._taxonomy.is_unsatisfiable(_tag_iri(self._number[concept]))

    def below(self, lower: Concept, uppers: Iterable[Concept]) -> set[Concept]:
        """Those of the demanded `uppers` that subsume the offered `lower`."""
        name = _tag_iri(self._number[lower])
        return {upper for upper in uppers if self._taxonomy.subsumes(_tag_iri(self._number[upper]), name)}


def classify(
    reference: Reference,
    ontology: Ontology,
    offered: Collection[Concept],
    demanded: Collection[Concept],
    time_limit_s: float | None,
) -> Classification:
    """Ask a reasoner which of `offered` are below which of `demanded`. Raises what the reasoner raises."""
    number = {concept: index for index, concept in enumerate(dict.fromkeys((*offered, *demanded)))}
    document = _document(ontology, number, offered, demanded)
    return Classification(reference.classify(document, time_limit_s=time_limit_s), number)


def satisfiable(
    reference: Reference,
    ontology: Ontology,
    concepts: Collection[Concept],
    time_limit_s: float | None,
    patience_s: float | None = None,
) -> dict[Concept, bool]:
    """Whether something can have each of `concepts`, asked in this order, as far as it was answered in time.

    Raises what the reasoner raises.
    """
    number = {concept: index for index, concept in enumerate(dict.fromkeys(concepts))}
    document = _document(ontology, number, number, ())
    names = [*map(_tag_iri, number.values())]
    told = reference.satisfiable(document, names, time_limit_s=time_limit_s, patience_s=patience_s)
    return {concept: told[name] for concept, index in number.items() if (name := _tag_iri(index)) in told}


def _document(
    ontology: Ontology, number: Mapping[Concept, int], offered: Iterable[Concept], demanded: Iterable[Concept]
) -> str:
    """The ontology, and a class for each concept: below it if it is offered, above it if it is demanded.

    One class is below another exactly if the concepts are, and it makes no question about others harder.
    """
    iri = {concept: f"<{_tag_iri(index)}>" for concept, index in number.items()}
    tags = [f"SubClassOf({iri[concept]} {in_functional_syntax(concept)})" for concept in dict.fromkeys(offered)]
    tags += [f"SubClassOf({in_functional_syntax(concept)} {iri[concept]})" for concept in dict.fromkeys(demanded)]
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
