"""A field is one row: what is made of the table knows it, whatever it is."""

from __future__ import annotations

import dataclasses
import os
import shutil
import subprocess
import sys
from contextlib import suppress
from dataclasses import MISSING, replace
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from loading import load

import cfgplan
from cfgplan.domain import (
    ComputationUnit,
    Host,
    InputPort,
    Link,
    OutputPort,
    RunOptions,
    Target,
    Transformation,
)
from cfgplan.errors import InvalidValueError
from cfgplan.formats import fields
from cfgplan.formats.environment_file import EnvironmentFile
from cfgplan.formats.fields import Part, Use
from cfgplan.qualities import QualityAttribute, Wish

HERE = Path(__file__).parent
HOLDERS: dict[type[Part], tuple[Any, list[str]]] = {
    fields.TransformationPart: (Transformation, ["library"]),
    fields.ConflictsPart: (Transformation, ["library"]),
    fields.InputPart: (InputPort, ["library", "inputs"]),
    fields.OutputPart: (OutputPort, ["library", "outputs"]),
    fields.RunPart: (RunOptions, ["library", "run"]),
    fields.UnitPart: (ComputationUnit, ["units"]),
    fields.TargetPart: (Target, ["targets"]),
    fields.WishPart: (Wish, ["targets", "quality"]),
    fields.HostPart: (Host, ["hosts"]),
    fields.LinkPart: (Link, ["links"]),
    fields.AttributePart: (QualityAttribute, ["qualities"]),
}
"""The domain's value of each part, and the way to it from an environment."""
COMPUTED = ("labor", "upkeep", "worst", "best", "run")
ROWS = [(part, key) for part in HOLDERS for key in part.rows() if (part, key) != (fields.HostPart, "copies")]


@cache
def world() -> EnvironmentFile:
    return load(HERE / "every_key.yaml")


def default_of(part: type[Part], key: str) -> Any:
    """What the domain's value has if it is not told; MISSING if it must be."""
    (field,) = (field for field in dataclasses.fields(HOLDERS[part][0]) if field.name == part.rows()[key].to)
    return field.default if field.default_factory is MISSING else field.default_factory()


TOGETHER: dict[tuple[type[Part], str], dict[str, Any]] = {
    (fields.LinkPart, "latency"): {"latency": 0, "adds": None},
    (fields.LinkPart, "adds"): {"latency": 0, "adds": None},
    (fields.TargetPart, "topic"): {"topic": "/elsewhere"},
    (fields.TargetPart, "run"): {"run": "camera"},
}
"""Attributes with what they are changed to, where one can't have its default alone."""


def changed(holder: Any, path: list[str], values: dict[str, Any]) -> list[Any]:
    """The holder with the values instead of others, once for each place on the path that can have them."""
    if not path:
        differs = all(getattr(holder, of) != value for of, value in values.items())
        with suppress(InvalidValueError):
            return [replace(holder, **values)] if differs else []
        return []
    inner = getattr(holder, path[0])
    if not isinstance(inner, tuple):
        return [replace(holder, **{path[0]: other}) for other in changed(inner, path[1:], values)]
    return [
        replace(holder, **{path[0]: (*inner[:index], other, *inner[index + 1 :])})
        for index, each in enumerate(inner)
        for other in changed(each, path[1:], values)
    ]


@pytest.mark.parametrize(("part", "key"), ROWS)
def test_a_field_counts_in_the_digest_where_planning_uses_it(part: type[Part], key: str) -> None:
    row, usual = part.rows()[key], default_of(part, key)
    if usual is MISSING:
        return
    others = changed(world().environment, HOLDERS[part][1], TOGETHER.get((part, key), {row.to: usual}))
    assert others, f"every_key.yaml does not say `{key}`"
    counts = any(replace(world(), environment=other).digest != world().digest for other in others)
    assert counts == (Use.PLANNING in row.use)


