"""Environment files that load: what they mean, in YAML and in JSON."""

from __future__ import annotations

import gc
import json
from pathlib import Path
from unicodedata import normalize

import pytest
import yaml
from loading import faults_of, load, load_text

from cfgplan.amounts import MICROSECONDS
from cfgplan.costs import LARGEST_COST_US
from cfgplan.domain import (
    ComputationUnit,
    InputPort,
    OutputPort,
    Publication,
    Stream,
    Subscription,
    Target,
    Transformation,
)
from cfgplan.errors import InputError
from cfgplan.formats.fields import EnvironmentPart
from cfgplan.formats.models import json_schema

WHOLE = """\
format: cfgplan/1
ontology: [a.ttl, b.ttl]
horizon: 60
max_cost: 20.5
defaults: {labor: 2, upkeep: 0.001}
transformations:
  - label: detect
    source: units.py:Detect
    kind: nodelet
    host: piff
    params: {threshold: 3, gain: 0.5, name: "on", nested: {list: [1, null, true, text]}}
    labor: 0.3
    pinned: true
    required: true
    inputs:
      hull: ConvHull
      left: {tag: Position, distinct: sources}
      own: {tag: State, feedback: true}
    outputs: {ball: "PixelPos", state: {tag: State}}
units:
  - id: detect.1
    transformation: detect
    inputs: {hull: null, own: detect.1/state}
    topics: {ball: [/result, /copy]}
targets:
  - {label: ball, topic: /result, tag: PixelPos, priority: 1}
  - {label: copy, topic: /copy, tag: PixelPos}
"""


def test_every_key_of_the_file_reaches_the_environment(tmp_path: Path) -> None:
    world = load_text(tmp_path, WHOLE)
    environment = world.environment
    assert environment.library == (
        Transformation(
            "detect",
            (
                InputPort("hull", "ConvHull"),
                InputPort("left", "Position", "sources"),
                InputPort("own", "State", feedback=True),
            ),
            (OutputPort("ball", "PixelPos"), OutputPort("state", "State")),
            300_000,
            1_000,
            pinned=True,
            required=True,
            source="units.py:Detect",
            host="piff",
            kind="nodelet",
            params={"threshold": 3, "gain": 0.5, "name": "on", "nested": {"list": [1, None, True, "text"]}},
        ),
    )
    assert environment.units == (
        ComputationUnit(
            "detect.1",
            "detect",
            (Subscription("own", Stream("detect.1", "state")),),
            (Publication("ball", "/result"), Publication("ball", "/copy")),
        ),
    )
    assert environment.targets == (Target("ball", "PixelPos", "/result", 1), Target("copy", "PixelPos", "/copy"))
    assert (world.horizon_s, world.max_cost_us) == (60, 20_500_000)
    assert world.ontology_paths == (tmp_path / "a.ttl", tmp_path / "b.ttl")


def test_absent_costs_are_one_second_of_labor_and_no_upkeep(tmp_path: Path) -> None:
    (transformation,) = load_text(tmp_path, "format: cfgplan/1\ntransformations: [{label: a}]\n").environment.library
    assert (transformation.labor_us, transformation.upkeep_us) == (1_000_000, 0)


@pytest.mark.parametrize(
    ("written", "labor_us"),
    [
        ("0.1", 100_000),
        ("1e-3", 1_000),
        ("0.000001", 1),
        ("3", 3_000_000),
        ("1.", 1_000_000),
        (".5", 500_000),
        ("0", 0),
    ],
)
def test_a_cost_is_exactly_what_is_written(tmp_path: Path, written: str, labor_us: int) -> None:
    text = f"format: cfgplan/1\ntransformations: [{{label: a, labor: {written}}}]\n"
    assert load_text(tmp_path, text).environment.library[0].labor_us == labor_us


@pytest.mark.parametrize("label", ["on", "no", "2026-11-20", "12:30:45", "1_000", "=", "y", "0b1", "No"])
def test_what_yaml_1_1_takes_for_something_else_is_text(tmp_path: Path, label: str) -> None:
    text = f"format: cfgplan/1\ntransformations: [{{label: {label}, params: {{key: {label}}}}}]\n"
    (transformation,) = load_text(tmp_path, text).environment.library
    assert (transformation.label, transformation.params["key"]) == (label, label)


def test_the_same_document_loads_as_json(tmp_path: Path) -> None:
    import yaml

    data = yaml.safe_load(WHOLE)
    text = json.dumps(data, indent=1)
    from_yaml, from_json = load_text(tmp_path, WHOLE), load_text(tmp_path, text, "env.json")
    assert from_json.environment == from_yaml.environment
    assert from_json.digest == from_yaml.digest
    assert load_text(tmp_path, text, "json_in.yaml").environment == from_yaml.environment


def test_empty_lists_may_be_left_blank(tmp_path: Path) -> None:
    text = "format: cfgplan/1\ntransformations:\nunits:\ntargets:\n"
    assert load_text(tmp_path, text).environment.library == ()


