"""Questions to a reference reasoner: which tags are below which, and which ontology it is told.

Names are written in ASCII, tags as classes `t:N`, so that the answer can't be garbled by a locale.
Literals of datatypes that OWL 2 lacks, such as dates, are told as texts.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Mapping
from typing import Final, TypeAlias

from cfgplan.matching.concepts import Concept, in_functional_syntax
from cfgplan.matching.functional import Signature
from cfgplan.matching.ontology import Ontology
from cfgplan.matching.taxonomy import Taxonomy

Classifier: TypeAlias = Callable[..., Taxonomy]
"""A reasoner: `classify(document, *, time_limit_s) -> Taxonomy`."""

_KNOWN_DATATYPES: Final = frozenset(
    (
        *("string", "normalizedString", "token", "language", "Name", "NCName", "NMTOKEN", "boolean", "anyURI"),
        *("decimal", "integer", "nonNegativeInteger", "nonPositiveInteger", "positiveInteger", "negativeInteger"),
        *("long", "int", "short", "byte", "unsignedLong", "unsignedInt", "unsignedShort", "unsignedByte"),
        *("double", "float", "hexBinary", "base64Binary", "dateTime", "dateTimeStamp"),
    )
)
"""The XML Schema datatypes of OWL 2; a reasoner may refuse an ontology for any other."""
_XSD: Final = re.compile(r"<http://www\.w3\.org/2001/XMLSchema#(\w+)>")
_TYPED: Final = re.compile(r'"((?:[^"\\]|\\.)*)"\^\^<http://www\.w3\.org/2001/XMLSchema#(\w+)>')
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
    classifier: Classifier, ontology: Ontology, concepts: Collection[Concept], time_limit_s: float | None
) -> Classification:
    """Ask a reasoner for the order of `concepts`. Raises what the reasoner raises."""
    number = {concept: index for index, concept in enumerate(dict.fromkeys(concepts))}
    return Classification(classifier(_document(ontology, number), time_limit_s=time_limit_s), number)


def _document(ontology: Ontology, number: Mapping[Concept, int]) -> str:
    tags = [
        f"EquivalentClasses(<{_tag_iri(index)}> {in_functional_syntax(concept)})" for concept, index in number.items()
    ]
    trees = [*ontology.trees.values()]
    signature = Signature(trees)
    declared = [
        *(f"Declaration(Class(<{iri}>))" for iri in sorted(signature.classes)),
        *(f"Declaration(ObjectProperty(<{iri}>))" for iri in sorted(signature.roles)),
        *(f"Declaration(NamedIndividual(<{iri}>))" for iri in sorted(signature.individuals)),
        *(f"Declaration(Class(<{_tag_iri(index)}>))" for index in number.values()),
    ]
    axioms = [
        told
        for axiom in sorted(ontology.axioms)
        if not axiom.startswith("Declaration(") and (told := _with_known_datatypes(axiom))
    ]
    lines = ["Ontology(<t:ontology>", *declared, *axioms, *tags, ")", ""]
    return _NON_ASCII.sub(lambda found: f"_u{ord(found.group()):x}_", "\n".join(lines))


def _with_known_datatypes(axiom: str) -> str:
    """The axiom with literals of other datatypes as texts; nothing if it restricts literals to such a datatype."""
    if '"' in axiom:
        axiom = _TYPED.sub(_text_of, axiom)
    if axiom.startswith("Data") or "(Data" in axiom:
        return "" if any(name not in _KNOWN_DATATYPES for name in _XSD.findall(axiom)) else axiom
    return axiom


def _text_of(literal: re.Match[str]) -> str:
    return literal.group() if literal[2] in _KNOWN_DATATYPES else f'"{literal[1]} ({literal[2]})"'


def _tag_iri(number: int) -> str:
    return f"t:{number}"