@pytest.mark.parametrize(("part", "key"), ROWS)
def test_an_absent_key_means_the_same_to_the_schema_and_to_the_domain(part: type[Part], key: str) -> None:
    row, usual = part.rows()[key], default_of(part, key)
    if usual is not MISSING and key not in COMPUTED:
        assert (None if usual is None else row.plain(usual) or None) == (row.default or None)


def test_an_attribute_without_a_row_is_one_that_no_key_says_alone() -> None:
    without_row: dict[type, set[str]] = {}
    for part, (holder, _) in HOLDERS.items():
        left = without_row.setdefault(holder, {field.name for field in dataclasses.fields(holder)})
        left -= {row.to for row in part.rows().values()}
    assert {holder: names for holder, names in without_row.items() if names} == {
        Transformation: {"hosts", "seen_us"},  # `host` says a list too; what is seen of costs in a run is in no file
        InputPort: {"name"},
        Link: {"is_measured", "declared"},  # what a run has found of links is in no file
        OutputPort: {"name"},
        Wish: {"attribute"},
    }


NEW_FIELD = """
from pathlib import Path
import sys
from loading import load
from experiments.study.instances import given
from cfgplan.domain import Similarity
from cfgplan.explaining.limits import limits_of
from cfgplan.formats import fields
from cfgplan.formats.dump import dump_yaml, plain_environment
from cfgplan.formats.fields import EnvironmentPart
from cfgplan.formats.models import json_schema
from cfgplan.formats.xml_dump import dump_xml
from cfgplan.planning import Problem
from cfgplan.rows import Feature
from cfgplan.transformations import running_fields

text = "format: cfgplan/1\\ntransformations:\\n- {label: t, outputs: {o: O}GPU}\\n"
def world(suffix, content):
    path = Path(sys.argv[1]) / f"env{suffix}"
    path.write_text(content)
    return load(path)

said, without = world(".yaml", text.replace("GPU", ", gpu: 2")), world(".yaml", text.replace("GPU", ""))
assert json_schema(EnvironmentPart)["$defs"]["TransformationPart"]["properties"]["gpu"]["description"] == "how many"
(t,), (u,) = said.environment.library, without.environment.library
assert (t.gpu, u.gpu) == (2, 0)
assert said.digest != without.digest
assert running_fields(t) != running_fields(u)
assert Feature.INSTANCES in Problem(said.environment, Similarity({}), 1).features
assert [str(each) for each in limits_of(Problem(said.environment, Similarity({}), 1))] == ["`gpu` of transformation t"]
assert not limits_of(Problem(without.environment, Similarity({}), 1))
assert '"gpu":2' in given("said", Problem(said.environment, Similarity({}), 1)).text
assert world(".yaml", dump_yaml(plain_environment(said.environment, horizon_s=1))).environment == said.environment
assert world(".xml", dump_xml(plain_environment(said.environment, horizon_s=1))).environment == said.environment
"""


NEW_ROW = """    gpu: Annotated[
        Natural, Row("how many", use=Use.BOTH, feature=Feature.INSTANCES, is_limit=True)
    ] = 0
"""


def test_a_new_field_is_a_row_of_the_domain(tmp_path: Path) -> None:
    """Schema, reading, writing, digest, XML, features, limits and what restarts a unit follow from the row."""
    shutil.copytree(Path(cfgplan.__file__).parent, tmp_path / "cfgplan", ignore=shutil.ignore_patterns("__pycache__"))
    path = tmp_path / "cfgplan" / "transformations.py"
    before, found, after = path.read_text().partition("    seen_us: Annotated[")
    assert found
    path.write_text(before + NEW_ROW + found + after)
    search = {"PYTHONPATH": f"{tmp_path}:{HERE}:{HERE.parents[1]}"}
    subprocess.run([sys.executable, "-c", NEW_FIELD, str(tmp_path)], env=os.environ | search, cwd=tmp_path, check=True)
