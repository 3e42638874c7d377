from __future__ import annotations

import os
from pathlib import Path
from tempfile import gettempdir

import pytest

from cfgplan.errors import InputError
from cfgplan.matching import REASONERS, MatchingError, Ontology, justifications, match


def leftovers() -> set[Path]:
    return set(Path(gettempdir()).glob("cfgplan-hermit-*"))


@pytest.fixture(autouse=True)
def _temporary_files_in_a_folder_of_their_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))


@pytest.mark.parametrize("reasoner", REASONERS)
def test_every_reasoner_decides_the_example_of_the_paper(reasoner: str, streams: Ontology) -> None:
    offered, demanded = "Undistorted ⊓ ∃hasSource.{cam1}", "Undistorted ⊓ ∃hasSource.Camera"
    matching = match([offered, "Undistorted"], [demanded, "⊤"], streams, reasoner=reasoner)
    assert matching.similarity.offers == {demanded: {offered}, "⊤": {offered, "Undistorted"}}
    assert not leftovers()


def test_an_unknown_reasoner_is_refused(streams: Ontology) -> None:
    with pytest.raises(MatchingError, match="did you mean `hermit`"):
        match(["Image"], ["Image"], streams, reasoner="hermet")


def test_hermit_says_that_an_ontology_contradicts_itself(streams: Ontology) -> None:
    contradicting = Ontology([*streams.axioms, "ClassAssertion(ObjectComplementOf(<w#Device>) <w#laser1>)"])
    with pytest.raises(InputError, match="contradicts itself"):
        match(["Image"], ["Image"], contradicting, reasoner="hermit")
    assert not leftovers()


