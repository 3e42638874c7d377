"""Tags for who knows no description logic: `suggest`, `ontology new`, and `match` of one port."""

from __future__ import annotations

from pathlib import Path

from command import MODELS, Run

PIFF = MODELS / "nao" / "1-piff-registered.yaml"


def test_suggest_says_why_and_what_would_change(run: Run) -> None:
    result = run("suggest", PIFF, "ball_localization(piff)/position")
    assert result.code == 0
    assert "1. Position ⊓ ∃hasSource.{piff}\n" in result.out
    assert "Position fits position" in result.out
    assert "would no longer match target ball" in result.out
    assert "3. Position ⊓ ∃hasSource.Ball  (as it is)" in result.out


def test_suggest_writes_tags_in_words_where_the_file_does(run: Run) -> None:
    out = run("suggest", MODELS / "building" / "office.yaml", "air_sensor(room101)/co2").out
    assert "Observation and observedProperty value co2 and hasFeatureOfInterest value room101  (as it is)" in out
    assert "3. Observation and observedProperty value co2\n" in out
    assert "∃" not in out


def test_suggest_takes_targets_and_gives_all_ports_as_json(run: Run) -> None:
    assert run("suggest", PIFF, "ball").out.startswith("target ball  now Position")
    ports = run("suggest", PIFF, "--json").document["ports"]
    assert len(ports) == 29
    first = ports["subsampler(piff)/y640"]["suggestions"][0]
    assert first["tag"] == ports["subsampler(piff)/y640"]["tag"] == "Y640X480Image ⊓ ∃hasSource.piff"
    assert (first["gained"], first["lost"]) == ([], [])


def test_a_port_that_is_not_there_is_an_error_that_names_the_nearest(run: Run) -> None:
    for verb in ("suggest", "match"):
        result = run(verb, PIFF, "segmenter(piff)/huls")
        assert result.code == 30
        assert "segmenter(piff)/hull" in result.err


def test_an_environment_without_an_ontology_gets_one_of_the_names_in_use(run: Run, tmp_path: Path) -> None:
    env = tmp_path / "env.yaml"
    text = (
        "format: cfgplan/1\n"
        "transformations:\n"
        "  - {label: camera, outputs: {image: RawImage}}\n"
        "  - {label: finder, inputs: {image: Image}, outputs: {ball: Ball}}\n"
        "targets: [{label: ball, topic: /ball, tag: Ball}]\n"
    )
    env.write_text(text)
    refused = run("suggest", env)
    assert refused.code == 30
    assert "cfgplan ontology new" in refused.err
    assert run("solve", env).code == 10
    made = run("ontology", "new", env, "--out", tmp_path / "env.ttl")
    assert made.code == 0
    env.write_text(text.replace("format: cfgplan/1\n", "format: cfgplan/1\nontology: env.ttl\n"))
    assert run("solve", env).code == 0  # a RawImage is guessed to be an Image
    again = run("ontology", "new", env)
    assert again.code == 30
    assert "already" in again.err


def test_match_of_one_input_lists_all_that_feeds_it_and_of_one_output_all_that_it_feeds(run: Run) -> None:
    fed = run("match", PIFF, "segmenter(piff)/y")
    assert "<- subsampler(piff)/y80" in fed.out
    assert "1 input or target x 20 outputs: 1 of 20 pairs match." in fed.out
    fed = run("match", PIFF, "ball", "--json").document
    assert fed["inputs"] == {
        "target ball": {"tag": "Position ⊓ ∃hasSource.Ball", "outputs": ["ball_localization(piff)/position"]}
    }
    feeds = run("match", PIFF, "subsampler(piff)/y640").out
    assert "ball_detector(piff)/fine" in feeds
    assert "1 input or target x 1 output: 1 of 1 pair matches." in feeds
    nothing = run("match", PIFF, "subsampler(piff)/y40")
    assert "0 inputs and targets x 1 output: there is no pair." in nothing.out
