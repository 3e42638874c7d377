"""What a finite model shows not to match, and that only models are believed."""

from __future__ import annotations

import random

import pytest
from crosscheck import compare
from small_worlds import small_world

from cfgplan.matching import Matcher, Ontology, match
from cfgplan.matching.countermodels import Countermodels
from cfgplan.matching.functional import parse
from cfgplan.matching.structures import Interpretation, checks_of
from cfgplan.matching.syntax import parse_tag

NAMES = [
    *(f"Declaration(Class(<w#{name}>))" for name in "ABCD"),
    *(f"Declaration(ObjectProperty(<w#{role}>))" for role in "rstu"),
    *(f"Declaration(NamedIndividual(<w#{name}>))" for name in "ab"),
]


def is_refuted(axioms: list[str], offered: str, demanded: str) -> bool:
    """Whether a model of all axioms, those that bear on nothing too, shows that a tag does not meet another."""
    ontology = Ontology([*axioms, *NAMES])
    models = Countermodels(ontology)
    tags = parse_tag(offered, ontology), parse_tag(demanded, ontology)
    models.build(tags[:1], tags[1:], None)
    return tags[0] in models.refuted(tags[1])


@pytest.mark.parametrize(
    ("axioms", "offered", "demanded"),
    [
        (["AsymmetricObjectProperty(<w#r>)", "IrreflexiveObjectProperty(<w#r>)"], "∃r.A", "∃r.B"),
        (["AsymmetricObjectProperty(<w#r>)", "SubClassOf(<w#A> ObjectSomeValuesFrom(<w#r> <w#A>))"], "A", "∃r.B"),
        (["InverseObjectProperties(<w#r> <w#s>)"], "A ⊓ ∃r.B", "∃r.(B ⊓ ∃s.C)"),
        (["SubClassOf(<w#A> ObjectUnionOf(<w#B> <w#C>))"], "A", "B"),
        (["SubClassOf(<w#A> ObjectUnionOf(<w#B> <w#C>))"], "A", "C"),
        (["SubClassOf(<w#A> ObjectUnionOf(<w#B> <w#C>))", "DisjointClasses(<w#A> <w#B>)"], "A", "B"),
        (["SubClassOf(<w#A> ObjectAllValuesFrom(<w#r> <w#B>))"], "A ⊓ ∃r.C", "∃r.D"),
        (["FunctionalObjectProperty(<w#r>)"], "∃r.A ⊓ ∃r.B", "∃r.C"),
        (["SameIndividual(<w#a> <w#b>)", "ClassAssertion(<w#A> <w#a>)"], "∃r.{b}", "∃r.B"),
        (["SubClassOf(<w#A> ObjectOneOf(<w#a> <w#b>))"], "A", "B"),
        (["SubClassOf(<w#A> ObjectMinCardinality(2 <w#r> <w#B>))"], "A", "≥3 r.B"),
        (["SubClassOf(<w#A> ObjectHasSelf(<w#r>))"], "A", "∃s.A"),
        (["SymmetricObjectProperty(<w#r>)", "DisjointObjectProperties(<w#r> <w#s>)"], "∃r.A", "∃s.A"),
        (["FunctionalDataProperty(<w#p>)", 'DataPropertyAssertion(<w#p> <w#a> "1")'], "{a}", "A"),
        ([], "¬A", "B"),
        ([], "A", "¬B"),
        ([], "{a}", "¬B"),
        ([], "A ⊓ ∃r.B", "∀r.B"),
        ([], "∃r.{a}", "¬∃r.B"),
        (["SubClassOf(<w#A> ObjectMinCardinality(2 <w#r> <w#B>))"], "A", "≤2 r.B"),
        (["SubClassOf(<w#A> ObjectComplementOf(<w#C>))"], "A", "¬(B ⊔ C)"),
    ],
)
def test_a_model_shows_what_does_not_match(axioms: list[str], offered: str, demanded: str) -> None:
    assert is_refuted(axioms, offered, demanded)
    assert not match([offered], [demanded], Ontology([*axioms, *NAMES]), reasoner="el").similarity.open


def test_each_of_several_negative_demands_is_refuted_where_no_model_refutes_all_of_them() -> None:
    ontology = Ontology(["DisjointClasses(<w#B> <w#C>)", "SubClassOf(<w#D> <w#B>)", *NAMES])
    matcher = Matcher(ontology, reasoner="el")
    matcher.add(offered=["A", "{a}"], demanded=["¬B", "¬C"])
    assert not matcher.matching().similarity.open
    matcher.add(demanded=["¬D"])
    matcher.add(offered=["{b}", "D"])
    found = matcher.matching().similarity
    assert list(found.open_pairs()) == [("D", "¬C")]
    assert not any(offers for offers in found.offers.values())


@pytest.mark.parametrize(
    ("axioms", "offered", "demanded"),
    [
        (["AsymmetricObjectProperty(<w#r>)", "SymmetricObjectProperty(<w#r>)"], "∃r.A", "B"),
        (["SubClassOf(<w#A> ObjectUnionOf(<w#B> <w#C>))", "DisjointClasses(<w#A> <w#B>)"], "A", "C"),
        (["SubClassOf(<w#A> ObjectMaxCardinality(0 <w#r>))", "SubClassOf(<w#A> ObjectSomeValuesFrom(<w#r> <w#B>))"],
         "A", "C"),
        (["SubClassOf(<w#A> ObjectSomeValuesFrom(owl:topObjectProperty <w#B>))".replace(
            "owl:topObjectProperty", "<http://www.w3.org/2002/07/owl#topObjectProperty>")], "A", "C"),
        (["DLSafeRule(Body(ClassAtom(<w#A> Variable(<u:x>))) Head(ClassAtom(<w#B> Variable(<u:x>))))"], "A", "B"),
    ],
)  # fmt: skip
def test_only_what_a_model_shows_is_refuted(axioms: list[str], offered: str, demanded: str) -> None:
    assert not is_refuted(axioms, offered, demanded)


