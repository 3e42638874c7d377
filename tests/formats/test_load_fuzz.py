"""Whatever a file holds, it loads or has faults; nothing else comes out."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import Any

import yaml
from environments import VALUES, environments
from hypothesis import given, settings
from hypothesis import strategies as st
from loading import load, load_text

from cfgplan.errors import InputError
from cfgplan.formats.dump import dump_yaml, plain_environment
from cfgplan.formats.xml_dump import dump_xml
from cfgplan.formats.yaml_text import read_yaml

VALID = """\
format: cfgplan/1
horizon: 60
transformations:
  - label: a(${NAO})
    params: {x: 3, y: &y [1.5, text]}
    labor: 0.3
    inputs: {i: {tag: "T ${NAO}", distinct: g}, j: U}
    outputs: {o: T}
units:
  - {id: u, transformation: a(piff), inputs: {i: null}, topics: {o: [/t]}}
  - {id: v, transformation: a(puff), inputs: {i: u/o}}
targets: [{label: t, topic: /t, tag: T, priority: 1}]
"""
_CHARACTERS = "{}[]:,-?#&*!|>'\"%@` \n\t\r$\\\0\x85é</"
_WORDS = "${ <<: &y *y --- 1e9 null &amp; ]]> .inf"
PIECES = st.sampled_from([*_CHARACTERS, *_WORDS.split()])


@st.composite
def mutations(draw: st.DrawFn, text: str) -> str:
    """A text with a few pieces cut out, put in or moved."""
    for _ in range(draw(st.integers(1, 4))):
        start = draw(st.integers(0, len(text)))
        end = draw(st.integers(start, min(len(text), start + 12)))
        text = text[:start] + draw(st.one_of(st.just(""), PIECES, st.text(max_size=4).filter(_is_text))) + text[end:]
    return text


def as_xml_text(text: str) -> str:
    """A YAML environment as XML."""
    data = read_yaml(text, "env.yaml").data
    assert isinstance(data, dict)
    return dump_xml(data)


def _is_text(text: str) -> bool:
    return not any("\ud800" <= character <= "\udfff" for character in text)


def _loads_or_has_faults(content: bytes, name: str) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        path.write_bytes(content)
        try:
            load(path)
        except InputError as error:
            assert error.faults
            assert all(fault.message and fault.file for fault in error.faults)


@given(mutations(VALID))
@settings(max_examples=400, deadline=None)
def test_a_mutated_yaml_file_loads_or_has_faults(text: str) -> None:
    _loads_or_has_faults(text.encode(), "env.yaml")


@given(st.data())
@settings(max_examples=150, deadline=None)
def test_a_mutated_json_file_loads_or_has_faults(data: st.DataObject) -> None:
    text = json.dumps(yaml.safe_load(VALID))
    _loads_or_has_faults(data.draw(mutations(text)).encode(), "env.json")


@given(st.data())
@settings(max_examples=250, deadline=None)
def test_a_mutated_xml_file_loads_or_has_faults(data: st.DataObject) -> None:
    text = as_xml_text(VALID)
    _loads_or_has_faults(data.draw(mutations(text)).encode(), "env.xml")


@given(st.binary(max_size=60))
@settings(max_examples=150, deadline=None)
def test_any_bytes_load_or_have_faults(content: bytes) -> None:
    for name in ("env.yaml", "env.json", "env.xml"):
        _loads_or_has_faults(content, name)


@given(st.data())
@settings(max_examples=150, deadline=None)
def test_any_value_in_any_place_loads_or_has_faults(data: st.DataObject) -> None:
    document = yaml.safe_load(VALID)
    holder: Any = document
    while True:
        step = data.draw(st.sampled_from(list(holder) if isinstance(holder, dict) else range(len(holder))))
        if not isinstance(holder[step], dict | list) or not holder[step] or data.draw(st.booleans()):
            break
        holder = holder[step]
    holder[step] = data.draw(VALUES)
    text = json.dumps(document)
    for name in ("env.yaml", "env.json"):
        _loads_or_has_faults(text.encode(), name)


@given(environments())
@settings(max_examples=50, deadline=None)
def test_the_order_of_lists_means_nothing(environment: Any) -> None:
    with tempfile.TemporaryDirectory() as folder:
        text = dump_yaml(plain_environment(environment, horizon_s=1))
        world = load_text(Path(folder), text)
        shuffled = dict(reversed(_plain(text).items()))
        for key in ("transformations", "units", "targets"):
            if key in shuffled:
                shuffled[key] = shuffled[key][::-1]
        assert load_text(Path(folder), dump_yaml(shuffled)).digest == world.digest


def _plain(text: str) -> dict[str, Any]:
    data = read_yaml(text, "env.yaml").data
    assert isinstance(data, dict)
    return data
