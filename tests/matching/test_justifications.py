"""The axioms of an explanation, checked by HermiT: it follows from all of them together, and from no fewer."""

from __future__ import annotations

import random
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import pytest
from small_worlds import NAMESPACE, small_world

from cfgplan.errors import InputError
from cfgplan.matching import (
    MatchExplanation,
    Matching,
    Ontology,
    explain_match,
    explanation,
    hermit,
    justifications,
    match,
)
from cfgplan.matching.concepts import BOTTOM, Concept, conjunction, in_functional_syntax, negation
from cfgplan.matching.expressions import concept_of
from cfgplan.matching.functional import parse
from cfgplan.matching.reference import first_answered, satisfiable
from cfgplan.matching.syntax import parse_tag


@pytest.fixture(autouse=True)
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a busy computer HermiT takes seconds for an answer; explanations are minimal only if time suffices."""
    monkeypatch.setattr(justifications, "EXPLANATION_PATIENCE_S", 600.0)


@dataclass(frozen=True)
class Claim:
    """That nothing can have a concept, by some axioms."""

    concept: Concept
    axioms: tuple[str, ...]

    def in_world(self, number: int, without: str | None) -> tuple[Concept, list[str]]:
        """The claim over names of its own, without one of its axioms."""
        own = f"http://w{number}.example/#"
        concept = parse(in_functional_syntax(self.concept).replace(NAMESPACE, own))
        return concept_of(concept), [axiom.replace(NAMESPACE, own) for axiom in self.axioms if axiom != without]


def claim_of(told: MatchExplanation, ontology: Ontology) -> Claim:
    offered, demanded = parse_tag(told.offered, ontology), parse_tag(told.demanded, ontology)
    return Claim(conjunction((offered, negation(BOTTOM if told.is_impossible else demanded))), told.axioms)


def check(claims: list[Claim]) -> None:
    """All claims are checked in one call: no name is in two of them, and none of their axioms is about everything."""
    questions: dict[Concept, tuple[Claim, str | None]] = {}
    axioms: list[str] = []
    for claim in claims:
        for without in (None, *claim.axioms):
            concept, left = claim.in_world(len(questions), without)
            questions[concept] = claim, without
            axioms += left
    possible = satisfiable(hermit, Ontology(axioms), questions, None)
    for concept, (claim, without) in questions.items():
        assert possible[concept] is (without is not None), (claim, without)


def check_alone(claim: Claim) -> None:
    """Check a claim by ontologies of its own: those that lack an axiom, and the whole, which alone denies it."""
    parts = [[axiom for axiom in claim.axioms if axiom != without] for without in claim.axioms]
    ontologies = map(Ontology, (*parts, claim.axioms))
    denied = first_answered(hermit, ontologies, claim.concept, lambda: None, lambda answer: answer is not True)
    assert denied == len(claim.axioms)


def with_literals_and_inverses(ontology: Ontology, seed: int) -> Ontology:
    """With values, hierarchies of roles and inverses, of which the engine's rules hold several at once."""
    rng = random.Random(seed)
    classes, roles = (
        sorted({iri for iri in names if iri.startswith(NAMESPACE)})
        for names in (ontology.classes.values(), ontology.property_names.by_short_name.values())
    )
    one, other, third = (rng.choice(classes) for _ in range(3))
    role = rng.choice(roles)
    new = [f"{NAMESPACE}{name}" for name in ("d", "e", "back", "high", "higher", "b0", "b1")]
    d, e, back, high, higher, b0, b1 = (f"<{name}>" for name in new)
    more = [
        f"SubDataPropertyOf({d} {e})",
        f"DataPropertyDomain({e} <{one}>)",
        f'DataPropertyAssertion({d} {b0} "1"^^<http://www.w3.org/2001/XMLSchema#integer>)',
        f'DataPropertyAssertion({e} {b1} "x")',
        f"InverseObjectProperties({back} <{role}>)",
        f"ObjectPropertyDomain({back} <{other}>)",
        f"ObjectPropertyAssertion({back} {b0} {b1})",
        f"SubObjectPropertyOf(<{role}> {high})",
        f"SubObjectPropertyOf({high} {higher})",
        f"ObjectPropertyRange({higher} <{third}>)",
    ]
    return Ontology([*ontology.axioms, *rng.sample(more, rng.randint(6, len(more)))], ontology.prefixes)


def explained(offer: str, demand: str, ontology: Ontology) -> MatchExplanation:
    """Explain a match that the fast engine finds: HermiT is not asked about it again, only about its axioms."""

    def found(*tags: Any, **more: Any) -> Matching:
        return match(*tags, **{**more, "reasoner": "el"})

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(explanation, "match", found)
        return explain_match(offer, demand, ontology)