@pytest.mark.parametrize(
    ("axiom", "holds"),
    [
        ("SubClassOf(<A> ObjectSomeValuesFrom(<r> <B>))", True),
        ("SubClassOf(<A> ObjectSomeValuesFrom(<r> <A>))", False),
        ("SubClassOf(<A> ObjectAllValuesFrom(<r> <B>))", True),
        ("SubClassOf(<A> ObjectMinCardinality(2 <r> <B>))", False),
        ("SubClassOf(<A> ObjectMaxCardinality(1 <r>))", True),
        ("SubClassOf(<B> ObjectComplementOf(<A>))", True),
        ("SubClassOf(<A> ObjectHasSelf(<r>))", False),
        ("SubClassOf(<B> ObjectSomeValuesFrom(ObjectInverseOf(<r>) <A>))", True),
        ("SubClassOf(<A> ObjectHasValue(<r> <b>))", True),
        ("SubClassOf(<A> DataHasValue(<p> \"1\"))", True),
        ("SubClassOf(<A> DataSomeValuesFrom(<p> <http://www.w3.org/2001/XMLSchema#integer>))", False),
        ("EquivalentClasses(<B> ObjectOneOf(<b>))", True),
        ("DisjointClasses(<A> <B>)", True),
        ("DisjointClasses(<A> owl:Thing)".replace("owl:Thing", "<http://www.w3.org/2002/07/owl#Thing>"), False),
        ("DisjointUnion(<http://www.w3.org/2002/07/owl#Thing> <A> <B>)", True),
        ("AsymmetricObjectProperty(<r>)", True),
        ("SymmetricObjectProperty(<r>)", False),
        ("ReflexiveObjectProperty(<r>)", False),
        ("IrreflexiveObjectProperty(<r>)", True),
        ("TransitiveObjectProperty(<r>)", True),
        ("FunctionalObjectProperty(<r>)", True),
        ("InverseObjectProperties(<r> <r>)", False),
        ("DisjointObjectProperties(<r> <s>)", True),
        ("DisjointObjectProperties(<r> <r>)", False),
        ("SubObjectPropertyOf(<r> <s>)", False),
        ("SubObjectPropertyOf(ObjectPropertyChain(<r> <r>) <s>)", True),
        ("ObjectPropertyDomain(<r> <A>)", True),
        ("ObjectPropertyDomain(<r> <B>)", False),
        ("ObjectPropertyRange(<r> <B>)", True),
        ("ObjectPropertyRange(<r> <A>)", False),
        ("ClassAssertion(<B> <b>)", True),
        ("ClassAssertion(<A> <b>)", False),
        ("ObjectPropertyAssertion(<r> <a> <b>)", True),
        ("ObjectPropertyAssertion(<r> <b> <a>)", False),
        ("NegativeObjectPropertyAssertion(<r> <b> <a>)", True),
        ("NegativeObjectPropertyAssertion(<r> <a> <b>)", False),
        ("SameIndividual(<a> <b>)", False),
        ("DifferentIndividuals(<a> <b>)", True),
        ("DataPropertyRange(<p> <http://www.w3.org/2001/XMLSchema#string>)", True),
        ("DataPropertyRange(<p> <http://www.w3.org/2001/XMLSchema#integer>)", False),
        ("FunctionalDataProperty(<p>)", True),
        ("NegativeDataPropertyAssertion(<p> <a> \"2\")", False),
        ("HasKey(<A> () (<p>))", False),
    ],
)  # fmt: skip
def test_a_structure_of_two_linked_things_tells_which_axioms_hold(axiom: str, holds: bool) -> None:
    structure = Interpretation()
    a, b = structure.add_thing(), structure.add_thing()
    structure.individuals |= {"a": a, "b": b}
    structure.put("A", {a})
    structure.put("B", {b})
    structure.link("r", a, b)
    structure.give("p", a, '"1"')
    assert (not any(map(structure.broken, checks_of(parse(axiom))))) is holds


@pytest.mark.parametrize("seed", [0, 2, 8, 11, 12])  # of others nothing is open, or they contradict themselves
def test_engine_models_and_questions_agree_with_what_hermit_classifies_far_outside_the_fragment(seed: int) -> None:
    found = compare(small_world(seed, 24, outside=0.6, far=True))
    assert found["false positives"] == found["certified misses"] == 0
    assert found["asked one by one"]


@pytest.mark.parametrize("seed", [1, 3, 5])  # the others contradict themselves
def test_models_of_a_matcher_that_lived_on_say_what_those_of_a_fresh_one_may_say(seed: int) -> None:
    rng = random.Random(seed)
    world = small_world(100 + seed, 24, outside=0.4)
    matcher = Matcher(world.ontology, reasoner="el")
    some = world.offered[::2]
    matcher.add(offered=some, demanded=world.demanded[::2])
    matcher.matching()
    matcher.add(offered=world.offered[1::2], demanded=world.demanded[1::2])
    gone = rng.sample(world.offered, len(world.offered) // 3)
    matcher.remove(offered=gone)
    similarity = matcher.matching().similarity
    found = match(world.offered, world.demanded, world.ontology, time_limit_s=20)
    truth = found.similarity
    impossible = found.impossible
    for demanded in world.demanded:
        for offered in set(world.offered) - set(gone) - impossible:
            if not similarity.is_open(offered, demanded) and not truth.is_open(offered, demanded):
                assert similarity.holds(offered, demanded) is truth.holds(offered, demanded)
