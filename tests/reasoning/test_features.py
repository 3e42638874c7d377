"""Features files, features and regions on the command line, and queries over them."""

from __future__ import annotations

from pathlib import Path

import pytest
from cfgplan_runtime.reasoning.features import of_file, of_options, of_targets
from cfgplan_runtime.reasoning.queries import query
from cfgplan_runtime.reasoning.states import Timing

from cfgplan.domain import Environment, Target
from cfgplan.errors import InputError

GOOD = """
features:
  ball: Position and hasSource some Ball
  map: {tag: Map, hold: 3600}
regions:
  goal: {circle: [4.5, 0], radius: 0.5}
"""


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "features.yaml"
    path.write_text(text)
    return path


def test_a_features_file_names_tags_and_regions(tmp_path: Path) -> None:
    found = of_file(write(tmp_path, GOOD))
    assert {name: (each.tag, each.hold_ns) for name, each in found.features.items()} == {
        "ball": ("Position and hasSource some Ball", None),
        "map": ("Map", 3_600_000_000_000),
    }
    assert found.regions["goal"].has((4.5, 0.5))


@pytest.mark.parametrize(
    ("text", "line", "message"),
    [
        ("feature: {}", 1, "unknown key `feature`"),
        ("features:\n  ball: 3", 2, "has a tag, which is text"),
        ("features:\n  ball: {tag: A, holds: 3}", 2, "unknown key `holds`"),
        ("features:\n  ball: {tag: A, hold: -1}", 2, "hold is a number of seconds"),
        ("features:\n  until: A", 2, "a word of the formula language"),
        ("features:\n  ball pos: A", 2, "can't be a name"),
        ("features: [ball]", 1, "not a mapping"),
        ("regions:\n  goal: {circle: [0, 0]}", 2, "radius"),
        ("features: {goal: A}\nregions:\n  goal: {box: [0, 0, 1, 1]}", 3, "is declared as a feature and as a region"),
        ("regions:\n  goal: {box: [4.5, -3, 0, 3]}", 2, "the box is reversed"),
        ("- ball", 1, "not a features file"),
        ("", None, "the file is empty"),
        ("# later\n", None, "the file is empty"),
    ],
)
def test_a_mistake_in_a_features_file_is_told_with_its_line(
    tmp_path: Path, text: str, line: int | None, message: str
) -> None:
    with pytest.raises(InputError) as caught:
        of_file(write(tmp_path, text))
    assert "cfgplan/1" not in str(caught.value)
    assert (caught.value.faults[0].line, message in caught.value.faults[0].message) == (line, True)


def test_a_reversed_box_is_told_with_the_right_one(tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        of_file(write(tmp_path, "regions:\n  goal: {box: [4.5, -3, 0, 3]}"))
    assert caught.value.faults[0].mend == "write {box: [0, -3, 4.5, 3]}"


def test_features_and_regions_can_be_declared_by_options() -> None:
    found = of_options(["ball=Position and hasSource some Ball"], ["goal={box: [4, -1, 5, 1]}"])
    assert found.features["ball"].tag == "Position and hasSource some Ball"
    assert found.regions["goal"].has((4.5, 0))


@pytest.mark.parametrize(
    ("features", "regions", "message"),
    [
        (["ball"], [], "not NAME=VALUE"),
        (["3=A"], [], "can't be a name"),
        ([], ["goal=3"], "three or more points"),
        ([], ["goal={box: "], "not YAML"),
    ],
)
def test_a_mistake_in_an_option_is_told(features: list[str], regions: list[str], message: str) -> None:
    with pytest.raises(InputError, match=message):
        of_options(features, regions)


def test_targets_of_the_environment_are_features_if_they_can_be_named() -> None:
    targets = (Target("ball", "Ball", "/ball"), Target("ball(piff)", "Ball", "/piff"), Target("in", "Ball", "/in"))
    found = of_targets(Environment(targets=targets))
    assert {name: each.topic for name, each in found.features.items()} == {"ball": "/ball"}


def test_a_query_needs_the_features_that_it_names_and_looks_often_enough_for_its_intervals() -> None:
    declared = of_options(["a=A", "b=B", "c=C"], [])
    found = query("always (a.x > 1 -> eventually[0, 50ms] c.ok)", declared, Timing(hold_ns=7))
    assert [each.name for each in found.features] == ["a", "c"]
    assert (found.timing.beat_ns, found.timing.hold_ns) == (50_000_000, 7)
