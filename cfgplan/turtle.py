"""Lines of Turtle that each written ontology has."""

from __future__ import annotations

import json


def heading(names: str) -> tuple[str, ...]:
    """Return the lines of the prefixes and of the ontology; the empty prefix is `names`, an IRI that ends in #."""
    return (
        f"@prefix : <{names}> .",
        "@prefix owl: <http://www.w3.org/2002/07/owl#> .",
        "@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .",
        "",
        f"<{names.rstrip('#')}> a owl:Ontology .",
        "",
    )


def class_line(word: str, above: str, label: str, iri: str | None = None) -> str:
    """A class below another one, with its label; it is named by the word, or by an IRI of its own."""
    name = f":{word}" if iri is None else f"<{iri}>"
    return f"{name} a owl:Class ; rdfs:subClassOf :{above} ; rdfs:label {json.dumps(label, ensure_ascii=False)} ."
