"""Tags are proposed from names, message types and wires; reasoners say what they would match."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from suggesting import found, with_tags

from cfgplan import api
from cfgplan.domain import (
    ComputationUnit,
    Environment,
    InputPort,
    OutputPort,
    Publication,
    Stream,
    Subscription,
    Transformation,
)
from cfgplan.errors import CfgplanError
from cfgplan.matching import Ontology, load_ontology
from cfgplan.matching import match as match_tags
from cfgplan.matching.suggestions import PortWords, Proposer, words_of
from cfgplan.matching.taxonomy import taxonomy

MODELS = Path(__file__).parents[2] / "models"
STREAMS = Ontology(
    [
        "SubClassOf(<w#RawImage> <w#Image>)",
        "Declaration(Class(<w#Position>))",
        "SubClassOf(<w#Camera> <w#Sensor>)",
        "ClassAssertion(<w#Camera> <w#frontCamera>)",
        "ClassAssertion(<w#Observation> <w#seen>)",
        "Declaration(ObjectProperty(<w#madeBySensor>))",
        "Declaration(ObjectProperty(<w#isSensorOf>))",
    ]
)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("Y80X60Image", ("y", "80", "x", "60", "image")),
        ("YUVImage", ("yuv", "image")),
        ("cmd_vel", ("cmd", "vel")),
        ("sensor_msgs/msg/LaserScan", ("laser", "scan")),
        ("detections", ("detection",)),
        ("MaßÜberLand", ("mass", "über", "land")),
    ],
)
def test_a_name_is_made_of_words(name: str, words: tuple[str, ...]) -> None:
    assert words_of(name) == words


@pytest.mark.parametrize(
    ("own", "label", "meant", "tag"),
    [
        ("image", "front_camera", (), "Image ⊓ ∃madeBySensor.{frontCamera}"),
        ("raw_image", "grabber", (), "RawImage"),
        ("pos", "gps", ("NavSatFix",), "Observation"),
        ("scan", "front_camera", ("sensor_msgs/LaserScan",), "Observation ⊓ ∃madeBySensor.{frontCamera}"),
        ("speed", "wheel", (), None),
    ],
)
def test_the_first_proposal_is_what_words_say(own: str, label: str, meant: tuple[str, ...], tag: str | None) -> None:
    port = PortWords({3.0: [own], 2.0: meant, 1.0: [label]}, meant)
    proposals = Proposer(STREAMS).proposals(port)
    assert (proposals[0].tag if proposals else None) == tag


def test_no_class_of_a_foreign_vocabulary_is_proposed() -> None:
    port = PortWords({3.0: ["image"]})
    assert Proposer(STREAMS).proposals(port)
    assert not Proposer(STREAMS, foreign="w#").proposals(port)


@pytest.mark.parametrize(
    ("world", "least"), [("nao/1-piff-registered.yaml", 20), ("fleet/1-start.yaml", 23), ("shop/1-start.yaml", 14)]
)
def test_most_tags_that_a_person_wrote_are_among_the_first_three_where_all_are_left_out(world: str, least: int) -> None:
    whole = api.load(MODELS / world)
    written = {**whole.environment.outputs, **whole.environment.demands}
    bare = replace(whole, environment=with_tags(whole.environment, dict.fromkeys(written, "⊤")))
    assert sum(place > 0 for place in found(bare, written, [*written]).values()) >= least


def wired(given: str, taken: str) -> Environment:
    """A grabber of images that feeds a viewer."""
    grabber = Transformation("grabber", (), (OutputPort("stream", given),))
    viewer = Transformation("viewer", (InputPort("frames", taken),))
    units = (
        ComputationUnit("grabber.1", "grabber", (), (Publication("stream", "/images"),)),
        ComputationUnit("viewer.1", "viewer", (Subscription("frames", Stream("grabber.1", "stream")),)),
    )
    return Environment(units, (grabber, viewer))


def test_the_tag_of_what_feeds_an_input_is_proposed_first_and_a_topic_counts() -> None:
    world = api.world(wired("RawImage", "⊤"), horizon_s=60, ontology=STREAMS)
    assert api.suggested_tags(world)["viewer/frames"][0].tag == "RawImage"
    bare = api.world(wired("⊤", "⊤"), horizon_s=60, ontology=STREAMS)
    assert [each.tag for each in api.suggested_tags(bare)["grabber/stream"]][:1] == ["Image"]


def test_each_proposal_says_what_would_match_and_what_no_longer() -> None:
    world = api.world(wired("Position", "RawImage"), horizon_s=60, ontology=STREAMS)
    proposals = {each.tag: each for each in api.suggested_tags(world, ["viewer/frames"])["viewer/frames"]}
    assert (proposals["Position"].gained, proposals["Position"].lost) == (("grabber/stream",), ())
    proposals = {each.tag: each for each in api.suggested_tags(world, ["grabber/stream"])["grabber/stream"]}
    assert proposals["RawImage"].gained == ("viewer/frames",)
    world = api.world(wired("RawImage", "Image"), horizon_s=60, ontology=STREAMS)
    proposals = {each.tag: each for each in api.suggested_tags(world, ["grabber/stream"])["grabber/stream"]}
    assert proposals["Image"].lost == ()
    world = api.world(wired("RawImage", "RawImage"), horizon_s=60, ontology=STREAMS)
    proposals = {each.tag: each for each in api.suggested_tags(world, ["grabber/stream"])["grabber/stream"]}
    assert proposals["Image"].lost == ("viewer/frames",)


def test_a_name_that_no_port_has_is_refused() -> None:
    world = api.world(wired("RawImage", "Image"), horizon_s=60, ontology=STREAMS)
    with pytest.raises(CfgplanError, match="grabber/streams"):
        api.suggested_tags(world, ["grabber/streams"])


def test_a_taxonomy_of_names_in_use_reads_as_the_tags_did_and_finds_more(tmp_path: Path) -> None:
    text, left_out = taxonomy(["YUVImage ⊓ ∃hasSource.{cam1}", "Image", "Position", "∃hasSource.⊤"])
    assert not left_out
    (tmp_path / "o.ttl").write_text(text)
    ontology = load_ontology([tmp_path / "o.ttl"])
    assert set(ontology.classes) == {"YUVImage", "Image", "Position"}
    assert set(ontology.individuals) == {"cam1"}  # it stands in { }
    assert set(ontology.property_names.by_short_name) == {"hasSource"}
    found_too = match_tags(["YUVImage ⊓ ∃hasSource.{cam1}", "Position"], ["Image", "∃hasSource.⊤"], ontology)
    assert found_too.similarity.offers["Image"] == {"YUVImage ⊓ ∃hasSource.{cam1}"}
    assert found_too.similarity.offers["∃hasSource.⊤"] == {"YUVImage ⊓ ∃hasSource.{cam1}"}


def test_a_name_that_no_iri_can_end_in_is_left_out_of_a_taxonomy_and_told() -> None:
    text, left_out = taxonomy(["<http://x/a/>", "Image"])
    assert left_out == ("http://x/a/",)
    assert "Image" in text