def test_anchors_repeat_values(tmp_path: Path) -> None:
    text = "format: cfgplan/1\ntransformations: [{label: a, inputs: &p {x: T}}, {label: b, inputs: *p}]\n"
    first, second = load_text(tmp_path, text).environment.library
    assert first.inputs == second.inputs


def test_included_files_and_folders_add_transformations_and_targets(tmp_path: Path) -> None:
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "b.yaml").write_text("format: cfgplan/1\ntransformations: [{label: b}]\n")
    (tmp_path / "parts" / "c.json").write_text('{"targets": [{"label": "c", "topic": "/c", "tag": "T"}]}')
    (tmp_path / "parts" / "notes.txt").write_text("not an environment")
    (tmp_path / "d.yaml").write_text("transformations: [{label: d}]\n")
    text = "format: cfgplan/1\ndefaults: {labor: 7}\ninclude: [parts/, d.yaml]\ntransformations: [{label: a}]\n"
    environment = load_text(tmp_path, text).environment
    assert [(t.label, t.labor_us) for t in environment.library] == [(label, 7_000_000) for label in "abd"]
    assert [target.label for target in environment.targets] == ["c"]


def test_one_included_file_needs_no_list(tmp_path: Path) -> None:
    (tmp_path / "d.yaml").write_text("transformations: [{label: d}]\n")
    environment = load_text(tmp_path, "format: cfgplan/1\ninclude: d.yaml\n").environment
    assert [t.label for t in environment.library] == ["d"]


def test_a_world_knows_where_its_parts_are_written(tmp_path: Path) -> None:
    world = load_text(tmp_path, WHOLE)
    file = str(tmp_path / "env.yaml")
    assert world.place(unit="detect.1") == (file, 21, 5)
    assert world.place(unit="detect.1", port="hull") == (file, 23, 20)
    assert world.place(unit="detect.1", port="ball") == (file, 24, 20)
    assert world.place(unit="detect.1", port="left") == (file, 21, 5)
    assert world.place(target="copy") == (file, 27, 5)
    assert world.place(transformation="detect", port="hull") == (file, 16, 13)
    assert world.place(unit="nobody") is None


def test_a_json_world_knows_where_its_parts_are_written(tmp_path: Path) -> None:
    text = '{"format": "cfgplan/1",\n "targets": [\n  {"label": "a\\u0041", "topic": "/a", "tag": "T"}]}'
    assert load_text(tmp_path, text, "env.json").place(target="aA") == (str(tmp_path / "env.json"), 3, 3)


def test_the_digest_depends_on_what_plans_depend_on_and_on_nothing_else(tmp_path: Path) -> None:
    digest = load_text(tmp_path, WHOLE).digest
    for old, new in [
        ("format: cfgplan/1\n", "# a comment\nformat: cfgplan/1\n"),
        ("source: units.py:Detect", "source: other.py:Detect"),
        ("defaults: {labor: 2,", "defaults: {labor: 3,"),
        ("inputs: {hull: null, own: detect.1/state}", "inputs: {own: detect.1/state}"),
        ("[/result, /copy]", "[/copy, /result]"),
    ]:
        assert load_text(tmp_path, WHOLE.replace(old, new)).digest == digest, new
    for old, new in [
        ("labor: 0.3", "labor: 0.31"),
        ("horizon: 60", "horizon: 61"),
        ("max_cost: 20.5", "max_cost: 20.6"),
        ("hull: ConvHull", "hull: Hull"),
        ("topics: {ball: [/result, /copy]}", "topics: {ball: [/result]}"),
        ("priority: 1", "priority: 2"),
        ("distinct: sources", "distinct: other"),
    ]:
        assert load_text(tmp_path, WHOLE.replace(old, new)).digest != digest, new


@pytest.mark.parametrize(
    ("silent", "expected_us"), [("5", 5_000_000), ("0.5", 500_000), ("5s", 5_000_000), ("2m", 120_000_000)]
)
def test_a_target_says_how_long_it_may_be_silent(tmp_path: Path, silent: str, expected_us: int) -> None:
    text = WHOLE.replace("priority: 1", f"priority: 1, silent: {silent}")
    world = load_text(tmp_path, text)
    (target,) = [target for target in world.environment.targets if target.silent_us is not None]
    assert target.silent_us == expected_us
    assert world.digest == load_text(tmp_path, WHOLE).digest


@pytest.mark.parametrize("silent", ["0", "-1", "soon", "0s", "[5]", "true"])
def test_a_target_that_may_be_silent_for_no_span_of_time_is_refused(tmp_path: Path, silent: str) -> None:
    with pytest.raises(InputError) as refused:
        load_text(tmp_path, WHOLE.replace("priority: 1", f"priority: 1, silent: {silent}"))
    assert refused.value.faults[0].mend is not None


def test_the_digest_depends_on_the_ontology(tmp_path: Path) -> None:
    before = load_text(tmp_path, WHOLE).digest
    (tmp_path / "a.ttl").write_text("one")
    with_one = load_text(tmp_path, WHOLE).digest
    (tmp_path / "a.ttl").write_text("two")
    assert len({before, with_one, load_text(tmp_path, WHOLE).digest}) == 3


