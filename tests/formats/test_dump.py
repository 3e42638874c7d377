"""Environments written and read again: nothing is lost."""

from __future__ import annotations

import tempfile
from pathlib import Path

import pytest
from environments import environments
from hypothesis import given, settings
from hypothesis import strategies as st
from loading import load_text

from cfgplan.domain import Environment, OutputPort, Transformation
from cfgplan.formats.dump import dump_yaml, plain_environment
from cfgplan.formats.xml_dump import dump_xml


@given(environments(), st.integers(0, 10**9), st.none() | st.integers(0, 2**53 - 1))
@settings(max_examples=150, deadline=None)
def test_what_is_written_as_yaml_loads_back(environment: Environment, horizon_s: int, max_cost_us: int | None) -> None:
    text = dump_yaml(plain_environment(environment, horizon_s=horizon_s, max_cost_us=max_cost_us, ontology=["o n.ttl"]))
    with tempfile.TemporaryDirectory() as folder:
        world = load_text(Path(folder), text)
        assert world.environment == environment
        assert (world.horizon_s, world.max_cost_us) == (horizon_s, max_cost_us)
        assert world.ontology_paths == (Path(folder) / "o n.ttl",)


def test_the_yaml_is_what_a_person_would_write() -> None:
    transformation = Transformation("cam(piff)", outputs=(OutputPort("image", "Image ⊓ ∃hasSource.piff"),), labor_us=1)
    assert dump_yaml(plain_environment(Environment(library=(transformation,)), horizon_s=60)) == (
        "format: cfgplan/1\n"
        "horizon: 60\n"
        "transformations:\n"
        "- label: cam(piff)\n"
        "  labor: 0.000001\n"
        "  upkeep: 0\n"
        "  outputs:\n"
        "    image: Image ⊓ ∃hasSource.piff\n"
    )


@pytest.mark.parametrize("imports", [{"http://a.example/a": "sub/a.ttl", "http://b.example/b": None}, {"": None}])
def test_imports_are_written_as_they_were_named_or_ignored(imports: dict[str, str | None], tmp_path: Path) -> None:
    text = dump_yaml(plain_environment(Environment(), horizon_s=60, ontology=["o.ttl"], imports=imports))
    expected = tuple((iri, None if path is None else tmp_path / path) for iri, path in imports.items())
    assert load_text(tmp_path, text).imports == expected


def test_that_rules_are_ignored_is_written_and_makes_another_plan_due(tmp_path: Path) -> None:
    loaded = [
        load_text(tmp_path, dump_yaml(plain_environment(Environment(), horizon_s=60, ignores_rules=ignored)))
        for ignored in (False, True)
    ]
    assert [file.ignores_rules for file in loaded] == [False, True]
    assert loaded[0].digest != loaded[1].digest


def test_whose_names_are_preferred_is_written_and_makes_another_plan_due(tmp_path: Path) -> None:
    said: list[tuple[str, ...]] = [
        (),
        ("brick",),
        ("brick", "https://w3id.org/rec#"),
        ("https://w3id.org/rec#", "brick"),
    ]
    plain = [plain_environment(Environment(), horizon_s=60, preferred=each) for each in said]
    names = ["env.yaml", "env.xml"]
    loaded = [
        load_text(tmp_path, dump(each), name)
        for each in plain
        for dump, name in zip((dump_yaml, dump_xml), names, strict=True)
    ]
    assert [file.preferred for file in loaded] == [each for each in said for _ in names]
    assert len({file.digest for file in loaded}) == len(said)
