from __future__ import annotations

import stat
import sys
from pathlib import Path
from tempfile import gettempdir

import pytest

from cfgplan.errors import InputError
from cfgplan.matching import REASONERS, MatchingError, Ontology, konclude, match


def leftovers() -> set[Path]:
    return {path for pattern in ("cfgplan-hermit-*", "cfgplan-konclude-*") for path in Path(gettempdir()).glob(pattern)}


@pytest.fixture(autouse=True)
def _temporary_files_in_a_folder_of_their_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))


@pytest.mark.parametrize("reasoner", [name for name in REASONERS if name != "konclude"])
def test_every_reasoner_decides_the_example_of_the_paper(reasoner: str, streams: Ontology) -> None:
    offered, demanded = "Undistorted ⊓ ∃hasSource.{cam1}", "Undistorted ⊓ ∃hasSource.Camera"
    matching = match([offered, "Undistorted"], [demanded, "⊤"], streams, reasoner=reasoner)
    assert matching.similarity.offers == {demanded: {offered}, "⊤": {offered, "Undistorted"}}
    assert not leftovers()


def test_an_unknown_reasoner_is_refused(streams: Ontology) -> None:
    with pytest.raises(MatchingError, match="did you mean 'hermit'"):
        match(["Image"], ["Image"], streams, reasoner="hermet")


def test_hermit_says_that_an_ontology_contradicts_itself(streams: Ontology) -> None:
    contradicting = Ontology([*streams.axioms, "ClassAssertion(ObjectComplementOf(<w#Device>) <w#laser1>)"])
    with pytest.raises(InputError, match="contradicts itself"):
        match(["Image"], ["Image"], contradicting, reasoner="hermit")
    assert not leftovers()


def test_a_counted_transitive_property_is_an_error_that_names_the_axiom(streams: Ontology) -> None:
    axioms = [*streams.axioms, "TransitiveObjectProperty(<w#hasSource>)"]
    counted = Ontology([*axioms, "SubClassOf(<w#Image> ObjectMaxCardinality(1 <w#hasSource> <w#Device>))"])
    with pytest.raises(InputError, match=r"OWL forbids.*ObjectMaxCardinality\(1 hasSource Device\)"):
        match(["Image"], ["Camera"], counted)


def test_property_chains_in_a_ring_are_an_error_of_their_own(streams: Ontology) -> None:
    chains = [
        "SubObjectPropertyOf(ObjectPropertyChain(<w#hasSource> <w#r>) <w#s>)",
        "SubObjectPropertyOf(ObjectPropertyChain(<w#hasSource> <w#s>) <w#r>)",
    ]
    with pytest.raises(InputError, match="in a ring"):
        match(["Image"], ["Camera"], Ontology([*streams.axioms, *chains]), reasoner="hermit")


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


FAKE = """#!{python}
import sys
from pathlib import Path
arguments = dict(zip(sys.argv[2::2], sys.argv[3::2]))
{do}
"""
ANSWER = """<Ontology xmlns="http://www.w3.org/2002/07/owl#">
<SubClassOf><Class IRI="t:0"/><Class IRI="t:2"/></SubClassOf>
<EquivalentClasses><Class abbreviatedIRI="owl:Nothing"/><Class IRI="t:5"/></EquivalentClasses></Ontology>"""


@pytest.mark.parametrize(
    ("do", "usable"),
    [
        (f"Path(arguments['-o']).write_text('''{ANSWER}''')", True),
        ("Path(arguments['-o']).write_text('<Ontology')", False),
        ("import time; time.sleep(60)", False),
        ("sys.exit('{{error}} 10:00 >> no')", False),
    ],
)
def test_konclude_is_used_only_where_it_passes_a_trial(
    do: str, usable: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program = tmp_path / "Konclude"
    program.write_text(FAKE.format(python=sys.executable, do=do))
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(konclude, "TRIAL_S", 1.0)
    konclude.is_usable.cache_clear()
    assert konclude.is_usable() is usable
    konclude.is_usable.cache_clear()


def test_konclude_must_be_installed_to_be_chosen(streams: Ontology, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    with pytest.raises(InputError, match="not installed"):
        match(["Image"], ["Image"], streams, reasoner="konclude")
