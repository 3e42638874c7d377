"""The reader of plain block style leaves a text to libyaml, or reads it as libyaml does."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cfgplan.errors import InputError
from cfgplan.formats.block_yaml import read_block_yaml
from cfgplan.formats.yaml_text import _LARGE, read_yaml

BLOCK = """\
# a library
format: cfgplan/1

transformations:
- label: camera(piff)
  labor: 0.25
  params:
    gain: 3
    name: 'no: number'
    empty: ""
  outputs:
    image: Image and hasSource some {piff}
- label: detector
  upkeep: .5
  needs:
  pinned: true
  inputs:
    image: Image  
  # the last one
  with:
  - camera(piff)
  - 'it'
units:
  - id: camera.1
    topics:
      out:
        - /a:b
        - -1
"""  # noqa: W291
PIECES = (
    *"{}[]:,-?#&*!|>'\"%@` \n\\é/~",
    "- ",
    "  ",
    "\n  ",
    ": ",
    " #",
    "null",
    "1e9",
    "x: ",
    "- - ",
    "---",
    "y: z\n",
)


def as_libyaml_reads(text: str) -> object:
    """The data of a text, as the reader of small files gives it; None if it has faults."""
    assert len(text) < _LARGE
    try:
        source = read_yaml(text, "env.yaml")
    except InputError:
        return None
    return None if source.faults else source.data


def test_plain_block_style_is_read() -> None:
    data = read_block_yaml(BLOCK)
    assert data is not None
    assert repr(data) == repr(as_libyaml_reads(BLOCK))


def test_a_large_file_is_read_as_a_small_one() -> None:
    text = BLOCK + "\n".join(f"key{number}: {number}" for number in range(_LARGE // 5)) + "\n"
    assert repr(read_yaml(text, "env.yaml").data) == repr(read_block_yaml(text))


@pytest.mark.parametrize(
    "text",
    ["", "a", "- a\n", "a: {b: c}\n", "a: b\na: c\n", "a: &x b\nc: *x\n", "a: |\n  b\n", "a: b\n c\n", "a:\tb\n"],
)
def test_all_else_is_left_to_libyaml(text: str) -> None:
    assert read_block_yaml(text) is None


@given(
    st.lists(st.tuples(st.integers(0, len(BLOCK)), st.integers(0, 3), st.sampled_from(PIECES)), min_size=1, max_size=3)
)
@settings(max_examples=1500, deadline=None)
def test_a_mutated_text_is_left_alone_or_read_as_libyaml_does(changes: list[tuple[int, int, str]]) -> None:
    text = BLOCK
    for at, cut, segment in changes:
        text = text[:at] + segment + text[at + cut :]
    data = read_block_yaml(text)
    if data is not None:
        assert repr(data) == repr(as_libyaml_reads(text))


@pytest.mark.parametrize("path", [*(Path(__file__).parents[2] / "models").rglob("*.yaml")], ids=lambda path: path.stem)
def test_every_model_is_left_alone_or_read_as_libyaml_does(path: Path) -> None:
    text = path.read_text()
    data = read_block_yaml(text) if len(text) < _LARGE else None
    if data is not None:
        assert repr(data) == repr(as_libyaml_reads(text))
