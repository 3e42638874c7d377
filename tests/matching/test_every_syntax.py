"""Every form of restriction, of a property and of its inverse, says the same in every syntax of OWL."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Final
from xml.sax.saxutils import quoteattr

import pytest

from cfgplan.matching import load_ontology
from cfgplan.matching.functional import Tree, parse

HEAD: Final = """@prefix : <http://x#> . @prefix owl: <http://www.w3.org/2002/07/owl#> .
@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> . @prefix xsd: <http://www.w3.org/2001/XMLSchema#> .
<http://x> a owl:Ontology . :A a owl:Class . :B a owl:Class . :C a owl:Class . :r a owl:ObjectProperty .
:s a owl:ObjectProperty . :d a owl:DatatypeProperty . :i a owl:NamedIndividual . :j a owl:NamedIndividual .
"""
DECLARED: Final = (
    *("Declaration(Class(<A>))", "Declaration(Class(<B>))", "Declaration(Class(<C>))"),
    *("Declaration(ObjectProperty(<r>))", "Declaration(ObjectProperty(<s>))", "Declaration(DataProperty(<d>))"),
    *("Declaration(NamedIndividual(<i>))", "Declaration(NamedIndividual(<j>))"),
)
MANCHESTER_HEAD: Final = """Prefix: : <http://x#>
Prefix: xsd: <http://www.w3.org/2001/XMLSchema#>
Ontology: <http://x>
Class: :B
Class: :C
ObjectProperty: :r
ObjectProperty: :s
DataProperty: :d
Individual: :i
Individual: :j
Class: :A
"""
N: Final = "^^xsd:nonNegativeInteger"
OF_PROPERTIES: Final = {
    "some": ("ObjectSomeValuesFrom({p} <B>)", "owl:someValuesFrom :B", "{p} some :B"),
    "some of an expression": (
        "ObjectSomeValuesFrom({p} ObjectUnionOf(<B> <C>))",
        "owl:someValuesFrom [ a owl:Class ; owl:unionOf ( :B :C ) ]",
        "{p} some (:B or :C)",
    ),
    "only": ("ObjectAllValuesFrom({p} <B>)", "owl:allValuesFrom :B", "{p} only :B"),
    "value": ("ObjectHasValue({p} <i>)", "owl:hasValue :i", "{p} value :i"),
    "self": ("ObjectHasSelf({p})", "owl:hasSelf true", "{p} Self"),
    "min": ("ObjectMinCardinality(2 {p})", f'owl:minCardinality "2"{N}', "{p} min 2"),
    "max": ("ObjectMaxCardinality(2 {p})", f'owl:maxCardinality "2"{N}', "{p} max 2"),
    "exactly": ("ObjectExactCardinality(1 {p})", f'owl:cardinality "1"{N}', "{p} exactly 1"),
    "min of a class": (
        "ObjectMinCardinality(2 {p} <B>)",
        f'owl:minQualifiedCardinality "2"{N} ; owl:onClass :B',
        "{p} min 2 :B",
    ),
    "max of a class": (
        "ObjectMaxCardinality(0 {p} <B>)",
        f'owl:maxQualifiedCardinality "0"{N} ; owl:onClass :B',
        "{p} max 0 :B",
    ),
    "exactly of a class": (
        "ObjectExactCardinality(1 {p} <B>)",
        f'owl:qualifiedCardinality "1"{N} ; owl:onClass :B',
        "{p} exactly 1 :B",
    ),
    "exactly of an expression": (
        "ObjectExactCardinality(1 {p} ObjectComplementOf(<B>))",
        f'owl:qualifiedCardinality "1"{N} ; owl:onClass [ a owl:Class ; owl:complementOf :B ]',
        "{p} exactly 1 (not :B)",
    ),
    "some within some": (
        "ObjectSomeValuesFrom({p} ObjectSomeValuesFrom({p} <B>))",
        "owl:someValuesFrom [ a owl:Restriction ; owl:onProperty {t} ; owl:someValuesFrom :B ]",
        "{p} some ({p} some :B)",
    ),
}
"""Class expressions in functional syntax, the rest of a restriction in Turtle, and Manchester syntax; {p} is the
property.
"""
INTEGER: Final = "<http://www.w3.org/2001/XMLSchema#integer>"
OF_DATA: Final = {
    "data some": (f"DataSomeValuesFrom(<d> {INTEGER})", "owl:someValuesFrom xsd:integer", ":d some xsd:integer"),
    "data only": (f"DataAllValuesFrom(<d> {INTEGER})", "owl:allValuesFrom xsd:integer", ":d only xsd:integer"),
    "data value": (f'DataHasValue(<d> "1"^^{INTEGER})', 'owl:hasValue "1"^^xsd:integer', ':d value "1"^^xsd:integer'),
    "data min": (
        f"DataMinCardinality(2 <d> {INTEGER})",
        f'owl:minQualifiedCardinality "2"{N} ; owl:onDataRange xsd:integer',
        ":d min 2 xsd:integer",
    ),
    "data max": (
        f"DataMaxCardinality(2 <d> {INTEGER})",
        f'owl:maxQualifiedCardinality "2"{N} ; owl:onDataRange xsd:integer',
        ":d max 2 xsd:integer",
    ),
    "data exactly": (
        f"DataExactCardinality(2 <d> {INTEGER})",
        f'owl:qualifiedCardinality "2"{N} ; owl:onDataRange xsd:integer',
        ":d exactly 2 xsd:integer",
    ),
}
OF_AXIOMS: Final = {
    "domain": ("ObjectPropertyDomain({p} <A>)", "{t} rdfs:domain :A ."),
    "range": ("ObjectPropertyRange({p} <A>)", "{t} rdfs:range :A ."),
    "functional": ("FunctionalObjectProperty({p})", "{t} a owl:FunctionalProperty ."),
    "inverse functional": ("InverseFunctionalObjectProperty({p})", "{t} a owl:InverseFunctionalProperty ."),
    "transitive": ("TransitiveObjectProperty({p})", "{t} a owl:TransitiveProperty ."),
    "symmetric": ("SymmetricObjectProperty({p})", "{t} a owl:SymmetricProperty ."),
    "asymmetric": ("AsymmetricObjectProperty({p})", "{t} a owl:AsymmetricProperty ."),
    "reflexive": ("ReflexiveObjectProperty({p})", "{t} a owl:ReflexiveProperty ."),
    "irreflexive": ("IrreflexiveObjectProperty({p})", "{t} a owl:IrreflexiveProperty ."),
    "below": ("SubObjectPropertyOf({p} <s>)", "{t} rdfs:subPropertyOf :s ."),
    "above": ("SubObjectPropertyOf(<s> {p})", ":s rdfs:subPropertyOf {t} ."),
    "chain": ("SubObjectPropertyOf(ObjectPropertyChain({p} <s>) <s>)", ":s owl:propertyChainAxiom ( {t} :s ) ."),
    "equivalent": ("EquivalentObjectProperties({p} <s>)", "{t} owl:equivalentProperty :s ."),
    "disjoint": ("DisjointObjectProperties({p} <s>)", "{t} owl:propertyDisjointWith :s ."),
}
PROPERTIES: Final = {"a property": ("<r>", ":r"), "an inverse": ("ObjectInverseOf(<r>)", "[ owl:inverseOf :r ]")}
MANCHESTER: Final = {"<r>": ":r", "ObjectInverseOf(<r>)": "inverse :r"}


def turtle(body: str) -> dict[str, str]:
    """The same triples in each syntax of RDF."""
    from pyoxigraph import RdfFormat, parse, serialize

    text = HEAD + body
    written = {"x.ttl": text}
    triples = [quad.triple for quad in parse(input=text.encode(), format=RdfFormat.TURTLE)]
    for name, form in (("x.owl", RdfFormat.RDF_XML), ("x.jsonld", RdfFormat.JSON_LD), ("x.nt", RdfFormat.N_TRIPLES)):
        data = serialize(triples, format=form)
        assert data is not None
        written[name] = data.decode()
    return written


def functional(axiom: str) -> str:
    axioms = "\n".join(map(full, (*DECLARED, axiom)))
    return f"Prefix(:=<http://x#>)\nOntology(<http://x>\n{axioms}\n)"


def full(axiom: str) -> str:
    for name in "ABCrsdij":
        axiom = axiom.replace(f"<{name}>", f"<http://x#{name}>")
    return axiom


def owl_xml(axiom: str) -> str:
    axioms = "".join(element(parse(full(one))) for one in (*DECLARED, axiom))
    return f'<Ontology xmlns="http://www.w3.org/2002/07/owl#" ontologyIRI="http://x">{axioms}</Ontology>'


KINDS: Final = {**dict.fromkeys("ABC", "Class"), **dict.fromkeys("rs", "ObjectProperty"), "d": "DataProperty"}


def element(tree: Tree) -> str:
    """A tree of functional syntax as OWL/XML has it: an element for each keyword, numbers as attributes."""
    if isinstance(tree, str):
        if tree.startswith('"'):
            text, _, datatype = tree.rpartition("^^")
            return f"<Literal datatypeIRI={quoteattr(datatype[1:-1])}>{text[1:-1]}</Literal>"
        name = tree.rpartition("#")[2]
        kind = "Datatype" if "XMLSchema" in tree else KINDS.get(name, "NamedIndividual")
        return f"<{kind} IRI={quoteattr(tree)}/>"
    keyword, *parts = tree
    if keyword in ("Class", "ObjectProperty", "DataProperty", "NamedIndividual"):
        return element(parts[0])
    number = f" cardinality={quoteattr(str(parts.pop(0)))}" if "Cardinality" in str(keyword) else ""
    return f"<{keyword}{number}>{''.join(map(element, parts))}</{keyword}>"


def read(folder: Path, name: str, text: str) -> tuple[frozenset[str], dict[str, str]]:
    (folder / name).write_text(text)
    ontology = load_ontology([folder / name])
    return frozenset(a for a in ontology.axioms if not a.startswith("Declaration(")), dict(ontology.dropped)


def check(folder: Path, axiom: str, written: dict[str, str]) -> None:
    for name, text in written.items():
        assert read(folder, name, text) == ({full(axiom)}, {}), name


@pytest.mark.parametrize("form", [*OF_PROPERTIES, *OF_DATA])
@pytest.mark.parametrize("kind", PROPERTIES)
@pytest.mark.parametrize("side", ["above", "below"])
def test_a_restriction_says_the_same_in_every_syntax(form: str, kind: str, side: str, tmp_path: Path) -> None:
    data = form in OF_DATA
    meant, rest, manchester = (OF_DATA if data else OF_PROPERTIES)[form]
    property_meant, property_written = ("<d>", ":d") if data else PROPERTIES[kind]
    meant = meant.replace("{p}", property_meant)
    manchester = manchester.replace("{p}", MANCHESTER.get(property_meant, ""))
    node = f"[ a owl:Restriction ; owl:onProperty {property_written} ; {rest.replace('{t}', property_written)} ]"
    if side == "above":
        axiom, body, frame = f"SubClassOf(<A> {meant})", f":A rdfs:subClassOf {node} .", f"  SubClassOf: {manchester}\n"
        written = {**turtle(body), "x.omn": MANCHESTER_HEAD + frame}
    else:
        axiom, body = f"SubClassOf({meant} <A>)", f"{node} rdfs:subClassOf :A ."
        written = turtle(body)
    check(tmp_path, axiom, {**written, "x.ofn": functional(axiom), "x.owx": owl_xml(axiom)})


@pytest.mark.parametrize("form", OF_AXIOMS)
@pytest.mark.parametrize("kind", PROPERTIES)
def test_an_axiom_about_a_property_says_the_same_in_every_syntax(form: str, kind: str, tmp_path: Path) -> None:
    (meant, body), (property_meant, property_written) = OF_AXIOMS[form], PROPERTIES[kind]
    axiom = meant.replace("{p}", property_meant)
    written = turtle(body.replace("{t}", property_written))
    check(tmp_path, axiom, {**written, "x.ofn": functional(axiom), "x.owx": owl_xml(axiom)})


ASSERTED: Final = {
    "complement": ("ObjectComplementOf(<B>)", "[ a owl:Class ; owl:complementOf :B ]"),
    "union": ("ObjectUnionOf(<A> <B>)", "[ a owl:Class ; owl:unionOf ( :A :B ) ]"),
    "restriction": (
        "ObjectSomeValuesFrom(<r> <B>)",
        "[ a owl:Restriction ; owl:onProperty :r ; owl:someValuesFrom :B ]",
    ),
}


@pytest.mark.parametrize("form", ASSERTED)
@pytest.mark.parametrize("has_individuals", [True, False])
def test_an_individual_of_an_anonymous_class_says_the_same_in_every_syntax(
    form: str, has_individuals: bool, tmp_path: Path
) -> None:
    meant, node = ASSERTED[form]
    subject = ":i" if has_individuals else "[ a :C ] . :i"
    axiom = f"ClassAssertion({meant} <i>)"
    written = turtle(f"{subject} a {node} .")
    for name, text in written.items():
        axioms, dropped = read(tmp_path, name, text)
        assert full(axiom) in axioms, name
        assert not dropped, name
    check(tmp_path, axiom, {"x.ofn": functional(axiom), "x.owx": owl_xml(axiom)})


def test_json_ld_of_rdflib_is_read_whose_types_are_nodes(tmp_path: Path) -> None:
    owl = "http://www.w3.org/2002/07/owl#"
    nodes = [
        {"@id": "http://x#i", "@type": [f"{owl}NamedIndividual", {"@id": "_:n1"}]},
        {
            "@id": "http://x#j",
            "@type": {"@id": "_:n2", "@type": [f"{owl}Class"], f"{owl}complementOf": [{"@id": "http://x#A"}]},
        },
        {"@id": "_:n1", "@type": [f"{owl}Class"], f"{owl}complementOf": [{"@id": "http://x#B"}]},
        {"@id": "http://x#B", "@type": [f"{owl}Class"]},
        {"@id": "http://x#A", "@type": [f"{owl}Class"]},
    ]
    meant = {f"ClassAssertion(ObjectComplementOf(<{c}>) <{i}>)" for c, i in (("B", "i"), ("A", "j"))}
    assert read(tmp_path, "x.jsonld", json.dumps(nodes)) == (set(map(full, meant)), {})
