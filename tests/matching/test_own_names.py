"""Names are the user's: no word of the tag language hides a class, an individual or a property of an ontology."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

import cfgplan
from cfgplan.matching import Ontology, TagError, instances, load_ontology, match
from cfgplan.matching.concepts import (
    BOTTOM,
    TOP,
    AtLeast,
    AtMost,
    Concept,
    Named,
    Nominal,
    Only,
    Some,
    conjunction,
    disjunction,
    in_functional_syntax,
    negation,
)
from cfgplan.matching.syntax import parse_tag
from cfgplan.selectors import KEYWORDS

OPEN = load_ontology([])
BUILT_IN = ("Thing", "Nothing")
FREE = ("self", "Self", "inverse", "top", "bottom", "true", "exist", "all")
WORDS = (*sorted(KEYWORDS), *BUILT_IN, *FREE)
Meaning = Callable[[str], Concept]
I_IRI, R_IRI, C_IRI = "n#i", "n#r", "n#C"

PLACES: dict[str, Meaning] = {
    "{0}": lambda word: Named(word),
    "{0} and C": lambda word: conjunction((Named(word), Named(C_IRI))),
    "C and {0}": lambda word: conjunction((Named(word), Named(C_IRI))),
    "C ⊓ {0} ⊓ C": lambda word: conjunction((Named(word), Named(C_IRI))),
    "C or {0}": lambda word: disjunction((Named(word), Named(C_IRI))),
    "({0})": lambda word: Named(word),
    "not {0}": lambda word: negation(Named(word)),
    "¬{0}": lambda word: negation(Named(word)),
    "r some {0}": lambda word: Some(R_IRI, Named(word)),
    "r only {0}": lambda word: Only(R_IRI, Named(word)),
    "r min 2 ({0})": lambda word: AtLeast(2, R_IRI, Named(word)),
    "∃r.{0}": lambda word: Some(R_IRI, Named(word)),
    "∀r.{0}": lambda word: Only(R_IRI, Named(word)),
    "forall r.{0}": lambda word: Only(R_IRI, Named(word)),
    "≥2 r.{0}": lambda word: AtLeast(2, R_IRI, Named(word)),
    "r some ({0} and C)": lambda word: Some(R_IRI, conjunction((Named(word), Named(C_IRI)))),
    "{0}(i)": lambda word: conjunction((Named(word), Some("n#hasSource", Nominal(I_IRI)))),
}
"""A tag with a class of the user's in each place, and what it means."""
PLACES_OF_INDIVIDUALS: dict[str, Meaning] = {
    "{{{0}}}": lambda word: Nominal(word),
    "{{i, {0}}}": lambda word: disjunction((Nominal(I_IRI), Nominal(word))),
    "r value {0}": lambda word: Some(R_IRI, Nominal(word)),
    "C(  {0} )": lambda word: conjunction((Named(C_IRI), Some("n#hasSource", Nominal(word)))),
}
PLACES_OF_ROLES: dict[str, Meaning] = {
    "∃{0}.C": lambda word: Some(word, Named(C_IRI)),
    "∀{0}.C": lambda word: Only(word, Named(C_IRI)),
    "≤2 {0}.C": lambda word: AtMost(2, word, Named(C_IRI)),
    "{0} some C": lambda word: Some(word, Named(C_IRI)),
    "C and {0} only C": lambda word: conjunction((Named(C_IRI), Only(word, Named(C_IRI)))),
    "not ({0} value i)": lambda word: negation(Some(word, Nominal(I_IRI))),
    "{0} min 2 C": lambda word: AtLeast(2, word, Named(C_IRI)),
    "{0} max 2": lambda word: AtMost(2, word, TOP),
}


def own(kind: str, *words: str) -> Ontology:
    names = [f"Declaration({kind}(<n#{word}>))" for word in words]
    others = [("Class", "C"), ("NamedIndividual", "i"), ("ObjectProperty", "r"), ("ObjectProperty", "hasSource")]
    return Ontology([*names, *(f"Declaration({kind}(<n#{name}>))" for kind, name in others)], {"n": "n#"})


CASES = [
    pytest.param(kind, place, meaning, id=place)
    for kind, places in (
        ("Class", PLACES),
        ("NamedIndividual", PLACES_OF_INDIVIDUALS),
        ("ObjectProperty", PLACES_OF_ROLES),
    )
    for place, meaning in places.items()
]
TWO_READINGS = ("not", "{0}(i)")
"""`not(i)` negates."""
JOINING = ("and", "or", "that", "not")
"""Without an ontology two of these in a row are told to be a slip."""


@pytest.mark.parametrize(("kind", "place", "meaning"), CASES)
def test_a_name_of_the_users_is_read_in_every_place(kind: str, place: str, meaning: Meaning) -> None:
    for word in WORDS:
        ontology = own(kind, word)
        expected = meaning(f"n#{word}")
        for written in (f"'{word}'", f"n:{word}", f"<n#{word}>"):
            assert parse_tag(place.format(written), ontology) == expected
        if (word, place) != TWO_READINGS:
            assert parse_tag(place.format(word), ontology) == expected
        assert parse_tag(ontology.render(expected), ontology) == expected


@pytest.mark.parametrize("place", [*PLACES, *PLACES_OF_INDIVIDUALS, *PLACES_OF_ROLES])
def test_without_an_ontology_every_name_is_free(place: str) -> None:
    for word in WORDS:
        concept = parse_tag(place.format(f"'{word}'"), OPEN)
        assert f"<{word}>" in in_functional_syntax(concept)
        assert parse_tag(place.format(f"<{word}>"), OPEN) == concept
        assert parse_tag(OPEN.render(concept), OPEN) == concept
        try:
            read = parse_tag(place.format(word), OPEN)
        except TagError:
            assert word in JOINING
            assert place in PLACES.keys() - {"{0}", "({0})"} | {"C and {0} only C"}
            continue
        assert read == concept or (word, place) == TWO_READINGS


