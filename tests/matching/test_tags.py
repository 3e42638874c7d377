from __future__ import annotations

import subprocess
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cfgplan.matching import Ontology, TagError, check_tag, load_ontology
from cfgplan.matching.concepts import Named, Nominal, Some, conjunction
from cfgplan.matching.syntax import parse_tag

OPEN = load_ontology([])
ALIKE = [
    ("Undistorted ⊓ ∃hasSource.{cam1}", "hasSource value cam1 and Undistorted"),
    ("Undistorted ⊓ ∃hasSource.{cam1}", "Undistorted(cam1)"),
    ("Undistorted ⊓ ∃hasSource.cam1", "Undistorted(cam1)"),
    ("∃hasSource.Camera", "hasSource some Camera"),
    ("exists hasSource.Camera & Image", "Image that hasSource some Camera"),
    ("∀hasSource.Camera", "hasSource only Camera"),
    ("¬(Image ⊔ Device)", "not (Device or Image or Device)"),
    ("~Image | !Device", "not Image or not Device"),
    ("⊤", "owl:Thing"),
    ("⊥ ⊓ Image", "Nothing"),
    ("{cam1, laser1}", "{laser1} or {cam1}"),
    ("hasSource min 1 Camera", "∃hasSource.Camera"),
    ("hasSource min 2", "≥2 hasSource.⊤"),
    ("hasSource exactly 2 Camera", "≥ 2 hasSource.Camera ⊓ ≤ 2 hasSource.Camera"),
    ("(((Image)))", "<w#Image>"),
    ("w:Image", "'Image'"),
    ("∃hasSource.Camera ⊓ Image", "(hasSource some Camera) and Image"),
]
WRONG = [
    ("", 1, "empty"),
    ("Imag", 1, "did you mean `Image`?"),
    ("Image and", 10, "ends where a concept"),
    ("Image Device", 7, "not expected"),
    ("∃hasSorce.Camera", 2, "did you mean `hasSource`?"),
    ("∃hasSource", 11, "'.' is expected"),
    ("Image ⊓ ∃hasSource.{Camera}", 21, "'Camera' is a class, but an individual is expected"),
    ("Image)", 6, "remove it"),
    ("{cam1", 6, "to close '{'"),
    ("hasSource min many Camera", 15, "not a number"),
    ("Undistorted(Camera)", 13, "an individual is expected"),
    ("x:Image", 1, "prefix 'x:' is unknown"),
    ("Image ⊓ ⊓ Device", 9, "where a concept is expected"),
    ("hasSource", 1, "is a property"),
    ("hasSource somee Camera", 11, "did you mean `some`?"),
    ("Image adn Device", 7, "did you mean `and`?"),
    ("some Camera", 1, "where a concept is expected"),
    ("(" * 200 + "Image", 101, "nested"),
]


@pytest.mark.parametrize(("one", "other"), ALIKE)
def test_syntaxes_that_say_the_same_mean_the_same(one: str, other: str, streams: Ontology) -> None:
    assert parse_tag(one, streams) == parse_tag(other, streams)


@pytest.mark.parametrize(("tag", "column", "told"), WRONG)
def test_an_error_names_its_column_and_the_mend(tag: str, column: int, told: str, streams: Ontology) -> None:
    with pytest.raises(TagError) as caught:
        check_tag(tag, streams)
    assert caught.value.column == column
    assert told in str(caught.value)


@pytest.mark.parametrize(
    ("tag", "mend"),
    [
        (
            "Heater Command",
            "write `HeaterCommand` or `heater_command` if it is one name, `Heater and Command` if it is two",
        ),
        ("Heater Command and Room", "write `HeaterCommand`"),
    ],
)
def test_without_an_ontology_two_names_in_a_row_are_told_to_be_one(tag: str, mend: str) -> None:
    with pytest.raises(TagError, match="names have no spaces") as caught:
        check_tag(tag, OPEN)
    assert (caught.value.column, mend in str(caught.value)) == (8, True)


