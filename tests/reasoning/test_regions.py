"""Regions, points in them, and the relations of RCC8."""

from __future__ import annotations

import pytest
from cfgplan_runtime.reasoning.conditions import RCC8
from cfgplan_runtime.reasoning.parser import parse
from cfgplan_runtime.reasoning.reader import Vocabulary
from cfgplan_runtime.reasoning.regions import NotARegionError, Region, point_from, rcc8, region_from
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cfgplan.errors import InputError

Box = tuple[int, int, int, int]


def _box(x: int, y: int, width: int, height: int) -> Box:
    return x, y, x + width, y + height


boxes = st.builds(_box, st.integers(0, 4), st.integers(0, 4), st.integers(1, 4), st.integers(1, 4))
INVERSE = {"tpp": "tppi", "ntpp": "ntppi", "tppi": "tpp", "ntppi": "ntpp"}


def region(box: Box) -> Region:
    return region_from({"box": list(box)})


def relation_of_boxes(one: Box, other: Box) -> str:
    """By the definition of the relations, from the coordinates alone."""
    if one == other:
        return "eq"
    ranges = [(one[axis], one[axis + 2], other[axis], other[axis + 2]) for axis in (0, 1)]
    if any(a_end < b_begin or b_end < a_begin for a_begin, a_end, b_begin, b_end in ranges):
        return "dc"
    if any(a_end == b_begin or b_end == a_begin for a_begin, a_end, b_begin, b_end in ranges):
        return "ec"
    for name, pairs in (("tpp", ranges), ("tppi", [(c, d, a, b) for a, b, c, d in ranges])):
        if all(outer_begin <= begin and end <= outer_end for begin, end, outer_begin, outer_end in pairs):
            inside = all(outer_begin < begin and end < outer_end for begin, end, outer_begin, outer_end in pairs)
            return "n" + name if inside else name
    return "po"


@settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])  # beside load shapely's import takes long
@given(boxes, boxes)
def test_the_relation_of_two_boxes_is_what_their_sides_say(one: Box, other: Box) -> None:
    found = rcc8(region(one), region(other))
    assert found == relation_of_boxes(one, other)
    assert found in RCC8
    assert rcc8(region(other), region(one)) == INVERSE.get(found, found)


def test_regions_that_share_only_a_corner_are_externally_connected() -> None:
    assert rcc8(region((0, 0, 1, 1)), region((1, 1, 2, 2))) == "ec"


def test_a_region_in_the_hollow_of_another_is_disconnected_from_it() -> None:
    hollow = region_from([[0, 0], [5, 0], [5, 5], [4, 5], [4, 1], [1, 1], [1, 5], [0, 5]])
    assert rcc8(region((2, 2, 3, 3)), hollow) == "dc"
    assert rcc8(region((2, 1, 3, 3)), hollow) == "ec"


def test_the_edge_belongs_to_a_region() -> None:
    circle = region_from({"circle": [0, 0], "radius": 5})
    assert circle.has((3, 4))
    assert not circle.has((3.0001, 4))
    assert region((0, 0, 1, 1)).has((1, 0.5))
    assert not region((0, 0, 1, 1)).has((1.0001, 0.5))


@pytest.mark.parametrize("value", [{"x": 1, "y": 2}, [1, 2], (1.0, 2, 9), {"x": 1, "y": 2, "z": 3}])
def test_points_are_mappings_or_lists(value: object) -> None:
    assert point_from(value) == (1.0, 2.0)


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ({"circle": [0, 0]}, "radius"),
        ({"circle": [0, 0], "radius": -1}, "empty"),
        ({"box": [0, 0, 1]}, "four numbers"),
        ({"box": [0, 0, 1, float("nan")]}, "four numbers"),
        ({"box": [4.5, -3, 0, 3]}, "reversed: its least x is 4.5, its greatest 0"),
        ({"box": [0, 3, 4.5, -3]}, "reversed: its least y is 3, its greatest -3"),
        ({"box": [0, 0, 0, 1]}, "empty"),
        ({"polygon": [[0, 0], [1, 1]]}, "three or more"),
        ({"polygon": [[0, 0], [1, 1], [2, 2]]}, "empty"),
        ({"polygon": [[0, 0], [2, 2], [2, 0], [0, 1]]}, "crosses itself"),
        ({"polygon": "abc"}, "three or more"),
        ({"polygon": [[0, 0], [1, 0], ["a", 1]]}, "three or more"),
        ({"polygon": [[0, 0], [1, 0], [1, 1]], "circle": [0, 0]}, "one polygon, circle or box"),
        ({"box": [0, 0, 1, 1], "colour": 3}, "no `colour`"),
        (3, "three or more"),
        ({}, "one polygon, circle or box"),
    ],
)
def test_what_is_no_region_is_refused(value: object, message: str) -> None:
    with pytest.raises(NotARegionError, match=message):
        region_from(value)


def test_without_shapely_a_region_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cfgplan.extras.find_spec", lambda _: None)
    with pytest.raises(InputError) as refused:
        region((0, 0, 1, 1))
    assert refused.value.faults[0].mend == "pip install 'cfgplan[queries]'"
    with pytest.raises(InputError, match="shapely"):
        parse("in(ball, hull)", Vocabulary(("ball", "hull")))
