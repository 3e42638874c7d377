"""From what came from a broker to an environment: forms, periods, tags, what is told and what is left out."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

import cfgplan
from cfgplan.errors import InputError
from cfgplan.mqtt.environments import MqttImported, mqtt_imported
from cfgplan.mqtt.traffic import Traffic, TrafficCollector

Messages = Mapping[str, list[bytes]]


def heard(messages: Messages, discovery: Mapping[str, Any] | None = None) -> Traffic:
    """What is known after messages that come once a second."""
    collector = TrafficCollector()
    for topic, said in (discovery or {}).items():
        collector.take(f"homeassistant/{topic}/config", json.dumps(said).encode(), is_retained=True, time_s=0)
    for topic, payloads in messages.items():
        for second, payload in enumerate(payloads):
            collector.take(topic, payload, is_retained=False, time_s=second)
    return collector.traffic("house:1883", 10)


def made(messages: Messages, discovery: Mapping[str, Any] | None = None) -> MqttImported:
    return mqtt_imported(heard(messages, discovery), {"broker": "house:1883"})


def loaded(found: MqttImported, folder: Path, more: str = "") -> cfgplan.World:
    (folder / "env.ttl").write_text(found.ontology)
    (folder / "env.yaml").write_text(found.text("env.ttl") + more)
    return cfgplan.load(folder / "env.yaml")


@pytest.mark.parametrize(
    ("payloads", "form"),
    [
        ([b"20.5", b"-1e3"], "number"),
        ([b"20", b"unavailable"], "text"),
        ([b"nan"], "text"),
        ([b'{"a": 1}', b"[2]"], "json"),
        ([b"3", b'{"a": 1}'], "json"),
        ([b"true"], "json"),
        ([b"ON", b'{"a": 1}'], "text"),
        ([b"\xff\xd8"], "bytes"),
        ([b"ON", b"a\0b"], "bytes"),
        ([b"[" * 100_000], "text"),
    ],
)
def test_a_topic_has_the_form_that_takes_all_its_messages_in(payloads: list[bytes], form: str) -> None:
    (topic,) = heard({"x": payloads}).topics
    assert topic.form == form


def test_a_period_is_measured_between_live_messages_alone() -> None:
    collector = TrafficCollector()
    collector.take("x", b"1", is_retained=True, time_s=0)
    collector.take("once", b"1", is_retained=False, time_s=1)
    for time_s in (7, 9, 11):
        collector.take("x", b"333", is_retained=True, time_s=time_s)
    once, x = collector.traffic("b", 12).topics
    assert (x.period_s, x.is_retained, x.size) == (2, True, 2)
    assert (once.period_s, once.is_retained) == (None, False)


def test_a_retained_message_that_is_taken_back_is_no_topic() -> None:
    assert heard({"x": [b""]}).topics == ()


def test_a_source_subscribes_to_its_topic(tmp_path: Path) -> None:
    found = made({"house/kitchen/door": [b"open", b"shut"]})
    (transformation,) = loaded(found, tmp_path).environment.library
    assert transformation.source == "cfgplan_runtime.mqtt:Subscriber"
    assert dict(transformation.params) == {
        "broker": "house:1883",
        "topic": "house/kitchen/door",
        "payload": "text",
        "retained": False,
    }
    (output,) = transformation.outputs
    assert (output.rate_uhz, output.size_bytes) == (1_000_000, 4)


def matches(found: MqttImported, tag: str, folder: Path) -> list[str]:
    """The labels of the sources that give what a tag says."""
    more = f"targets:\n- {{label: wanted, topic: /wanted, tag: {tag}}}\n"
    problem = cfgplan.match(loaded(found, folder, more))
    return [
        each.label
        for each in problem.environment.library
        if problem.similarity.holds(each.outputs[0].tag, problem.environment.targets[0].tag)
    ]


HOUSE = {
    "sensor/k": {
        "stat_t": "house/kitchen/t",
        "dev_cla": "temperature",
        "unit_of_meas": "°C",
        "dev": {"sa": "Küche"},
    },
    "sensor/w": {"stat_t": "window", "dev_cla": "temperature", "unit_of_meas": "°F"},
    "device/z": {
        "stat_t": "zb/air",
        "cmps": {
            "t": {"p": "sensor", "dev_cla": "temperature", "unit_of_meas": "°C", "val_tpl": "{{ value_json.t }}"},
            "d": {"p": "binary_sensor", "dev_cla": "garage_door", "val_tpl": "{{ value_json.door }}"},
        },
    },
}
CAME = {"house/kitchen/t": [b"20"], "house/hall/lamp": [b"ON"], "window": [b"68"], "zb/air": [b'{"t": 1, "door": 0}']}


@pytest.mark.parametrize(
    ("tag", "labels"),
    [
        ("Temperature", ["house-kitchen-t", "window", "zb-air-t"]),
        ("Temperature and inUnit some DegreeCelsius", ["house-kitchen-t", "zb-air-t"]),
        ("inArea some Kuche", ["house-kitchen-t"]),
        ("OpeningState", ["zb-air-door"]),
        ("house", ["house-hall-lamp", "house-kitchen-t"]),
        ("zb-air", ["zb-air-door", "zb-air-t"]),
        ("Topic", ["house-hall-lamp", "house-kitchen-t", "window", "zb-air-door", "zb-air-t"]),
    ],
)
def test_tags_tell_kind_unit_area_and_topic(tag: str, labels: list[str], tmp_path: Path) -> None:
    assert matches(made(CAME, HOUSE), tag, tmp_path) == labels


def test_a_described_field_is_a_source_of_its_own() -> None:
    params = {each.label: dict(each.params) for each in made(CAME, HOUSE).environment.library}
    assert "zb-air" not in params
    assert {key: params["zb-air-t"][key] for key in ("topic", "payload", "field")} == {
        "topic": "zb/air",
        "payload": "json",
        "field": "t",
    }


def test_what_is_described_and_silent_is_a_source_with_a_guessed_form() -> None:
    found = made({}, HOUSE)
    payloads = {each.label: each.params["payload"] for each in found.environment.library}
    assert payloads == {"house-kitchen-t": "number", "window": "number", "zb-air-t": "json", "zb-air-door": "json"}
    assert found.hints == (
        "house/kitchen/t, window, zb/air: described, but nothing came; the form of the payload is guessed",
    )


def test_the_example_of_a_target_in_the_head_can_be_used_as_it_is(tmp_path: Path) -> None:
    found = made(CAME, HOUSE)
    text = found.text("env.ttl")
    head = [line.removeprefix("# ") for line in text.splitlines() if line.startswith("#   ")]
    targets = yaml.safe_dump(yaml.safe_load("\n".join(line.removeprefix("  ") for line in head)))
    world = loaded(found, tmp_path, targets)
    assert cfgplan.plan(cfgplan.match(world)).status == "optimal"


def test_a_slash_at_the_beginning_is_no_level_of_the_tags_and_topics_that_only_it_tells_apart_are_a_hint(
    tmp_path: Path,
) -> None:
    found = made({"/hall/t": [b"20"], "/hall/h": [b"50"], "//x": [b"1"], "hall/t": [b"21"], "/": [b"2"]})
    labels = {source.topic.name: source.label for source in found.sources}
    assert labels == {"/hall/t": "hall-t", "/hall/h": "hall-h", "//x": "x", "hall/t": "hall-t_", "/": "topic-_"}
    assert matches(found, "hall", tmp_path) == ["hall-h", "hall-t"]
    assert ':hall a owl:Class ; rdfs:subClassOf :Topic ; rdfs:label "/hall" .' in found.ontology
    (hint,) = (hint for hint in found.hints if "slash" in hint)
    assert hint.startswith("/hall/t is hall-t, hall/t is hall-t_: topics that differ by a slash are different topics")
    assert not any("slash" in hint for hint in made({"/hall/t": [b"20"], "hall/h": [b"21"]}).hints)


@pytest.mark.parametrize("topic", ["/window", "window", "cfgplan/window"])
def test_the_example_of_a_target_has_a_topic_that_no_source_hears(topic: str) -> None:
    target = yaml.safe_load(made({topic: [b"1"], "cfgplan/other": [b"2"]}).example)
    assert target["topic"].startswith("cfgplan/")
    assert target["topic"] not in {topic, "cfgplan/other"}


def test_the_status_of_runs_is_no_source_and_is_told() -> None:
    found = made({"cfgplan/a/status": [b"online"], "lamp/status": [b"on"], "cfgplan/a": [b"1"]})
    assert [source.topic.name for source in found.sources] == ["cfgplan/a", "lamp/status"]
    assert found.notes == ("cfgplan/a/status: whether a run of cfgplan is online",)


def test_commands_are_no_sources_and_are_told() -> None:
    found = made(
        {"lamp/set": [b"ON"], "lamp/state": [b"ON"]}, {"light/x": {"~": "lamp", "cmd_t": "~/set", "stat_t": "~/state"}}
    )
    assert [source.label for source in found.sources] == ["lamp-state"]
    assert found.notes == ("lamp/set: commands to devices, for which `cfgplan_runtime.mqtt:Publisher` is there",)


def test_sparkplug_is_told_in_a_line_and_not_read() -> None:
    found = made({"spBv1.0/plant/NDATA/n": [b"\x08"], "spBv1.0/plant/NBIRTH/n": [b"\x08"], "x": [b"1"]})
    assert [source.label for source in found.sources] == ["x"]
    assert found.notes == ("2 topics of Sparkplug (spBv1.0/...), whose messages are not read",)


def test_where_nothing_can_be_a_source_that_is_the_error() -> None:
    with pytest.raises(InputError, match=r"can be a source: 1 topic of Sparkplug"):
        made({"spBv1.0/plant/NDATA/n": [b"\x08"]})


def test_topics_that_differ_in_one_level_and_open_mappings_are_hints() -> None:
    rooms = {f"house/{room}/t": [b"20"] for room in ("attic", "bath", "cellar")}
    pattern, fields = made({**rooms, "house/attic/light": [b"ON"], "air": [b'{"co2": 1, "t": 2}']}).hints
    assert pattern.startswith("house/+/t: 3 topics differ only there (attic, bath, cellar)")
    assert fields == "messages with fields: air (co2, t); with `field` in its `params` a source gives one of them"


TOPICS = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0+#"), min_size=1, max_size=8)


ODD = ["a/b", "a-b", "/a", "a//b", "Topic", "some", "Temperature", "${x}", "5", "a\nunits: 7", "a and b", "\x1f", "é"]


@settings(deadline=None)
@given(topics=st.sets(TOPICS | st.sampled_from(ODD), min_size=1))
def test_any_topics_make_a_file_that_is_valid(topics: set[str], tmp_path_factory: pytest.TempPathFactory) -> None:
    topics -= {topic for topic in topics if topic.startswith(("spBv1.0/", "homeassistant/"))}
    described = {
        f"sensor/n{number}": {"stat_t": topic, "dev_cla": topic, "unit_of_meas": topic, "dev": {"sa": topic}}
        for number, topic in enumerate(sorted(topics))
        if number % 2
    }
    if not topics:
        return  # all of them are told, and not taken
    found = made({topic: [b"1"] for topic in topics}, described)
    world = loaded(found, tmp_path_factory.mktemp("any"))
    assert sorted(str(each.params["topic"]) for each in world.environment.library) == sorted(topics)