def test_a_name_of_the_ontology_that_is_written_with_a_space_is_proposed() -> None:
    ontology = Ontology(["SubClassOf(<x#ConvHull> <x#Hull>)", "SubClassOf(<x#cmd_vel> <x#Hull>)"])
    for tag, meant in (("Conv hull", "ConvHull"), ("Conv Hull", "ConvHull"), ("cmd vel", "cmd_vel")):
        with pytest.raises(TagError, match=f"names have no spaces.*did you mean `{meant}`"):
            check_tag(tag, ontology)
    with pytest.raises(TagError, match="join two concepts"):
        check_tag("ConvHull Hull", ontology)


@pytest.mark.parametrize(
    ("tag", "name"),
    [
        ("Battery_r1.1", "Battery_r1.1"),
        ("Image and hasHost value r1.1", "r1.1"),
        ("hasHost some {r1.1, r1.2}", "r1.1"),
        ("Battery(r1.1)", "r1.1"),
        ("not a@b", "a@b"),
        ("∃hasSource.cam.2", "cam.2"),
    ],
)
def test_a_name_with_other_signs_is_asked_for_in_quotes(tag: str, name: str) -> None:
    with pytest.raises(TagError) as refused:
        check_tag(tag, OPEN)
    assert refused.value.mend == f"write a name with such signs in quotes: \"'{name}'\""
    check_tag(tag.replace("r1.2", "other").replace(name, f"'{name}'"), OPEN)


@pytest.mark.parametrize("tag", ["hasPlace value room1.1", "hasPlace some {room1.1}", "Image(room1.1)"])
def test_a_name_of_the_ontology_with_other_signs_is_asked_for_in_quotes(tag: str) -> None:
    ontology = Ontology(["ClassAssertion(<x#Image> <x#room1.1>)", "SubObjectPropertyOf(<x#hasPlace> <x#hasSource>)"])
    with pytest.raises(TagError, match="has no individual 'room1'") as refused:
        check_tag(tag, ontology)
    assert refused.value.mend == "write the name in quotes: \"'room1.1'\""
    check_tag(tag.replace("room1.1", "'room1.1'"), ontology)


def test_and_binds_tighter_than_or_and_restrictions_tighter_than_and(streams: Ontology) -> None:
    assert parse_tag("Image or Device and hasSource some Camera or Device", streams) == parse_tag(
        "(Image ⊔ (Device ⊓ (∃hasSource.Camera))) ⊔ Device", streams
    )


def test_in_an_open_ontology_every_name_is_free() -> None:
    wanted = conjunction((Named("Any"), Some("hasSource", Named("thing-1"))))
    assert parse_tag("Any(thing-1)", OPEN) == wanted


@pytest.mark.parametrize("other", ["hasSource some cam1", "hasSource value cam1", "∃hasSource.{cam1}"])
def test_without_an_ontology_a_name_means_the_same_in_every_place(other: str) -> None:
    assert parse_tag(f"Undistorted and {other}", OPEN) == parse_tag("Undistorted(cam1)", OPEN)


def test_a_name_that_is_a_class_and_an_individual_is_read_by_its_place() -> None:
    axioms = [
        "ClassAssertion(<b#Type> <b#Room>)",
        "SubClassOf(<b#Room> <b#Space>)",
        "ClassAssertion(<b#Room> <c#Space>)",
    ]
    punned = Ontology([*axioms, "Declaration(ObjectProperty(<b#hasSource>))"])
    room, space, role = Named("b#Room"), Named("b#Space"), "b#hasSource"
    assert parse_tag("hasSource some Room and Space", punned) == conjunction((Some(role, room), space))
    assert parse_tag("hasSource value Room", punned) == Some(role, Nominal("b#Room"))
    assert parse_tag("{Room}", punned) == Nominal("b#Room")
    assert parse_tag("{Space}", punned) == Nominal("c#Space")
    assert parse_tag("Room(Space)", punned) == conjunction((room, Some(role, Nominal("c#Space"))))