def test_a_contradiction_that_only_hermit_finds_names_the_axioms_that_clash_and_no_others(
    streams: Ontology, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(justifications, "EXPLANATION_PATIENCE_S", 300.0)  # whatever else the computer does
    clash = (
        "ClassAssertion(ObjectUnionOf(<w#Device> <w#Room>) <w#thing>)",
        "ClassAssertion(ObjectComplementOf(<w#Device>) <w#thing>)",
        "ClassAssertion(ObjectComplementOf(<w#Room>) <w#thing>)",
    )
    with pytest.raises(InputError) as refused:
        match(["Image"], ["Image"], Ontology([*streams.axioms, *clash]))
    (fault,) = refused.value.faults
    assert fault.message == (
        "the ontology contradicts itself, so that everything would match: "
        "ClassAssertion(ObjectComplementOf(Device) thing); ClassAssertion(ObjectComplementOf(Room) thing); "
        "ClassAssertion(ObjectUnionOf(Device Room) thing)"
    )


def test_a_counted_transitive_property_is_an_error_that_names_the_axiom(streams: Ontology) -> None:
    axioms = [*streams.axioms, "TransitiveObjectProperty(<w#hasSource>)"]
    counted = Ontology([*axioms, "SubClassOf(<w#Image> ObjectMaxCardinality(1 <w#hasSource> <w#Device>))"])
    with pytest.raises(InputError, match=r"OWL forbids.*ObjectMaxCardinality\(1 hasSource Device\)"):
        match(["Image"], ["≤1 hasSource.Device"], counted)


def test_property_chains_in_a_ring_are_an_error_of_their_own(streams: Ontology) -> None:
    chains = [
        "SubObjectPropertyOf(ObjectPropertyChain(<w#hasSource> <w#r>) <w#s>)",
        "SubObjectPropertyOf(ObjectPropertyChain(<w#hasSource> <w#s>) <w#r>)",
    ]
    with pytest.raises(InputError, match="in a ring"):
        match(["Image ⊓ ∃hasSource.∃r.Camera"], ["∃s.Camera"], Ontology([*streams.axioms, *chains]), reasoner="hermit")
    match(["Image"], ["Camera"], Ontology([*streams.axioms, *chains]), reasoner="hermit")  # they do not bear on it


def test_what_is_not_answered_in_time_is_unknown_and_does_not_match(streams: Ontology) -> None:
    matching = match(["Image ⊓ ¬Undistorted"], ["Image", "¬Undistorted"], streams, time_limit_s=0.001)
    assert matching.similarity.offers == {"Image": {"Image ⊓ ¬Undistorted"}, "¬Undistorted": frozenset()}
    assert list(matching.similarity.open_pairs()) == [("Image ⊓ ¬Undistorted", "¬Undistorted")]
    assert any("0.001 s" in warning for warning in matching.warnings)
    assert any("could not be decided" in warning for warning in matching.warnings)
    assert not leftovers()


def test_names_that_are_not_ascii_reach_hermit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LC_ALL", "C")
    ontology = Ontology(["SubClassOf(<w#Kamerabild> <w#Bild_für_Ärzte>)", "SubClassOf(<w#図> <w#Bild_für_Ärzte>)"])
    found = match(["Kamerabild", "図"], ["Bild_für_Ärzte", "図"], ontology, reasoner="hermit")
    assert found.similarity.offers == {"Bild_für_Ärzte": {"Kamerabild", "図"}, "図": {"図"}}


def test_literals_of_datatypes_that_hermit_does_not_know_are_no_obstacle(streams: Ontology) -> None:
    date = '"2020-01-01"^^<http://www.w3.org/2001/XMLSchema#date>'
    dated = Ontology([*streams.axioms, f"DataPropertyAssertion(<w#since> <w#cam1> {date})"])
    assert match(["Image"], ["¬Device"], dated).similarity.holds("Image", "¬Device")


DATE = "<http://www.w3.org/2001/XMLSchema#date>"
MAP = "<http://www.opengis.net/ont/geosparql#wktLiteral>"
SINCE, AT = "DataPropertyAssertion(<w#since> <w#cam1>", "DataPropertyAssertion(<w#at> <w#cam1>"
STRING = "<http://www.w3.org/2001/XMLSchema#string>"


@pytest.mark.parametrize(
    ("axioms", "is_open"),
    [
        (
            [f"DataPropertyRange(<w#since> {DATE})", f'DataPropertyAssertion(<w#since> <w#cam1> "2020-01-01"^^{DATE})'],
            False,
        ),
        (
            [f'DataPropertyAssertion(<w#at> <w#cam1> "POINT(1 2)"^^{MAP})', "DataPropertyDomain(<w#at> <w#Device>)"],
            False,
        ),
        ([f"DataPropertyRange(<w#since> {DATE})", f'{SINCE} "then")'], True),
        ([f"DataPropertyRange(<w#at> {STRING})", f'{AT} "1"^^{MAP})'], True),
        ([f"SubClassOf(<w#RawRGB> DataSomeValuesFrom(<w#since> {DATE}))"], True),
        (
            [
                "FunctionalDataProperty(<w#at>)",
                "SubDataPropertyOf(<w#in> <w#at>)",
                f'DataPropertyAssertion(<w#in> <w#cam1> "1"^^{MAP})',
                f'DataPropertyAssertion(<w#in> <w#cam1> "01"^^{MAP})',
            ],
            True,
        ),
    ],
)
def test_what_the_loss_of_a_literal_may_change_is_open(streams: Ontology, axioms: list[str], is_open: bool) -> None:
    ontology = Ontology([*streams.axioms, *axioms])
    found = match(["Image", "RawRGB"], ["¬Device", "Undistorted"], ontology, reasoner="hermit")
    assert found.similarity.holds("RawRGB", "¬Device")
    assert bool(ontology.dropped) is is_open
    assert found.similarity.is_open("RawRGB", "Undistorted") is is_open


@pytest.mark.parametrize(
    ("text", "datatype", "is_well_formed"),
    [
        ("2017-04-17", "dateTime", False),
        ("2017-02-30T00:00:00", "dateTime", False),
        ("-0004-02-29T24:00:00.0+14:00", "dateTime", True),
        ("12017-02-28T00:00:00Z", "dateTime", False),
        ("2017-02-28T00:00:00", "dateTimeStamp", False),
        ("+5", "integer", True),
        ("5.0", "integer", False),
        ("٣", "integer", False),
        ("128", "byte", False),
        ("-128", "byte", True),
        ("5.", "decimal", True),
        ("-.5E+3", "double", True),
        ("+INF", "float", False),
        ("1,5", "double", False),
        ("yes", "boolean", False),
        ("abc", "hexBinary", False),
        ("a b", "anyURI", False),
        ("http://x.example/a%20b", "anyURI", True),
        ("en-GB", "language", True),
        ("a:b", "NCName", False),
        ("größe", "NCName", True),
        (" a", "token", False),
        ("a\nb", "string", True),
        ("YWJj", "base64Binary", True),
    ],
)
def test_a_malformed_literal_is_told_as_text_and_open_where_it_is_restricted(
    text: str, datatype: str, is_well_formed: bool, streams: Ontology
) -> None:
    kind = f"<http://www.w3.org/2001/XMLSchema#{datatype}>"
    literal = f'DataPropertyAssertion(<w#at> <w#cam1> "{text}"^^{kind})'
    free = Ontology([*streams.axioms, literal])
    assert not free.dropped
    held = Ontology([*streams.axioms, literal, f"DataPropertyRange(<w#at> {kind})"])
    assert [f'"{text}"^^{kind} is malformed' in why for why in held.dropped.values()] == [True] * (not is_well_formed)
    assert all("restricted" in why for why in held.dropped.values())


def test_malformed_literals_do_not_stop_the_reasoner(streams: Ontology) -> None:
    kind = "<http://www.w3.org/2001/XMLSchema#dateTime>"
    literals = [f'DataPropertyAssertion(<w#at> <w#cam1> "{text}"^^{kind})' for text in ("2017", 'a \\"b\\" c', "")]
    limits = [f"DataPropertyRange(<w#at> {kind})", f'SubClassOf(<w#RawRGB> DataHasValue(<w#at> "now"^^{kind}))']
    for axioms in (literals, [*literals, *limits]):
        found = match(
            ["Image", "RawRGB"], ["¬Device", "Undistorted"], Ontology([*streams.axioms, *axioms]), reasoner="hermit"
        )
        assert found.similarity.holds("RawRGB", "¬Device")
        assert found.similarity.is_open("RawRGB", "Undistorted") is (axioms != literals)
    assert any('"now"^^dateTime is malformed' in warning for warning in found.warnings)


def test_the_domain_of_a_literal_that_is_not_told_still_follows(streams: Ontology) -> None:
    axioms = [
        "FunctionalDataProperty(<w#at>)",
        "DataPropertyDomain(<w#at> <w#Device>)",
        f'DataPropertyAssertion(<w#at> <w#thing> "1"^^{MAP})',
    ]
    found = match(["{thing}"], ["Device"], Ontology([*streams.axioms, *axioms]), reasoner="hermit")
    assert found.similarity.holds("{thing}", "Device")


CHAIN_INTO_A_RANGE = [
    *(f"Declaration(Class(<w#{name}>))" for name in "ABC"),
    "Declaration(ObjectProperty(<w#r>))",
    "ObjectPropertyRange(<w#t> <w#B>)",
    "SubObjectPropertyOf(ObjectPropertyChain(<w#r> <w#s>) <w#t>)",
]
CHAIN_TO_A_VALUE = [
    "EquivalentClasses(<w#C> ObjectHasValue(<w#t> <w#i3>))",
    "ClassAssertion(<w#C> <w#b>)",
    "ObjectPropertyAssertion(<w#s> <w#i1> <w#b>)",
    "SubObjectPropertyOf(ObjectPropertyChain(<w#s> <w#t>) <w#t>)",
]


@pytest.mark.parametrize("reasoner", ["auto", "hermit"])
@pytest.mark.parametrize(
    ("axioms", "offered", "demanded"),
    [(CHAIN_INTO_A_RANGE, "r some (s some A)", "r some (s some B)"), (CHAIN_TO_A_VALUE, "{i1}", "C")],
)
def test_matches_that_other_reasoners_miss_are_found_whatever_is_installed(
    axioms: list[str], offered: str, demanded: str, reasoner: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("Konclude", "java"):
        program = tmp_path / name
        program.write_text("#!/bin/sh\nexit 1\n")
        program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    matching = match([offered], [demanded], Ontology(axioms), reasoner=reasoner)
    assert matching.similarity.holds(offered, demanded)
    assert not matching.similarity.open
