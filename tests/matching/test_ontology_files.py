from __future__ import annotations

from pathlib import Path

import pytest

from cfgplan.errors import InputError
from cfgplan.matching import (
    MatchingError,
    Ontology,
    ReasonerTimeoutError,
    instances,
    load_ontology,
    match,
    ontology_files,
    read_owlready,
)

TURTLE = """@prefix : <http://w.example/#> .
@prefix owl: <http://www.w3.org/2002/07/owl#> .
@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
<http://w.example/> a owl:Ontology .
:Camera a owl:Class ; rdfs:subClassOf :Device .
:hasSource a owl:ObjectProperty .
:cam1 a :Camera .
"""
RDF_TYPE = "<http://www.w3.org/1999/02/22-rdf-syntax-ns#type>"
SUBCLASS = "<http://www.w3.org/2000/01/rdf-schema#subClassOf>"
N_TRIPLES = f"""<http://w.example/#Camera> {SUBCLASS} <http://w.example/#Device> .
<http://w.example/#cam1> {RDF_TYPE} <http://w.example/#Camera> .
<http://w.example/#hasSource> {RDF_TYPE} <http://www.w3.org/2002/07/owl#ObjectProperty> .
"""
RDF_XML = """<?xml version="1.0"?>
<rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#" xmlns:owl="http://www.w3.org/2002/07/owl#"
  xmlns:rdfs="http://www.w3.org/2000/01/rdf-schema#" xmlns:w="http://w.example/#">
  <owl:Ontology rdf:about=""/>
  <owl:Class rdf:about="#Camera"><rdfs:subClassOf rdf:resource="#Device"/></owl:Class>
  <owl:ObjectProperty rdf:about="#hasSource"/>
  <owl:NamedIndividual rdf:about="#cam1"><rdf:type rdf:resource="#Camera"/></owl:NamedIndividual>
</rdf:RDF>
"""
OWL_XML = """<?xml version="1.0"?>
<Ontology xmlns="http://www.w3.org/2002/07/owl#" xml:base="http://w.example/" ontologyIRI="http://w.example/">
  <Prefix name="" IRI="http://w.example/#"/>
  <Declaration><ObjectProperty abbreviatedIRI=":hasSource"/></Declaration>
  <SubClassOf><Class abbreviatedIRI=":Camera"/><Class abbreviatedIRI=":Device"/></SubClassOf>
  <ClassAssertion><Class abbreviatedIRI=":Camera"/><NamedIndividual abbreviatedIRI=":cam1"/></ClassAssertion>
</Ontology>
"""
FUNCTIONAL = """# comment
Prefix(:=<http://w.example/#>)
Ontology(<http://w.example/>
  Declaration(ObjectProperty(:hasSource))
  SubClassOf(:Camera :Device)
  ClassAssertion(:Camera :cam1)
)
"""
MANCHESTER = """Prefix: : <http://w.example/#>
Ontology: <http://w.example/>
ObjectProperty: :hasSource
Class: :Device
Class: :Camera
  SubClassOf: :Device
Individual: :cam1
  Types: :Camera
"""