def test_a_name_is_the_same_however_its_accents_are_encoded() -> None:
    composed, decomposed = "Caf\u00e9", "Cafe\u0301"
    for known, written in ((composed, decomposed), (decomposed, composed)):
        assert parse_tag(known, OPEN) == parse_tag(written, OPEN)
        ontology = Ontology([f"SubClassOf(<x#{known}> <x#Shop>)"], {"x": "x#"})
        for tag in (written, f"x:{written}", f"<x#{written}>", f"'{written}'"):
            assert parse_tag(tag, ontology) == parse_tag(known, ontology)


@pytest.mark.parametrize(
    "words",
    [
        *("Image", "{cam1}", "Image and not (Device)", "hasSource value cam1", "Image or (hasSource some Device)"),
        *("hasSource only (Camera and Device)", "hasSource min 2 Camera", "hasSource max 3 (not Camera)"),
        "Image and hasSource some (Camera or Device) and hasSource value cam1",
    ],
)
def test_a_concept_in_words_is_read_as_the_same_concept(words: str, streams: Ontology) -> None:
    concept = parse_tag(words, streams)
    written = streams.render(concept, words=True)
    assert parse_tag(written, streams) == concept
    assert not {*written} & {*"⊓⊔¬∃∀≥≤"}


def test_an_ambiguous_name_must_be_written_with_its_prefix() -> None:
    ontology = Ontology(["SubClassOf(<x#Image> <y#Image>)"], {"x": "x#", "y": "y#"})
    with pytest.raises(TagError, match="ambiguous"):
        check_tag("Image", ontology)
    assert parse_tag("y:Image", ontology) == Named("y#Image")
    assert set(ontology.classes) == {"x:Image", "y:Image"}


@given(st.text(alphabet="⊓⊔∃∀¬{}().,≥ ab1'<>:-~&|", max_size=30))
def test_any_text_is_a_tag_or_a_tag_error_within_it(text: str) -> None:
    try:
        check_tag(text, OPEN)
    except TagError as error:
        assert 1 <= error.column <= len(text) + 1


CONCEPTS = st.recursive(
    st.sampled_from(["A", "B", "{i}", "⊤"]),
    lambda inner: st.one_of(
        st.builds("({} ⊓ {})".format, inner, inner),
        st.builds("({} ⊔ {})".format, inner, inner),
        st.builds("¬{}".format, inner),
        st.builds("∃r.{}".format, inner),
        st.builds("∀r.{}".format, inner),
        st.builds("≤3 r.{}".format, inner),
    ),
    max_leaves=8,
)


@given(CONCEPTS)
def test_a_concept_reads_back_as_it_is_rendered(text: str) -> None:
    concept = parse_tag(text, OPEN)
    assert parse_tag(OPEN.render(concept), OPEN) == concept


def test_the_package_gives_each_of_its_names_and_imports_no_reasoner_for_it() -> None:
    code = (
        "import sys, cfgplan.matching as m; m.REASONERS; "
        "heavy = {'cfgplan.matching.session', 'pyhornedowl', 'owlready2', 'pyoxigraph'} & sys.modules.keys(); "
        "assert not heavy, heavy; [getattr(m, name) for name in m.__all__]"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize("text", ["A and and B", "A and or B", "(A or and B)"])
def test_an_error_shows_the_word_that_was_written(text: str) -> None:
    with pytest.raises(TagError) as caught:
        parse_tag(text, load_ontology([]))
    word, column = caught.value.message.split("'")[1], caught.value.column
    assert word in ("and", "or")
    assert text[column - 1 :].startswith(word)


@pytest.mark.parametrize("name", ["चित्र", "กล้อง", "Cafe\u0301", "می\u200cخواهم"])
def test_names_have_the_vowel_signs_and_accents_of_their_script(name: str) -> None:
    assert parse_tag(f"{name} and at some {name}", OPEN) == parse_tag(f"'{name}' ⊓ ∃at.'{name}'", OPEN)


def test_a_column_is_right_behind_a_name_with_vowel_signs() -> None:
    with pytest.raises(TagError) as caught:
        parse_tag("चित्र )", OPEN)
    assert caught.value.column == 7
