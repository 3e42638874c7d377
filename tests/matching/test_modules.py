"""What does not bear on some names can be left out: the same follows about them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from small_worlds import World, small_world

from cfgplan import api
from cfgplan.errors import InputError
from cfgplan.matching import Matcher, Ontology, hermit, match
from cfgplan.matching.engine import FastEngine
from cfgplan.matching.modules import Modules, names_in
from cfgplan.matching.reference import classify
from cfgplan.matching.syntax import parse_tag
from cfgplan.planning import Plan, Status

worlds = st.builds(
    lambda seed, outside, far: small_world(seed, 16, outside=outside, far=far),
    st.integers(0, 10**6),
    st.sampled_from((0.0, 0.3, 0.6)),
    st.booleans(),
)


def module_of(axioms: Iterable[str], names: str) -> set[str]:
    """The axioms that bear on some names."""
    found = Modules(Ontology(axioms)).of(f"w#{name}" for name in names.split())
    return {*found.ontology.axioms}


@pytest.mark.parametrize(
    ("names", "bearing", "idle"),
    [
        ("A B", ["SubClassOf(<w#A> <w#B>)"], ["SubClassOf(<w#C> <w#A>)", "SubClassOf(<w#B> <w#D>)"]),
        ("A C", ["SubClassOf(<w#A> <w#B>)", "SubClassOf(<w#B> <w#C>)"], ["DisjointClasses(<w#B> <w#D>)"]),
        ("A", [], ["ClassAssertion(<w#B> <w#i>)", "ObjectPropertyAssertion(<w#r> <w#i> <w#j>)"]),
        ("A", ["ClassAssertion(<w#A> <w#i>)"], ['DataPropertyAssertion(<w#p> <w#i> "1")']),
        (
            "A",
            ["ClassAssertion(<w#B> <w#i>)", "SubClassOf(<w#B> <w#A>)"],
            ["ObjectPropertyDomain(<w#r> <w#A>)", "TransitiveObjectProperty(<w#r>)"],
        ),
        (
            "A r",
            ["ObjectPropertyDomain(<w#r> <w#A>)", "TransitiveObjectProperty(<w#r>)"],
            ["SubObjectPropertyOf(<w#r> <w#s>)", "InverseObjectProperties(<w#t> <w#s>)"],
        ),
        ("A", ["FunctionalObjectProperty(<w#r>)", "ObjectPropertyAssertion(<w#r> <w#i> <w#j>)"], []),
        ("A", ["SubClassOf(<http://www.w3.org/2002/07/owl#Thing> ObjectOneOf(<w#i>))"], ["SubClassOf(<w#A> <w#B>)"]),
        ("A", [], ["SubClassOf(<w#A> ObjectSomeValuesFrom(<w#r> <w#B>))", "ReflexiveObjectProperty(<w#s>)"]),
        ("A", [], ["SubClassOf(<w#A> ObjectMinCardinality(0 <w#r> <w#A>))"]),
        ("A r", ["SubClassOf(<w#A> ObjectMinCardinality(2 <w#r> <w#B>))"], []),
        ("A", ["SubClassOf(<w#A> ObjectComplementOf(<w#A>))"], ["SubClassOf(<w#A> ObjectComplementOf(<w#B>))"]),
    ],
)
def test_a_module_has_what_bears_on_its_names(names: str, bearing: list[str], idle: list[str]) -> None:
    assert module_of([*bearing, *idle], names) == {*bearing}


def rule(body: str, head: str) -> str:
    """A rule about x and y; atoms are separated by spaces, such as `A.x r.x.y`."""

    def atom(text: str) -> str:
        name, *variables = text.split(".")
        kind = "ClassAtom" if len(variables) == 1 else "ObjectPropertyAtom"
        return f"{kind}(<w#{name}> {' '.join(f'Variable(<u:{v}>)' for v in variables)})"

    return f"DLSafeRule(Body({' '.join(map(atom, body.split()))}) Head({' '.join(map(atom, head.split()))}))"


@pytest.mark.parametrize(
    ("names", "axioms", "bears"),
    [
        ("A B", [], True),
        ("A C", [], False),  # B may be what all is
        ("B C", [], False),  # A may be what nothing is
        ("A C", ["SubClassOf(<w#B> <w#C>)"], True),
        ("B C", ["ClassAssertion(<w#A> <w#i>)"], True),
        ("C D", ["ClassAssertion(<w#A> <w#i>)", "DisjointClasses(<w#B> <w#C>)"], True),
        ("C D", ["ClassAssertion(<w#A> <w#i>)", "SubClassOf(<w#C> <w#B>)"], False),
    ],
)
def test_a_lost_rule_bears_on_what_it_may_make_match(names: str, axioms: list[str], bears: bool) -> None:
    ontology = Ontology(axioms, dropped={"a rule": "lost"}, lost_rules=[("a rule", rule("A.x", "B.x"))])
    assert bool(Modules(ontology).of(f"w#{name}" for name in names.split()).rules) is bears


MISSION = """
@prefix : <http://tomasys.example/#> . @prefix owl: <http://www.w3.org/2002/07/owl#> .
@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> . @prefix swrl: <http://www.w3.org/2003/11/swrl#> .
@prefix xsd: <http://www.w3.org/2001/XMLSchema#> .
: a owl:Ontology . :x a swrl:Variable . :y a swrl:Variable .
:Objective a owl:Class . :Grounding a owl:Class . :Component a owl:Class ; owl:disjointWith :Objective .
:Camera a owl:Class ; rdfs:subClassOf :Component . :Sensing a owl:Class ; rdfs:subClassOf :Objective .
:Failed a owl:Class .
:solves a owl:ObjectProperty ; rdfs:domain :Grounding ; rdfs:range :Objective .
:status a owl:DatatypeProperty , owl:FunctionalProperty ; rdfs:domain :Grounding ; rdfs:range xsd:string .
:objective_status a owl:DatatypeProperty , owl:FunctionalProperty ; rdfs:domain :Objective .
:sense a :Sensing . :grounding a :Grounding ; :solves :sense .
[] a swrl:Imp ; swrl:body ( [ a swrl:IndividualPropertyAtom ; swrl:propertyPredicate :solves ;
    swrl:argument1 :x ; swrl:argument2 :y ] [ a swrl:DatavaluedPropertyAtom ; swrl:propertyPredicate :status ;
    swrl:argument1 :x ; swrl:argument2 "ERROR" ] ) ;
  swrl:head ( [ a swrl:DatavaluedPropertyAtom ; swrl:propertyPredicate :objective_status ;
    swrl:argument1 :y ; swrl:argument2 "ERROR" ] ) .