@pytest.mark.parametrize("suffix", [".ttl", ".owl", ".rdf", ""])
@pytest.mark.parametrize("text", [TURTLE, N_TRIPLES, RDF_XML, OWL_XML, FUNCTIONAL, MANCHESTER])
def test_every_syntax_is_told_by_its_content(text: str, suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"world{suffix}"
    path.write_text(text)
    ontology = load_ontology([path])
    assert set(ontology.classes) == {"Camera", "Device"}
    assert instances(ontology, "Device") == ("cam1",)


@pytest.mark.parametrize(
    ("name", "content", "line", "told"),
    [
        ("a.ttl", b"", None, "is empty"),
        ("a.ttl", b"@prefix : <http://x#> .\n\n:a :b c .", 3, "Turtle"),
        ("a.ttl", b"@prefix : <http://x#> . nonsense", 1, "Turtle"),
        ("a.ofn", FUNCTIONAL.replace("SubClassOf", "SubClassUp").encode(), 5, "functional"),
        ("a.omn", MANCHESTER.replace("SubClassOf: ", "SubClassOf: and ").encode(), 6, "Manchester"),
        ("a.owl", RDF_XML.replace("</owl:Class>", "</owl:Klass>").encode(), 5, "RDF/XML"),
        ("a.owx", OWL_XML.replace("<SubClassOf>", "<SubKlass>").encode(), 5, "OWL/XML"),
        ("a.png", b"\x89PNG\r\n\xff\xfe\x00", None, "not text"),
        ("a.ttl", b"<http://x/a> <http://www.w3.org/2000/01/rdf-schema#seeAlso> 5 .", None, "no axiom"),
        ("missing.ttl", None, None, "does not exist"),
    ],
)
def test_a_file_that_is_no_ontology_is_one_clear_fault(
    name: str, content: bytes | None, line: int | None, told: str, tmp_path: Path
) -> None:
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        load_ontology([path])
    (fault,) = caught.value.faults
    assert (fault.file, fault.line) == (str(path), line)
    assert told in fault.message


@pytest.mark.parametrize(
    ("turtle", "offered", "demanded"),
    [
        ("[] a owl:AllDisjointClasses ; owl:members ( :A :B :C ) .", "A", "¬C"),
        ("[] a owl:AllDisjointClasses ; owl:members ( [ owl:unionOf ( :A :B ) ] :C ) .", "A", "¬C"),
        ("[] a owl:AllDisjointProperties ; owl:members ( :r :s ) .", "∃r.{p} ⊓ ∃s.{q}", "∃r.{p} ⊓ ¬{q} ⊔ ∃r.⊤"),
        (":p :r [ a :A ] .", "{p}", "∃r.A"),
        (":p :r _:x . _:x a :A ; :s :q .", "{p}", "∃r.(A ⊓ ∃s.{q})"),
        (":A rdfs:subClassOf [ owl:onProperty :r ; owl:someValuesFrom :B ] .", "A", "∃r.B"),
        (":A owl:intersectionOf ( :B :C ) .", "B ⊓ C", "A"),
        (":A rdfs:subClassOf [ owl:unionOf ( :B :C ) ] . :B rdfs:subClassOf :C .", "A", "C"),
        ("[] a owl:AllDifferent ; owl:distinctMembers ( :p :q ) .", "{p}", "¬{q}"),
        (':p rdfs:comment "a \\"quoted\\" text; _:x <y>" ; :r :q .', "{p}", "∃r.{q}"),
    ],
)
def test_nothing_that_rdf_says_is_lost(turtle: str, offered: str, demanded: str, tmp_path: Path) -> None:
    names = "".join(f":{name} a owl:Class . " for name in "ABC")
    names += "".join(f":{name} a owl:ObjectProperty . " for name in "rs")
    names += "".join(f":{name} a owl:NamedIndividual . " for name in "pq")
    path = tmp_path / "said.ttl"
    path.write_text(TURTLE + names + turtle)
    ontology = load_ontology([path])
    assert match([offered], [demanded], ontology).similarity.holds(offered, demanded)
    assert set(ontology.individuals) == {"cam1", "p", "q"}


def test_disjoint_properties_contradict_a_shared_value(tmp_path: Path) -> None:
    path = tmp_path / "said.ttl"
    both = "[] a owl:AllDisjointProperties ; owl:members ( :r :hasSource ) . :r a owl:ObjectProperty ."
    path.write_text(f"{TURTLE}{both} :cam1 :r :cam1 ; :hasSource :cam1 .")
    with pytest.raises(InputError, match="contradicts"):
        match(["Camera"], ["Device"], load_ontology([path]))


def test_anonymous_individuals_of_two_files_are_two(tmp_path: Path) -> None:
    for name, kind in (("one", "Camera"), ("two", "Device")):
        (tmp_path / f"{name}.ttl").write_text(
            f"{TURTLE}:{name} a owl:NamedIndividual ; :hasSource _:x . _:x a :{kind} ."
        )
    ontology = load_ontology([tmp_path / "one.ttl", tmp_path / "two.ttl"])
    assert instances(ontology, "hasSource some Camera") == ("one",)
    assert instances(ontology, "hasSource some Device") == ("one", "two")


def importing(iri: str) -> str:
    return TURTLE.replace("a owl:Ontology", f"a owl:Ontology ; owl:imports <{iri}>")


@pytest.mark.parametrize("iri", ["sub/base.ttl", "http://base.example/base", "http://other.example/by-its-own-iri"])
def test_an_import_is_found_by_path_by_name_and_by_what_a_file_calls_itself(iri: str, tmp_path: Path) -> None:
    base = TURTLE.replace("http://w.example/>", "http://other.example/by-its-own-iri>").replace("Camera", "Lidar")
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub/base.ttl").write_text(base)
    (tmp_path / "base.ttl").write_text(base.replace("<http://other.example", "<http://base.example", 1))
    (tmp_path / "own.ttl").write_text(base)
    (tmp_path / "main.ttl").write_text(importing(iri))
    ontology = load_ontology([tmp_path / "main.ttl"])
    assert {"Camera", "Lidar"} <= set(ontology.classes)


def test_a_missing_import_is_a_fault_with_its_line_and_rings_of_imports_end(tmp_path: Path) -> None:
    (tmp_path / "one.ttl").write_text(importing("two.ttl"))
    (tmp_path / "two.ttl").write_text(importing("one.ttl"))
    assert len(load_ontology([tmp_path / "one.ttl"]).files) == 2
    (tmp_path / "two.ttl").write_text(importing("http://nowhere.example/three"))
    with pytest.raises(InputError) as caught:
        load_ontology([tmp_path / "one.ttl"])
    (fault,) = caught.value.faults
    assert (fault.file, fault.line) == (str(tmp_path / "two.ttl"), 4)
    assert "<http://nowhere.example/three>" in fault.message


def test_the_digest_depends_on_the_axioms_alone(tmp_path: Path) -> None:
    digests = set()
    for number, text in enumerate((TURTLE, TURTLE.replace("\n:", "\n# comment\n\n:"))):
        path = tmp_path / f"{number}.ttl"
        path.write_text(text)
        digests.add(load_ontology([path]).digest)
    assert len(digests) == 1
    assert Ontology(["SubClassOf(<a> <b>)"]).digest != Ontology(["SubClassOf(<b> <a>)"]).digest


def test_instances_are_inferred_and_the_class_must_be_one(streams: Ontology) -> None:
    assert instances(streams, "Device") == ("cam1", "laser1")
    assert instances(streams, "Device ⊓ ¬Camera") == ()
    assert instances(streams, "Image") == ()
    for name in ("cam1", "hasSource", "Devise"):
        with pytest.raises(MatchingError):
            instances(streams, name)
    assert instances(load_ontology([]), "Robot") == ()


def test_an_owlready2_ontology_is_taken_over() -> None:
    owlready2 = pytest.importorskip("owlready2")
    onto = owlready2.World().get_ontology("http://w.example/")
    with onto:
        device = type("Device", (owlready2.Thing,), {})
        camera = type("Camera", (device,), {})
        has_source = type("hasSource", (owlready2.ObjectProperty,), {})
        type("CameraImage", (owlready2.Thing,), {"equivalent_to": [has_source.some(camera)]})
        camera("cam1")
    ontology = read_owlready(onto)
    assert instances(ontology, "Device") == ("cam1",)
    assert match(["hasSource value cam1"], ["CameraImage"], ontology).similarity.holds(
        "hasSource value cam1", "CameraImage"
    )


def test_members_that_can_not_be_found_in_time_are_an_error_and_not_left_out() -> None:
    outside = Ontology(
        [
            "SubClassOf(<urn:x#A> ObjectUnionOf(<urn:x#B> <urn:x#C>))",
            "ClassAssertion(<urn:x#A> <urn:x#one>)",
            "Declaration(Class(<urn:x#B>))",
            "Declaration(Class(<urn:x#C>))",
        ]
    )
    assert instances(outside, "A") == ("one",)
    with pytest.raises(ReasonerTimeoutError, match="could not be decided"):
        instances(outside, "B ⊔ C", time_limit_s=1e-3)


def test_what_no_reasoner_is_told_is_a_warning_and_part_of_the_ontology() -> None:
    axioms = ["SubClassOf(<a> <b>)"]
    less = Ontology(axioms, dropped={"a rule": "it counts"})
    assert less != Ontology(axioms)
    assert less.digest != Ontology(axioms).digest
    (warning,) = match(["<a>"], ["<b>"], less).warnings
    assert "a rule: it counts" in warning


PUBLISHED = """@prefix : <http://www.w3.org/ns/sosa/> .
@prefix sosa: <http://www.w3.org/ns/sosa/> .
@prefix dcterms: <http://purl.org/dc/terms/> .
@prefix foaf: <http://xmlns.com/foaf/0.1/> .
@prefix owl: <http://www.w3.org/2002/07/owl#> .
@prefix rdf: <http://www.w3.org/1999/02/22-rdf-syntax-ns#> .
@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
@prefix schema: <http://schema.org/> .
@prefix skos: <http://www.w3.org/2004/02/skos/core#> .
@prefix vann: <http://purl.org/vocab/vann/> .
@prefix voaf: <http://purl.org/vocommons/voaf#> .
@prefix xsd: <http://www.w3.org/2001/XMLSchema#> .
<http://www.w3.org/ns/sosa/> a owl:Ontology , voaf:Vocabulary ;
  dcterms:title "Sensor, Observation, Sample, and Actuator (SOSA) Ontology"@en ;
  dcterms:created "2017-04-17"^^xsd:date ;
  dcterms:creator [ a foaf:Agent ; foaf:name "Somebody"@en ] ;
  vann:preferredNamespacePrefix "sosa" ; vann:preferredNamespaceUri "http://www.w3.org/ns/sosa/" .
dcterms:title a owl:AnnotationProperty . dcterms:created a owl:AnnotationProperty .
vann:preferredNamespacePrefix a owl:AnnotationProperty . vann:preferredNamespaceUri a owl:AnnotationProperty .
schema:domainIncludes a owl:AnnotationProperty . schema:rangeIncludes a owl:AnnotationProperty .
skos:definition a owl:AnnotationProperty . foaf:Agent a owl:Class .
sosa:Sensor a rdfs:Class , owl:Class ; rdfs:label "Sensor"@en , "Capteur"@fr ; skos:definition "A device."@en ;
  rdfs:isDefinedBy sosa: ; rdfs:subClassOf sosa:System , [ a owl:Restriction ; owl:onProperty sosa:madeObservation ;
    owl:allValuesFrom sosa:Observation ] .
sosa:System a owl:Class . sosa:Observation a owl:Class .
sosa:Platform a owl:Class , owl:NamedIndividual .
sosa:Old a owl:Class , owl:DeprecatedClass ; owl:deprecated true ; owl:equivalentClass sosa:Sensor .
sosa:madeObservation a owl:ObjectProperty ; schema:domainIncludes sosa:Sensor ; schema:rangeIncludes sosa:Observation ;
  owl:inverseOf sosa:madeBySensor .
sosa:madeBySensor a owl:ObjectProperty ; schema:domainIncludes [ owl:unionOf ( sosa:Observation sosa:Sensor ) ] .
sosa:resultTime a owl:DatatypeProperty ; rdfs:range xsd:dateTime .
sosa:thermometer a sosa:Sensor ; sosa:madeObservation sosa:o1 .
sosa:o1 a sosa:Observation ; sosa:resultTime "2017-04-17T12:00:00Z"^^xsd:dateTime .
"""


def test_an_ontology_as_it_is_published_loads_in_every_form_of_rdf(tmp_path: Path) -> None:
    pyoxigraph = pytest.importorskip("pyoxigraph")
    path, read = tmp_path / "sosa.owl", dict[str, Ontology]()
    for form in ("TURTLE", "RDF_XML", "JSON_LD"):
        quads = pyoxigraph.parse(input=PUBLISHED, format=pyoxigraph.RdfFormat.TURTLE)
        written = pyoxigraph.serialize([quad.triple for quad in quads], format=getattr(pyoxigraph.RdfFormat, form))
        path.write_bytes(written)
        read[form] = ontology = load_ontology([path])
        assert not ontology.dropped
        assert ontology.classes["Sensor"] == "http://www.w3.org/ns/sosa/Sensor"
        assert (form, ontology.axioms) == (form, read["TURTLE"].axioms)
    ontology = read["TURTLE"]
    assert instances(ontology, "System") == instances(ontology, "Old") == ("thermometer",)
    assert match(["{o1}"], ["∃madeBySensor.Sensor"], ontology).similarity.holds("{o1}", "∃madeBySensor.Sensor")


def test_json_ld_gives_its_prefixes_and_a_remote_context_is_told(tmp_path: Path) -> None:
    path = tmp_path / "w.jsonld"
    context = '"owl": "http://www.w3.org/2002/07/owl#", "w": "http://w.example/#"'
    path.write_text(f'{{"@context": {{{context}}}, "@id": "w:Camera", "@type": "owl:Class"}}')
    ontology = load_ontology([path])
    assert ontology.class_names.find("w:Camera") == "http://w.example/#Camera"
    path.write_text('{"@context": "http://w.example/context.jsonld", "@id": "Camera"}')
    with pytest.raises(InputError, match=r"JSON-LD.*web addresses are not fetched"):
        load_ontology([path])


@pytest.mark.parametrize(
    ("turtle", "dropped"),
    [
        (":Camera rdfs:subClassOf [ a owl:Restriction ; owl:onProperty :hasSource ] .", "Camera subClassOf"),
        (":Camera rdfs:subClassOf [ owl:onProperties ( :size ) ; owl:someValuesFrom rdfs:Literal ] .", "Camera sub"),
        ("[ owl:unionOf ( :Camera [ owl:onProperty :hasSource ] ) ] rdfs:subClassOf :Device .", "[ ] subClassOf"),
        (':Camera owl:equivalentClass "a text" .', "Camera equivalentClass"),
        (":R a owl:Restriction ; owl:onProperty :hasSource ; owl:someValuesFrom :Camera .", "R onProperty"),
    ],
)
def test_what_of_a_graph_is_no_axiom_is_named(turtle: str, dropped: str, tmp_path: Path) -> None:
    path = tmp_path / "said.ttl"
    path.write_text(TURTLE + turtle)
    ((text, _),) = load_ontology([path]).dropped.items()
    assert dropped in text
    assert "said.ttl" in text


def test_a_restriction_that_is_a_class_too_is_not_lost(tmp_path: Path) -> None:
    path = tmp_path / "said.ttl"
    twice = "[ a owl:Class , owl:Restriction ; owl:onProperty :hasSource ; owl:someValuesFrom :Camera ]"
    path.write_text(f"{TURTLE}:Shot owl:equivalentClass [ owl:intersectionOf ( :Device {twice} ) ] .")
    ontology = load_ontology([path])
    assert not ontology.dropped
    assert match(["Shot"], ["∃hasSource.Device"], ontology).similarity.holds("Shot", "∃hasSource.Device")


SWRL = """@prefix swrl: <http://www.w3.org/2003/11/swrl#> .
<urn:x> a swrl:Variable . <urn:y> a swrl:Variable . :shot a owl:NamedIndividual ; :hasSource :cam1 .
[] a swrl:Imp ;
  swrl:body ( [ a swrl:ClassAtom ; swrl:classPredicate :Camera ; swrl:argument1 <urn:x> ]
    [ a swrl:IndividualPropertyAtom ; swrl:propertyPredicate :hasSource ; swrl:argument1 <urn:y> ;
      swrl:argument2 <urn:x> ] ) ;
  swrl:head ( [ a swrl:ClassAtom ; swrl:classPredicate :Device ; swrl:argument1 <urn:y> ] ) .
"""


def test_a_rule_is_told_for_named_individuals_and_named_for_all_others(tmp_path: Path) -> None:
    path = tmp_path / "rules.ttl"
    path.write_text(TURTLE + SWRL)
    ontology = load_ontology([path])
    ((text, _),) = ontology.dropped.items()
    assert "Camera(x), hasSource(y, x) → Device(y)" in text
    assert instances(Ontology(ontology.axioms), "Device") == ("cam1", "shot")


def test_a_dl_safe_rule_is_about_named_individuals_anyway_and_one_with_built_ins_is_not_told(tmp_path: Path) -> None:
    path = tmp_path / "rules.ofn"
    atom, head = "ObjectPropertyAtom(:hasSource Variable(<urn:y>) :cam1)", "ClassAtom(:Device Variable(<urn:y>))"
    rule = f"DLSafeRule(Body({atom} {{}})Head({head}))"
    more = "ObjectPropertyAssertion(:hasSource :shot :cam1)"
    path.write_text(FUNCTIONAL.replace("SubClassOf(", f"{rule.format('')} {more} SubClassOf("))
    ontology = load_ontology([path])
    assert not ontology.dropped
    assert instances(ontology, "Device") == ("cam1", "shot")
    greater = 'BuiltInAtom(<http://www.w3.org/2003/11/swrlb#greaterThan> Variable(<urn:y>) "5")'
    path.write_text(FUNCTIONAL.replace("SubClassOf(", f"{rule.format(greater)} {more} SubClassOf("))
    ontology = load_ontology([path])
    assert ["built-ins" in why for why in ontology.dropped.values()] == [True]
    assert not any(axiom.startswith("DLSafeRule") for axiom in ontology.axioms)


def test_keys_are_told_to_the_reasoner(tmp_path: Path) -> None:
    path = tmp_path / "keys.ttl"
    path.write_text(
        f'{TURTLE}:Camera owl:hasKey ( :serial ) . :serial a owl:DatatypeProperty . :cam1 :serial "7" . '
        ':other a :Camera ; :serial "7" ; :hasSource :cam1 .'
    )
    ontology = load_ontology([path])
    assert not ontology.dropped
    assert match(["{other}"], ["{cam1}"], ontology).similarity.holds("{other}", "{cam1}")


ATOM, VARIABLE = "<ClassAtom><Class abbreviatedIRI=':{}'/>{}</ClassAtom>", "<Variable IRI='urn:v'/>"
MORE = {
    OWL_XML: f"""
  <HasKey><Class abbreviatedIRI=":Camera"/><DataProperty abbreviatedIRI=":size"/></HasKey>
  <DatatypeDefinition><Datatype abbreviatedIRI=":Short"/><DatatypeRestriction>
    <Datatype IRI="http://www.w3.org/2001/XMLSchema#string"/>
    <FacetRestriction facet="http://www.w3.org/2001/XMLSchema#maxLength"><Literal
      datatypeIRI="http://www.w3.org/2001/XMLSchema#integer">5</Literal></FacetRestriction>
  </DatatypeRestriction></DatatypeDefinition>
  <DLSafeRule><Body>{ATOM.format("Camera", VARIABLE)}</Body><Head>{ATOM.format("Device", VARIABLE)}</Head></DLSafeRule>
  """,
    FUNCTIONAL: """
  HasKey(:Camera () (:size))
  DatatypeDefinition(:Short DatatypeRestriction(<http://www.w3.org/2001/XMLSchema#string>
    <http://www.w3.org/2001/XMLSchema#maxLength> "5"^^<http://www.w3.org/2001/XMLSchema#integer>))
  DLSafeRule(Body(ClassAtom(:Camera Variable(<urn:v>)))Head(ClassAtom(:Device Variable(<urn:v>))))
  """,
    MANCHESTER: """
DataProperty: :size
Class: :Camera
  HasKey: :size
Datatype: :Short
  EquivalentTo: <http://www.w3.org/2001/XMLSchema#string>[maxLength 5]
Rule: :Camera(?v) -> :Device(?v)
""",
}
SEVERAL = {
    OWL_XML: """
  <SubClassOf><Class abbreviatedIRI=":Camera"/><DataAllValuesFrom><DataProperty abbreviatedIRI=":size"/>
  <DataProperty abbreviatedIRI=":weight"/><Datatype abbreviatedIRI=":Pair"/></DataAllValuesFrom></SubClassOf>
  """,
    FUNCTIONAL: "\n\n  SubClassOf(:Camera DataAllValuesFrom(:size :weight :Pair))",
    MANCHESTER: "DataProperty: :size\nClass: :Camera\n  SubClassOf: :size :weight only :Pair\n",
}
END = {OWL_XML: "</Ontology>", FUNCTIONAL: ")\n", MANCHESTER: ""}


def with_more(text: str, more: str) -> str:
    """The ontology with more at its end."""
    end = END[text]
    before = text.rstrip().removesuffix(end.strip())
    return f"{before}\n{more}{end}"


@pytest.mark.parametrize("text", MORE, ids=["OWL/XML", "functional", "Manchester"])
def test_nothing_is_lost_of_the_syntaxes_that_are_no_rdf(text: str, tmp_path: Path) -> None:
    path = tmp_path / "more"
    path.write_text(with_more(text, MORE[text]))
    ontology = load_ontology([path])
    assert not [text for text in ontology.dropped if "rule" not in text]
    kinds = {axiom.partition("(")[0] for axiom in ontology.axioms}
    assert {"HasKey", "DatatypeDefinition", "DLSafeRule", "SubClassOf", "ClassAssertion"} <= kinds
    path.write_text(with_more(text, SEVERAL[text]))
    with pytest.raises(InputError) as caught:
        load_ontology([path])
    (fault,) = caught.value.faults
    assert fault.line is not None
    assert fault.line > len(text.rstrip().removesuffix(END[text].strip()).splitlines())


def test_a_built_in_that_is_read_as_a_property_is_not_told(tmp_path: Path) -> None:
    path = tmp_path / "rules.omn"
    prefix = "Prefix: swrlb: <http://www.w3.org/2003/11/swrlb#>\n"
    path.write_text(
        f"{prefix}{MANCHESTER}DataProperty: :size\nRule: :size(?x, ?y), swrlb:greaterThan(?y, 5) -> :Camera(?x)\n"
    )
    ontology = load_ontology([path])
    assert ["built-ins" in why for why in ontology.dropped.values()] == [True]
    assert not any(axiom.startswith("DLSafeRule") for axiom in ontology.axioms)


def test_an_import_is_named_or_ignored_in_the_environment_file(tmp_path: Path) -> None:
    import cfgplan

    iri = "http://www.w3.org/ns/elsewhere/"
    (tmp_path / "main.ttl").write_text(importing(iri))
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub/other.ttl").write_text(TURTLE.replace("Camera", "Lidar"))
    environment = "format: cfgplan/1\nontology: main.ttl\n{}targets: [{{label: t, topic: /t, tag: {}}}]\n"
    path = tmp_path / "env.yaml"

    def loaded(imports: str, tag: str = "Camera") -> cfgplan.World:
        path.write_text(environment.format(imports, tag))
        return cfgplan.load(path)

    with pytest.raises(InputError, match=r"main\.ttl:4: .*can't be found .*imports: \{http.*elsewhere/: ignore\}"):
        loaded("")
    assert "Lidar" in loaded(f"imports: {{{iri}: sub/other.ttl}}\n", "Lidar").ontology.classes
    for imports in (f"imports: {{{iri[:-1]}: ignore}}\n", "imports: ignore\n"):
        ontology = loaded(imports).ontology
        assert "Lidar" not in ontology.classes
        found = match(["Device"], ["Camera"], ontology)
        assert not found.similarity.open
        assert found.warnings == (f"the import <{iri}> is ignored: tags that match only by its axioms do not match",)
    with pytest.raises(InputError, match=r"env\.yaml:3:.*imports.*missing\.ttl.*does not exist"):
        loaded(f"imports: {{{iri}: missing.ttl}}\n")


CATALOG = """<?xml version="1.0" encoding="UTF-8" standalone="no"?>
<catalog prefer="public" xmlns="urn:oasis:names:tc:entity:xmlns:xml:catalog">
  <group id="Folder Repository, directory=, recursive=true, Auto-Update=true, version=2" prefer="public" xml:base="">
    <uri id="Automatically generated entry, Timestamp=1" name="http://elsewhere.example/a" uri="parts/a%20b.ttl"/>
  </group>
  <uri id="User Entered Import Resolution" name="http://elsewhere.example/web" uri="http://elsewhere.example/a"/>
  <group xml:base="parts/"><uri name="http://elsewhere.example/gone#" uri="gone.ttl"/>
    <uri name="http://elsewhere.example/b#" uri="b.ttl"/></group>
  <nextCatalog catalog="more.xml"/>
</catalog>
"""


def with_catalog(folder: Path, *imports: str) -> Path:
    """An ontology that imports some IRIs, with a catalog as Protégé writes it."""
    (folder / "parts").mkdir()
    (folder / "catalog-v001.xml").write_text(CATALOG)
    (folder / "more.xml").write_text(
        CATALOG.split("  <group")[0] + '<uri name="http://c.example/" uri="parts/c.ttl"/></catalog>'
    )
    for name in ("a b", "b", "c"):
        (folder / "parts" / f"{name}.ttl").write_text(
            TURTLE.replace(":Camera", f":{name[0].upper()}").replace("<http://w.example/> a", f"<u:{name[0]}> a")
        )
    said = ", ".join(f"<{iri}>" for iri in imports)
    (folder / "main.ttl").write_text(TURTLE.replace("a owl:Ontology", f"a owl:Ontology ; owl:imports {said}"))
    return folder / "main.ttl"


def test_imports_are_found_by_the_catalog_that_protege_keeps(tmp_path: Path) -> None:
    main = with_catalog(tmp_path, "http://elsewhere.example/a", "http://elsewhere.example/b", "http://c.example/")
    ontology = load_ontology([main])
    assert {"A", "B", "C"} <= ontology.classes.keys()
    assert {path.name for path in ontology.files} == {"main.ttl", "a b.ttl", "b.ttl", "c.ttl"}


@pytest.mark.parametrize("iri", ["http://elsewhere.example/web", "http://elsewhere.example/gone"])
def test_a_catalog_names_files_only(iri: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=f"import <{iri}> can't be found"):
        load_ontology([with_catalog(tmp_path, iri)])


def test_imports_that_the_environment_names_come_before_the_catalog(tmp_path: Path) -> None:
    iri = "http://elsewhere.example/a"
    ontology = load_ontology([with_catalog(tmp_path, iri)], {iri: tmp_path / "parts" / "b.ttl"})
    assert "B" in ontology.classes
    assert "A" not in ontology.classes


def test_a_broken_catalog_is_a_fault_with_its_line(tmp_path: Path) -> None:
    main = with_catalog(tmp_path, "http://elsewhere.example/a")
    (tmp_path / "catalog-v001.xml").write_text("<catalog>\n<uri</catalog>")
    with pytest.raises(InputError, match=r"catalog-v001\.xml:2:.*the catalog is not XML"):
        load_ontology([main])


def test_a_file_beside_is_looked_into_once_and_no_further_than_its_name_however_many_imports_are_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    iris = [f"http://elsewhere.example/{number}" for number in range(5)]
    (tmp_path / "main.ttl").write_text(
        TURTLE.replace("a owl:Ontology", f"a owl:Ontology ; owl:imports {', '.join(f'<{iri}>' for iri in iris)}")
    )
    beside = TURTLE.replace("a owl:Ontology", "a owl:Ontology ; " + " ; ".join(f"<u:see> <{iri}>" for iri in iris))
    (tmp_path / "beside.ttl").write_text(beside)
    read: list[str] = []
    looked_into: list[str] = []
    parse_rdf, own_iri = ontology_files._parse_rdf, ontology_files.ontology_iri
    monkeypatch.setattr(ontology_files, "_parse_rdf", lambda *said: (read.append(said[3]), parse_rdf(*said))[1])
    monkeypatch.setattr(ontology_files, "ontology_iri", lambda *said: (looked_into.append(said[2]), own_iri(*said))[1])
    ontology = load_ontology([tmp_path / "main.ttl"], {"": None})
    assert [Path(path).name for path in read] == ["main.ttl"]
    assert [Path(path).name for path in looked_into].count("beside.ttl") == 1
    assert ontology.ignored == tuple(iris)


def test_warnings_of_one_kind_are_one_line_with_a_count() -> None:
    dropped = {f"`a{number} sub ...` in x.ttl": "that is not an axiom of OWL 2" for number in range(2303)}
    warnings = Ontology(dropped={**dropped, "a rule": "no reasoner gets its built-ins"}).warnings
    why = "that is not an axiom of OWL 2"
    assert warnings == (
        f"the ontology says more than cfgplan reads: `a0 sub ...` in x.ttl and 2,302 more: {why}",
        "the ontology says more than cfgplan reads: a rule: no reasoner gets its built-ins",
    )


@pytest.mark.parametrize(
    "bad",
    [
        ":hasSource owl:equivalentProperty :d .",
        ":d owl:propertyDisjointWith :hasSource .",
        ":note owl:equivalentProperty :hasSource .",
        "<u:p> owl:equivalentProperty <u:q> .",
        ":hasSource owl:propertyChainAxiom ( [ a :Camera ] :hasSource ) .",
        ':hasSource owl:propertyChainAxiom ( "x" :hasSource ) .',
        ':Camera rdfs:subClassOf "x" .',
        ':Camera owl:disjointUnionOf "x" .',
        ':Camera rdfs:subClassOf [ a owl:Restriction ; owl:onProperty :d ; owl:minCardinality "x" ] .',
        ":Camera owl:unionOf owl:Class .",
        ":Camera owl:equivalentClass [ a rdfs:Datatype ; owl:onProperty :hasSource ; owl:someValuesFrom :Device ] .",
        ":Camera owl:equivalentClass [ rdfs:comment 3 ] .",
    ],
)
def test_one_bad_axiom_is_a_loss_and_the_rest_is_read(bad: str, tmp_path: Path) -> None:
    path = tmp_path / "w.ttl"
    path.write_text(TURTLE + ":d a owl:DatatypeProperty . :note a owl:AnnotationProperty .\n" + bad)
    ontology = load_ontology([path])
    assert "SubClassOf(<http://w.example/#Camera> <http://w.example/#Device>)" in ontology.axioms
    (lost,) = ontology.dropped.items()
    assert lost[0].endswith("in w.ttl")
    assert lost[1] == "that is not an axiom of OWL 2"


@pytest.mark.parametrize("kind", ["Object", "Datatype"])
def test_a_property_of_an_import_has_the_type_of_the_one_it_is_compared_with(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "w.ttl"
    said = f":p a owl:{kind}Property ; owl:equivalentProperty <u:q> . <u:q> owl:equivalentProperty <u:r> ."
    path.write_text(TURTLE + said)
    ontology = load_ontology([path])
    keyword = {"Object": "Object", "Datatype": "Data"}[kind]
    assert f"Equivalent{keyword}Properties(<http://w.example/#p> <u:q>)" in ontology.axioms
    assert f"Equivalent{keyword}Properties(<u:q> <u:r>)" in ontology.axioms
    assert not ontology.dropped
