"""Ontologies of which a triple was damaged: what the damage does not reach is read, and each loss is told."""

from __future__ import annotations

import tempfile
from pathlib import Path

from hypothesis import given, settings
from hypothesis import strategies as st
from pyoxigraph import NamedNode, RdfFormat, Triple, parse, serialize

from cfgplan.matching.ontology import Ontology
from cfgplan.matching.ontology_files import load_ontology

NAMESPACE = "http://x.example/#"
GOOD = f"""
@prefix : <{NAMESPACE}> .
@prefix owl: <http://www.w3.org/2002/07/owl#> .
@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
@prefix xsd: <http://www.w3.org/2001/XMLSchema#> .
:Camera a owl:Class ; rdfs:subClassOf :Device . :Device a owl:Class .
:p a owl:ObjectProperty . :q a owl:ObjectProperty ; owl:inverseOf :p . :d a owl:DatatypeProperty .
:A a owl:Class . :B a owl:Class .
:C a owl:Class ; owl:equivalentClass [ a owl:Restriction ; owl:onProperty :p ; owl:someValuesFrom :A ] .
:D owl:equivalentClass [ a owl:Class ; owl:intersectionOf ( :A [
    a owl:Restriction ; owl:onProperty :p ; owl:minQualifiedCardinality "2"^^xsd:nonNegativeInteger ; owl:onClass :B
] ) ] .
:E owl:equivalentClass [ a owl:Class ; owl:unionOf ( :A [ a owl:Class ; owl:complementOf :B ] ) ] .
:F rdfs:subClassOf [ a owl:Restriction ; owl:onProperty [ owl:inverseOf :p ] ; owl:allValuesFrom :A ] .
:G owl:equivalentClass [ a owl:Restriction ; owl:onProperty :d ; owl:someValuesFrom [
    a rdfs:Datatype ; owl:onDatatype xsd:integer ; owl:withRestrictions ( [ xsd:minInclusive 3 ] )
] ] .
:H owl:equivalentClass [ a owl:Class ; owl:oneOf ( :i :j ) ] .
:i a owl:NamedIndividual , :A . :j a owl:NamedIndividual .
[] a owl:AllDisjointClasses ; owl:members ( :A :K ) .
:K a owl:Class . :r a owl:ObjectProperty ; owl:propertyChainAxiom ( :p :q ) .
:A owl:hasKey ( :p ) . :L owl:disjointUnionOf ( :B :K ) .
[] a owl:NegativePropertyAssertion ; owl:sourceIndividual :i ; owl:assertionProperty :p ; owl:targetIndividual :j .
"""
TRIPLES = list(parse(GOOD, RdfFormat.TURTLE))
DEFINED = "CDEFGH"
FAR_AWAY = f"SubClassOf(<{NAMESPACE}Camera> <{NAMESPACE}Device>)"
FORMS = {"ttl": RdfFormat.TURTLE, "rdf": RdfFormat.RDF_XML, "nt": RdfFormat.N_TRIPLES}


def read(triples: list[Triple], ending: str) -> Ontology:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"o.{ending}"
        path.write_bytes(serialize(triples, format=FORMS[ending]) or b"")
        return load_ontology([path])


def named(name: str) -> str:
    return f"{NAMESPACE}{name}"


@st.composite
def damaged(draw: st.DrawFn) -> tuple[Triple, list[Triple]]:
    """A triple that is not of Camera or Device, and the ontology in which it is gone or says something else."""
    near = [triple for triple in TRIPLES if "Camera" not in str(triple) and "Device" not in str(triple)]
    hit = draw(st.sampled_from(near))
    left = [triple for triple in TRIPLES if triple is not hit]
    kind = draw(st.sampled_from(["gone", "value", "predicate"]))
    if kind == "value":
        other = draw(st.sampled_from([value for triple in near for value in (triple.subject, triple.object)]))
        left.append(Triple(hit.subject, hit.predicate, other))
    elif kind == "predicate":
        other = draw(st.sampled_from(near)).predicate
        if not (ending_of(other) == "type" and not isinstance(hit.object, NamedNode)):
            left.append(Triple(hit.subject, other, hit.object))
    return hit, left


def ending_of(name: NamedNode) -> str:
    return name.value.rpartition("#")[2]


def test_the_undamaged_ontology_has_no_loss() -> None:
    ontology = read(TRIPLES, "ttl")
    assert not ontology.dropped
    assert all(any(named(name) in axiom for axiom in ontology.axioms) for name in DEFINED)


@settings(max_examples=300, deadline=None)
@given(damaged(), st.sampled_from(sorted(FORMS)))
def test_what_a_damage_does_not_reach_is_read_and_definitions_are_read_or_told(
    drawn: tuple[Triple, list[Triple]], ending: str
) -> None:
    hit, triples = drawn
    ontology = read(triples, ending)
    assert FAR_AWAY in ontology.axioms
    for name in DEFINED:
        heads = [triple for triple in triples if str(triple.subject) == f"<{named(name)}>"]
        if str(hit.subject) != f"<{named(name)}>" and heads:
            is_read = any(named(name) in axiom for axiom in ontology.axioms if not axiom.startswith("Declaration"))
            assert is_read or any(f"`{name} " in loss for loss in ontology.dropped), name