"""
"""An ontology of the shape of TOMASys: rules make statuses, data properties with a domain, of statuses."""
FAILING = """
[] a swrl:Imp ; swrl:body ( [ a swrl:IndividualPropertyAtom ; swrl:propertyPredicate :solves ;
    swrl:argument1 :x ; swrl:argument2 :y ] ) ;
  swrl:head ( [ a swrl:ClassAtom ; swrl:classPredicate :Failed ; swrl:argument1 :y ] ) .
"""


@pytest.fixture
def solve(tmp_path: Path) -> Callable[..., api.World]:
    """An environment of tags from a mission's ontology."""

    def world(ontology: str, *, offered: str, demanded: str, rules: str = "") -> api.World:
        (tmp_path / "mission.ttl").write_text(ontology)
        (tmp_path / "env.yaml").write_text(
            "format: cfgplan/1\nontology: mission.ttl\n"
            f"{rules}"
            f"transformations:\n  - {{label: cheap, labor: 1, outputs: {{o: '{offered}'}}}}\n"
            f"  - {{label: sure, labor: 2, outputs: {{o: '{demanded}'}}}}\n"
            f"targets: [{{label: t, topic: /t, tag: '{demanded}'}}]\n"
        )
        return api.load(tmp_path / "env.yaml")

    return world


def planned(world: api.World) -> tuple[Plan, tuple[str, ...]]:
    """The plan, and the warnings about matching."""
    matches = api.matches(world, use_cache=False)
    warnings = matches.matching.warnings
    _, plan = api.solved(api.problem(world, matches.similarity), matches)
    return plan, warnings


