from __future__ import annotations

import pytest
from realistic import realistic_world

from cfgplan.matching import Ontology, explain_match, explanation, justifications, match, near_offers


def test_a_match_is_derived_step_by_step_from_axioms(streams: Ontology) -> None:
    told = explain_match("Undistorted ⊓ ∃hasSource.{cam1}", "Image ⊓ ∃hasSource.Device", streams)
    assert told.matches
    assert set(told.steps) == {
        "{cam1} ⊑ Camera, by ClassAssertion(Camera cam1)",
        "{cam1} ⊑ Device, by SubClassOf(Camera Device)",
        "the offer ⊑ ∃hasSource.Device, as the offer ⊑ ∃hasSource.{cam1} and {cam1} ⊑ Device",
        "the offer ⊑ Image, by SubClassOf(Undistorted Image)",
    }
    assert told.steps.index("{cam1} ⊑ Camera, by ClassAssertion(Camera cam1)") == 0


def test_each_step_needs_its_axiom(streams: Ontology) -> None:
    offered, demanded = "Undistorted ⊓ ∃hasSource.{cam1}", "Image ⊓ ∃hasSource.Device"
    named = [step.partition(", by ")[2] for step in explain_match(offered, demanded, streams).steps]
    for axiom in streams.axioms:
        short = axiom.replace("<w#", "").replace(">", "")
        names = [f"Declaration(Class(<{iri}>))" for iri in streams.classes.values()]
        names += [f"Declaration(NamedIndividual(<{iri}>))" for iri in streams.individuals.values()]
        rest = Ontology([*(streams.axioms - {axiom}), *names], streams.prefixes)
        if not short.startswith("Declaration"):
            assert explain_match(offered, demanded, rest).matches is (short not in named)


def test_a_miss_names_the_conjuncts_that_are_missing(streams: Ontology) -> None:
    told = explain_match("RawRGB", "Image ⊓ Undistorted ⊓ ∃hasSource.Camera", streams)
    assert not told.matches
    assert told.missing == ("Undistorted", "∃hasSource.Camera")
    assert told.lines() == (
        "RawRGB  does not feed  Image ⊓ Undistorted ⊓ ∃hasSource.Camera",
        "  it lacks Undistorted",
        "  it lacks ∃hasSource.Camera",
    )


def test_a_match_that_only_the_reference_finds_names_the_axioms_it_needs(
    streams: Ontology, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(justifications, "EXPLANATION_PATIENCE_S", 600.0)
    told = explain_match("RawRGB", "¬Device", streams)
    assert told.matches
    assert told.steps == (
        "it follows from the axioms listed next, as hermit finds",
        "DisjointClasses(Image Device)",
        "SubClassOf(RawRGB Image)",
    )
    told = explain_match("∀hasSource.Camera", "∀hasSource.(Camera ⊔ Image)", streams)
    assert told.steps == ("it follows from the tags alone, as hermit finds",)


def test_what_could_not_be_decided_is_told_apart(streams: Ontology) -> None:
    told = explain_match("Image", "Camera ⊓ ¬Device", streams, reasoner="el")
    assert (told.missing, told.undecided) == (("Camera",), ("¬Device",))
    assert told.lines()[0] == "Image  does not feed  Camera ⊓ ¬Device"
    told = explain_match("Image", "Image ⊓ ¬Device", streams, reasoner="el")
    assert told.lines()[:2] == ("Image  may feed  Image ⊓ ¬Device", "  not decided yet whether it is ¬Device")
    ((near,),) = near_offers(["Image ⊓ ¬Device"], ["Image"], streams, reasoner="el").values()
    assert (near.missing, near.undecided) == ((), ("¬Device",))
    assert near.verdict == "not decided yet whether it is ¬Device"


def test_the_nearest_offers_lack_least(streams: Ontology) -> None:
    offers = ["RawRGB", "Camera", "RawRGB ⊓ ∃hasSource.{cam1}", "Undistorted"]
    (near,) = near_offers(["Undistorted ⊓ Image ⊓ ∃hasSource.Camera"], offers, streams).values()
    assert [(one.offered, one.missing) for one in near[:2]] == [
        ("RawRGB ⊓ ∃hasSource.{cam1}", ("Undistorted",)),
        ("Undistorted", ("∃hasSource.Camera",)),
    ]


def test_no_demand_has_no_offers_and_needs_no_reasoner(streams: Ontology, monkeypatch: pytest.MonkeyPatch) -> None:
    """`check` of a file without running units once took most of its time for them."""

    def reason(*_: object, **__: object) -> None:
        raise AssertionError("a reasoner is asked")

    monkeypatch.setattr(explanation, "match", reason)
    assert near_offers([], ["Image"], streams) == {}


@pytest.mark.parametrize("seed", range(2))
def test_every_certified_match_of_a_large_world_has_a_derivation(seed: int) -> None:
    world = realistic_world(80, seed)
    offers = match(world.offered, world.demanded, world.ontology, reasoner="el").similarity.offers
    for demanded in [demanded for demanded in world.demanded if offers[demanded]][:5]:
        told = explain_match(min(offers[demanded]), demanded, world.ontology)
        assert told.steps
        assert not any("no derivation" in step for step in told.steps)