def test_the_schema_names_every_key_and_bars_others() -> None:
    schema = json_schema(EnvironmentPart)
    assert set(schema["properties"]) >= {"format", "ontology", "horizon", "max_cost", "transformations", "units"}
    assert schema["additionalProperties"] is False
    assert schema["properties"]["format"]["const"] == "cfgplan/1"
    labor = schema["$defs"]["TransformationPart"]["properties"]["labor"]
    assert {"type": "number", "minimum": 0, "maximum": LARGEST_COST_US / MICROSECONDS} in labor["anyOf"]
    ports = schema["$defs"]["TransformationPart"]["properties"]["inputs"]["anyOf"][0]
    assert ports["additionalProperties"] is False
    json.dumps(schema)


def test_the_slow_parser_reads_what_the_fast_one_reads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import yaml

    from cfgplan.formats import yaml_text

    fast = load_text(tmp_path, WHOLE)
    monkeypatch.setattr(yaml_text, "_LOADER", yaml.SafeLoader)
    slow = load_text(tmp_path, WHOLE)
    assert slow.environment == fast.environment
    assert slow.place(unit="detect.1", port="hull") == fast.place(unit="detect.1", port="hull")


def test_loading_twice_gives_equal_worlds(tmp_path: Path) -> None:
    load_text(tmp_path, WHOLE)
    assert load(tmp_path / "env.yaml") == load(tmp_path / "env.yaml")


def test_loading_leaves_the_garbage_collector_as_it_was(tmp_path: Path) -> None:
    was_enabled = gc.isenabled()
    try:
        for state in (gc.enable, gc.disable):
            state()
            before = gc.isenabled()
            load_text(tmp_path, WHOLE)
            assert gc.isenabled() is before
            faults_of(tmp_path, "a: [")
            assert gc.isenabled() is before
    finally:
        (gc.enable if was_enabled else gc.disable)()


def test_imports_are_files_or_ignored_and_part_of_the_digest(tmp_path: Path) -> None:
    (tmp_path / "ssn.ttl").write_text("one")
    texts = (
        "",
        "imports: ignore\n",
        "imports: {http://x/ssn/: ssn.ttl}\n",
        "imports: {http://x/ssn/: ignore}\n",
        "imports: {http://x/ssn: ssn.ttl}\n",
    )
    loaded = [load_text(tmp_path, WHOLE + text) for text in texts]
    assert [world.imports for world in loaded[:3]] == [
        (),
        (("", None),),
        (("http://x/ssn/", tmp_path / "ssn.ttl"),),
    ]
    (tmp_path / "ssn.ttl").write_text("two")
    digests = {world.digest for world in loaded} | {load_text(tmp_path, WHOLE + texts[2]).digest}
    assert len(digests) == len(texts)


def test_imports_are_refused_where_they_are_no_files(tmp_path: Path) -> None:
    for text in ("imports: all\n", "imports: [a.ttl]\n", "imports: {http://x/: 3}\n"):
        with pytest.raises(InputError, match="imports"):
            load_text(tmp_path, WHOLE + text)


SPELLED = """\
format: cfgplan/1
ontology: Café.ttl
transformations:
  - label: Gärung(${Café})
    params: {Größe: 1}
    outputs: {größe: Länge}
  - label: maß
    conflicts: [Gärung(x)]
    run: {start: größe}
    inputs: {größe: Länge}
units:
  - {id: gär, transformation: Gärung(x)}
  - id: maß
    transformation: maß
    inputs: {größe: gär/größe}
targets:
  - {label: länge, topic: /Länge, tag: Länge}
"""


@pytest.mark.parametrize("shift", [0, 1])
def test_names_meet_however_their_accents_are_encoded(shift: int, tmp_path: Path) -> None:
    world = load_text(tmp_path, SPELLED)
    lines = SPELLED.splitlines(keepends=True)
    alternating = "".join(normalize("NFD" if i % 2 == shift else "NFC", line) for i, line in enumerate(lines))
    found = load_text(tmp_path, alternating)
    assert (found.environment, found.digest) == (world.environment, world.digest)
    place = found.place(unit="maß", port="größe")
    assert place is not None
    assert place.line == SPELLED[: SPELLED.index("größe: gär/")].count("\n") + 1
    text = json.dumps(yaml.safe_load(alternating))
    assert load_text(tmp_path, text, "env.json").environment == world.environment


def test_a_key_in_two_spellings_stands_there_twice_and_what_is_no_name_is_left_as_it_is(tmp_path: Path) -> None:
    composed, decomposed = "Länge", normalize("NFD", "Länge")
    assert composed != decomposed
    data = {"label": "a", "params": {composed: decomposed}}
    text = json.dumps({"format": "cfgplan/1", "ontology": f"{decomposed}.ttl", "transformations": [data]})
    for name in ("env.json", "env.yaml"):
        world = load_text(tmp_path, text, name)
        assert world.environment.library[0].params == {composed: decomposed}
        assert world.ontology_paths == (tmp_path / f"{decomposed}.ttl",)
        twice = text.replace('"params": {', f'"params": {{"{decomposed}": 1, ')
        assert [f"`{composed}` occurs twice" in fault.message for fault in faults_of(tmp_path, twice, name)] == [True]