def explanations(seed: int, most: int, *, outside: float = 0.2) -> Iterator[Claim]:
    """Explanations of matches that the fast engine finds in a random world, and of impossible tags."""
    world = small_world(seed, 60, outside=outside)
    ontology = with_literals_and_inverses(world.ontology, seed)
    extra = [
        f"∃{role}.{name}"
        for role in ("higher", "high")
        for name in ontology.classes
        if role in ontology.property_names.by_short_name
    ]
    individuals = [f"{{{name}}}" for name in ontology.individuals]
    offered = [
        *world.offered,
        *individuals,
        *ontology.classes,
        *(f"∃{role}.⊤" for role in ontology.property_names.by_short_name),
    ]
    demanded = [*world.demanded, *ontology.classes, *extra]
    try:
        found = match(offered, demanded, ontology, reasoner="el")
    except InputError:  # it contradicts itself
        return
    pairs = [
        (offer, demand) for demand, offers in found.similarity.offers.items() for offer in offers if offer != demand
    ]
    pairs += [(tag, demanded[0]) for tag in found.impossible]
    for offer, demand in random.Random(seed).sample(sorted(pairs), min(most, len(pairs))):
        yield claim_of(explained(offer, demand, ontology), ontology)


@pytest.mark.parametrize("seed", range(6))
def test_a_derivation_names_all_axioms_that_it_takes_and_no_other(seed: int) -> None:
    claims = [claim for number in range(3) for claim in explanations(100 * seed + number, 10)]
    assert sum(len(claim.axioms) > 1 for claim in claims) > 2
    check(claims)


def test_a_derivation_names_what_the_rules_of_the_engine_hold_at_once() -> None:
    axioms = {
        "InverseObjectProperties(<back> <r>)", "ObjectPropertyDomain(<back> <C>)", "SubObjectPropertyOf(<r> <high>)",
        "SubObjectPropertyOf(<high> <higher>)", "SubDataPropertyOf(<d> <e>)", "DataPropertyDomain(<e> <B>)",
        'DataPropertyAssertion(<d> <b> "x")', "ObjectPropertyAssertion(<back> <b> <c>)",
    }  # fmt: skip
    ontology = Ontology([*axioms, "SubClassOf(<A> <C>)", 'DataPropertyAssertion(<d> <c> "x")'])
    told = explain_match("{c}", "∃higher.(B ⊓ C)", ontology)
    assert told.matches
    assert set(told.axioms) == axioms
    check_alone(claim_of(told, ontology))


def test_what_hermit_finds_is_justified_by_all_axioms_that_are_named_and_by_no_fewer(streams: Ontology) -> None:
    value = '"2"^^<http://www.w3.org/2001/XMLSchema#integer>'
    more = [
        "SubClassOf(<w#Stereo> ObjectAllValuesFrom(<w#hasSource> <w#Camera>))",
        "SubClassOf(<w#Stereo> <w#Image>)",
        "DisjointClasses(<w#Camera> <w#Lidar>)",
        "DataPropertyAssertion(<w#eyes> <w#cam1> " + value + ")",
        f"SubClassOf(DataHasValue(<w#eyes> {value}) <w#Pair>)",
    ]
    ontology = Ontology([*streams.axioms, *more], streams.prefixes)
    told = {
        pair: explain_match(*pair, ontology)
        for pair in (("Stereo ⊓ ∃hasSource.Lidar", "Image"), ("RawRGB", "¬Device"), ("{cam1}", "Pair"))
    }
    assert [one.is_impossible for one in told.values()] == [True, False, False]
    assert any("DataPropertyAssertion" in axiom for axiom in told["{cam1}", "Pair"].axioms)
    for one in told.values():
        check_alone(claim_of(one, ontology))


def test_an_impossible_tag_is_explained_by_the_axioms_that_forbid_it(streams: Ontology) -> None:
    told = explain_match(
        "Image ⊓ ∃hasSource.Lidar ⊓ Camera", "Image", Ontology([*streams.axioms, "Declaration(Class(<w#Lidar>))"])
    )
    assert told.lines() == (
        "Image ⊓ ∃hasSource.Lidar ⊓ Camera  does not feed  Image",
        "  nothing can be Image ⊓ ∃hasSource.Lidar ⊓ Camera, so that no unit may give it",
        "  because the offer ⊑ Device, by SubClassOf(Camera Device)",
        "  because the offer ⊑ ⊥, by DisjointClasses(Image Device)",
    )