@pytest.mark.parametrize(
    ("offered", "demanded"), [("Camera", "Sensing"), ("Objective", "Sensing"), ("{sense}", "∃solves.Sensing")]
)
def test_a_plan_is_optimal_where_no_lost_rule_can_make_a_match(
    solve: Callable[..., api.World], offered: str, demanded: str
) -> None:
    world = solve(MISSION, offered=offered, demanded=demanded)
    assert any("rule" in text for text in world.ontology.dropped)
    plan, _ = planned(world)
    assert (plan.status, plan.cost_us) == (Status.OPTIMAL, 2_000_000)


def test_the_rule_that_stands_in_the_way_is_named_and_can_be_ignored(solve: Callable[..., api.World]) -> None:
    world = solve(MISSION + FAILING, offered="Sensing", demanded="Failed")
    plan, told = planned(world)
    assert (plan.status, plan.cost_us) == (Status.FEASIBLE, 2_000_000)
    assert any("the rule solves(x, y) → Failed(y) in mission.ttl may make them match" in text for text in told)
    assert not any("ERROR" in text for text in told if "may make them match" in text)
    world = solve(MISSION + FAILING, offered="Sensing", demanded="Failed", rules="rules: ignore\n")
    plan, told = planned(world)
    assert (plan.status, plan.cost_us) == (Status.OPTIMAL, 2_000_000)
    assert "2 rules are ignored: tags that match only by them do not match" in told


@settings(max_examples=60, deadline=None)
@given(worlds)
def test_the_fast_engine_finds_the_same_matches_in_the_module_of_the_tags(world: World) -> None:
    offered, demanded = ([parse_tag(tag, world.ontology) for tag in tags] for tags in (world.offered, world.demanded))
    module = Modules(world.ontology).of(names_in((*offered, *demanded))).ontology
    whole, part = (FastEngine(trees) for trees in (world.ontology.trees, module.trees))
    if whole.is_inconsistent or part.is_inconsistent:
        return
    found, found_too = (engine.rows(offered, demanded) for engine in (whole, part))
    for demand in demanded:
        for offer in offered:
            if offer in found.impossible or offer in found_too.impossible:
                continue
            if offer in found.met[demand]:
                is_open = offer in found_too.uncertified or demand in found_too.beyond_words
                assert offer in found_too.met[demand] or is_open
            if offer in found_too.met[demand]:
                is_open = offer in found.uncertified or demand in found.beyond_words
                assert offer in found.met[demand] or is_open


@pytest.mark.parametrize("seed", range(12))
def test_hermit_classifies_the_tags_in_their_module_as_in_the_whole_ontology(seed: int) -> None:
    world = small_world(4000 + seed, 16, outside=0.5, far=seed % 2 == 0)
    offered, demanded = ([parse_tag(tag, world.ontology) for tag in tags] for tags in (world.offered, world.demanded))
    module = Modules(world.ontology).of(names_in((*offered, *demanded))).ontology
    answers = []
    for ontology in (world.ontology, module):
        try:
            answers.append(classify(hermit, ontology, offered, demanded, 60.0))
        except InputError as error:
            answers.append(str(error))
        except hermit.ReasonerError as error:
            answers.append(error.message)
    assert answers[0] == answers[1]


@settings(max_examples=25, deadline=None)
@given(worlds)
def test_tags_that_come_later_match_as_if_they_had_been_there(world: World) -> None:
    half = len(world.offered) // 2
    matcher = Matcher(world.ontology, reasoner="el")
    try:
        matcher.add(offered=world.offered[:half], demanded=world.demanded[:1])
        matcher.matching()
        matcher.add(offered=world.offered[half:], demanded=world.demanded[1:])
        later = matcher.matching().similarity
        at_once = match(world.offered, world.demanded, world.ontology, reasoner="el").similarity
    except InputError:
        return
    for demanded in world.demanded:
        for offered in world.offered:
            if not later.is_open(offered, demanded) and not at_once.is_open(offered, demanded):
                assert later.holds(offered, demanded) is at_once.holds(offered, demanded)