@pytest.mark.parametrize("word", [*sorted(KEYWORDS), "v1.2", "it's", "1", "a-", "名前", "_"])
def test_a_rendered_tag_reads_back_whatever_its_names_are(word: str) -> None:
    iri = f"n#{word}"
    concept = conjunction((Named(iri), Some(iri, Nominal(iri)), negation(Named(iri))))
    axioms = [f"Declaration({kind}(<{iri}>))" for kind in ("Class", "ObjectProperty", "NamedIndividual")]
    for more, prefixes in (([], {}), ([f"Declaration(NamedIndividual(<m#{word}>))"], {"n": "n#"})):
        ontology = Ontology([*axioms, *more], prefixes)
        assert parse_tag(ontology.render(concept), ontology) == concept


@pytest.mark.parametrize("name", ["v1.2", "a/b", "it's", "ros2 topic", "n:x", "a-"])
def test_a_free_name_reads_back_as_it_is_rendered(name: str) -> None:
    concept = conjunction((Named(name), Some("r", Named("B"))))
    assert parse_tag(OPEN.render(concept), OPEN) == concept


@pytest.mark.parametrize("word", sorted(KEYWORDS - {"exists", "forall", "not"}))
def test_a_keyword_that_is_no_name_is_told_how_a_name_is_written(word: str) -> None:
    with pytest.raises(TagError) as caught:
        parse_tag(f"C and {word}", own("Class", "D"))
    assert f"'{word}'" in str(caught.value)


def test_the_words_for_everything_and_nothing_are_built_in_where_no_own_name_is() -> None:
    assert parse_tag("Thing", own("Class", "D")) == TOP
    assert parse_tag("Nothing", own("Class", "D")) == BOTTOM
    for ontology in (OPEN, own("Class", "Thing", "Nothing")):
        assert parse_tag("owl:Thing or owl:Nothing", ontology) == parse_tag("⊤", ontology) == TOP
        assert parse_tag("<http://www.w3.org/2002/07/owl#Nothing>", ontology) == BOTTOM


def test_several_own_names_must_be_told_apart_by_their_prefixes() -> None:
    axioms = ["Declaration(Class(<td#Thing>))", "Declaration(Class(<https://schema.org/Thing>))"]
    ontology = Ontology(axioms, {"td": "td#", "schema": "https://schema.org/"})
    with pytest.raises(TagError, match=r"ambiguous.*write schema:Thing or td:Thing"):
        parse_tag("Thing", ontology)
    assert parse_tag("td:Thing", ontology) == Named("td#Thing")


WOT = """
@prefix td: <https://www.w3.org/2019/wot/td#> . @prefix owl: <http://www.w3.org/2002/07/owl#> .
@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> . @prefix : <urn:home#> .
<urn:home> a owl:Ontology .
td:Thing a rdfs:Class, owl:Class . td:InteractionAffordance a owl:Class . td:Form a owl:Class .
td:PropertyAffordance a owl:Class ; rdfs:subClassOf td:InteractionAffordance .
td:hasInteractionAffordance a owl:ObjectProperty ; rdfs:domain td:Thing ; rdfs:range td:InteractionAffordance .
:Lamp rdfs:subClassOf td:Thing . :Weather a owl:Class . :Lamp a owl:Class .
:lamp1 a :Lamp . :storm a :Weather .
"""
"""The terms of the Web of Things' description that a home uses."""
SCHEMA = """
@prefix schema: <https://schema.org/> . @prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
@prefix rdf: <http://www.w3.org/1999/02/22-rdf-syntax-ns#> . @prefix : <urn:shop#> .
schema:Thing a rdfs:Class . schema:Event a rdfs:Class ; rdfs:subClassOf schema:Thing .
schema:Intangible a rdfs:Class ; rdfs:subClassOf schema:Thing . schema:value a rdf:Property .
schema:about a rdf:Property . :Stock a rdfs:Class . :fair a schema:Event .
"""
"""The terms of schema.org that a shop uses."""


@pytest.mark.parametrize(
    ("written", "things", "thing", "below", "other"),
    [
        (WOT, ("lamp1",), "https://www.w3.org/2019/wot/td#Thing", "Lamp", "Weather"),
        (SCHEMA, ("fair",), "https://schema.org/Thing", "Event", "Stock"),
    ],
)
def test_the_thing_of_a_published_ontology_is_its_own(
    written: str, things: tuple[str, ...], thing: str, below: str, other: str, tmp_path: Path
) -> None:
    (tmp_path / "names.ttl").write_text(written)
    ontology = load_ontology([tmp_path / "names.ttl"])
    assert parse_tag("Thing", ontology) == Named(thing)
    assert instances(ontology, "Thing") == things
    found = match([below, other], ["Thing", "owl:Thing"], ontology).similarity
    assert found.offers == {"Thing": {below}, "owl:Thing": {below, other}}
    (tmp_path / "env.yaml").write_text(
        "format: cfgplan/1\nontology: names.ttl\n"
        f"transformations:\n  - {{label: 'one(${{Thing}})', outputs: {{w: {other}}}}}\n"
        "  - {label: panel, inputs: {t: Thing}}\ntargets: [{label: x, run: panel}]\n"
    )
    world = cfgplan.load(tmp_path / "env.yaml")
    assert [t.label for t in world.environment.library] == [f"one({things[0]})", "panel"]
    assert cfgplan.solve(world)[1].status is cfgplan.Status.INFEASIBLE
