"""The JSON Schema and the loader agree on the shape of a file: what an editor marks is refused, and nothing else."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any, TypeAlias

import pytest
from jsonschema import Draft202012Validator
from loading import faults_of, load_text

from cfgplan.errors import InputError
from cfgplan.formats.fields import EnvironmentPart
from cfgplan.formats.models import json_schema
from cfgplan.formats.yaml_text import read_yaml

RouteWatch: TypeAlias = tuple[str | int, ...]

VALUES = (True, -1, 0, 2.0, 1.5, 1e15, 2**70, "", "x", "1h", "a/b", [], {}, None)
BETWEEN_PARTS = re.compile(
    r"there is no |no unit |no target names|no step starts on|is not expected here|\w+ `\S+` (has no|does not say)"
    r"|the scale of .* is wrong|the value -1 of rate is out of range|no target has the topic|`noise` is only for facts"
    r"|no hosts are declared|but its `declared` is"
)
"""Faults of names, selectors and numbers that depend on another part; a schema has no words for them."""


@cache
def schema() -> Draft202012Validator:
    return Draft202012Validator(json_schema(EnvironmentPart))


def every_key() -> Any:
    text = (Path(__file__).parent / "every_key.yaml").read_text()
    return json.loads(json.dumps(read_yaml(text, "").data, default=float))


def ways(data: Any, way: RouteWatch = ()) -> Iterator[RouteWatch]:
    """The ways to all that is in the data; `params` may hold anything."""
    if way:
        yield way
    if isinstance(data, dict | list) and way[-1:] != ("params",):
        for step, inner in data.items() if isinstance(data, dict) else enumerate(data):
            yield from ways(inner, (*way, step))


def places() -> Iterator[tuple[Any, RouteWatch]]:
    """One way to each key of each kind of part and to what comes first in a list, in a file with only that part.

    Attributes of quality stay in it: without them nothing is said of quality at all.
    """
    whole, found = every_key(), set()
    for way in ways(whole):
        kind = tuple("" if type(step) is int else step for step in way)
        if kind not in found:
            found.add(kind)
            top, alone = way[0], whole[way[0]]
            if len(way) > 1 and isinstance(way[1], int):
                alone, way = [alone[way[1]]], (top, 0, *way[2:])
            yield {"format": whole["format"], "qualities": whole["qualities"], top: alone}, way


def with_value(data: Any, way: RouteWatch, value: object) -> Any:
    if not way:
        return value
    changed = data.copy()
    changed[way[0]] = with_value(data[way[0]], way[1:], value)
    return changed


def is_taken(folder: Path, data: Any) -> bool:
    """Whether the loader finds the shape of a file right."""
    try:
        load_text(folder, json.dumps(data), "env.json")
    except InputError as error:
        return all(BETWEEN_PARTS.search(fault.message) for fault in error.faults)
    return True


@pytest.mark.parametrize("value", VALUES, ids=json.dumps)
def test_the_schema_and_the_loader_take_a_value_in_the_same_places(tmp_path: Path, value: object) -> None:
    differ = [
        way
        for alone, way in places()
        if schema().is_valid(changed := with_value(alone, way, value)) != is_taken(tmp_path, changed)
    ]
    assert not differ


@pytest.mark.parametrize(
    ("point", "is_valid"), [([-(10**12), 100_000], True), ([1, 100_001], False), ([10**13, 1], False)]
)
def test_at_a_point_the_fact_may_be_larger_than_the_quality(point: list[int], is_valid: bool) -> None:
    curve = {"by": "light", "points": [[-(10**12), 1], point]}
    output = {"tag": "A", "quality": {"error": {"set": curve}}}
    data = {"format": "cfgplan/1", "transformations": [{"label": "a", "outputs": {"x": output}}]}
    assert schema().is_valid(data) == is_valid


@pytest.mark.parametrize(("key", "value"), [("max_cost", 1e-7), ("max_cost", 0.0000015), ("transfer", 1e-7)])
def test_what_is_finer_than_a_millionth_is_refused_by_the_loader_alone(tmp_path: Path, key: str, value: float) -> None:
    """Seen by a schema, 0.3 is no multiple of 0.000001: floating-point numbers can't tell."""
    data = {"format": "cfgplan/1", key: value}
    assert schema().is_valid(data)
    assert "finer than a microsecond" in faults_of(tmp_path, json.dumps(data), "env.json")[0].message


@pytest.mark.parametrize("conflicts", ["{}", "[]", "null", "{host: []}"])
def test_conflicts_that_name_nothing_are_none(tmp_path: Path, conflicts: str) -> None:
    text = f"format: cfgplan/1\ntransformations:\n- {{label: a, conflicts: {conflicts}, outputs: {{o: O}}}}\n"
    assert load_text(tmp_path, text).environment.library[0].conflicts == ()
