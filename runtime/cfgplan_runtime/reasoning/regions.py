"""Regions of the plane, points in them, and the eight relations of RCC8 between them (Randell, Cui and Cohn 1992).

A region is closed: its edge belongs to it. shapely compares the coordinates exactly, without a tolerance.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from cfgplan.errors import CfgplanError
from cfgplan.extras import needed

if TYPE_CHECKING:
    from shapely import Polygon

_QUARTER_SEGMENTS = 64
_REGION_FORMS = "write {polygon: [[x, y], ...]}, {circle: [x, y], radius: r} or {box: [x, y, x, y]}"


class NotARegionError(CfgplanError):
    """A value that is no region; `mend` lists the forms of regions."""

    def __init__(self, message: str, mend: str = _REGION_FORMS) -> None:
        super().__init__(message)
        self.mend = mend


class NotAPointError(CfgplanError):
    """A value that is no point of the plane."""


@dataclass(frozen=True)
class Region:
    """A region; a circle is exact for points, and for relations a polygon of 256 corners."""

    shape: Polygon
    circle: tuple[float, float, float] | None = None

    def has(self, point: tuple[float, float]) -> bool:
        """Whether a point is in the region or on its edge."""
        if self.circle is not None:
            x, y, radius = self.circle
            return math.hypot(point[0] - x, point[1] - y) <= radius
        from shapely import Point

        return bool(self.shape.covers(Point(point)))


def region_from(value: Any) -> Region:
    """The region of a value: a list of three or more points, or a mapping with `polygon`, `circle` or `box`.

    Raises NotARegionError, and InputError without the package shapely.
    """
    needed("regions", "shapely")
    from shapely import Polygon, box

    if not isinstance(value, Mapping):
        value = {"polygon": value}
    shape = circle = None
    kinds = {"polygon", "circle", "box"} & set(value)
    if len(kinds) != 1:
        raise NotARegionError("a region is one polygon, circle or box")
    more = set(value) - kinds - ({"radius"} if "circle" in kinds else set())
    if more:
        raise NotARegionError(f"a region has no `{min(more, key=str)}`")
    if "circle" in kinds:
        x, y = _numbers(value["circle"], 2, "the centre of a circle is a pair of numbers")
        (radius,) = _numbers([value.get("radius")], 1, "a circle has a radius, which is a number")
        circle = (x, y, radius)
        from shapely import Point

        shape = Point(x, y).buffer(radius, quad_segs=_QUARTER_SEGMENTS) if radius > 0 else Polygon()
    elif "box" in kinds:
        shape = box(*_sides(value["box"]))
    else:
        shape = Polygon(_corners(value["polygon"]))
    if shape.is_empty or not shape.area > 0:
        raise NotARegionError("the region is empty")
    if not shape.is_valid:
        raise NotARegionError("the polygon crosses itself", "list its corners in the order in which its edge runs")
    return Region(shape, circle)


def point_from(value: Any) -> tuple[float, float]:
    """The point that a value describes: a mapping with `x` and `y`, or a list that begins with them.

    Raises NotAPointError.
    """
    try:
        x, y = (value["x"], value["y"]) if isinstance(value, Mapping) else (value[0], value[1])
        point = (float(x), float(y))
    except (TypeError, ValueError, LookupError):
        raise NotAPointError("no point: it has neither x and y nor two numbers") from None
    if isinstance(x, (str, bool)) or isinstance(y, (str, bool)):
        raise NotAPointError("no point: its x or y is not a number")
    return point


def rcc8(left: Region, right: Region) -> str:
    """The one of the eight relations that holds between two regions: one of `conditions.RCC8`.

    Decided by the nine intersections of interiors, edges and exteriors (Egenhofer 1991).
    """
    matrix = left.shape.relate(right.shape)
    interiors_meet, edges_meet = matrix[0] != "F", matrix[4] != "F"
    if not interiors_meet:
        return "ec" if any(matrix[place] != "F" for place in (1, 3, 4)) else "dc"
    is_part, has_part = matrix[2] == "F", matrix[6] == "F"
    if is_part and has_part:
        return "eq"
    if is_part:
        return "tpp" if edges_meet else "ntpp"
    if has_part:
        return "tppi" if edges_meet else "ntppi"
    return "po"


def _numbers(value: Any, count: int, otherwise: str) -> list[float]:
    try:
        if any(isinstance(one, (str, bool)) for one in value):
            raise NotARegionError(otherwise)
        numbers = [float(one) for one in value]
    except (TypeError, ValueError):
        raise NotARegionError(otherwise) from None
    if len(numbers) != count or not all(map(math.isfinite, numbers)):
        raise NotARegionError(otherwise)
    return numbers


def _sides(value: Any) -> list[float]:
    """The least x and y, and the greatest x and y, of a box."""
    sides = _numbers(value, 4, "a box has four numbers: its least x and y, its greatest x and y")
    x, y, far_x, far_y = sides
    if x > far_x or y > far_y:
        least, greatest, axis = (x, far_x, "x") if x > far_x else (y, far_y, "y")
        raise NotARegionError(
            f"the box is reversed: its least {axis} is {least:g}, its greatest {greatest:g}",
            f"write {{box: [{min(x, far_x):g}, {min(y, far_y):g}, {max(x, far_x):g}, {max(y, far_y):g}]}}",
        )
    return sides


def _corners(value: Any) -> list[list[float]]:
    otherwise = "a polygon is a list of three or more points, each a pair of numbers"
    if isinstance(value, (str, bytes, Mapping)):
        raise NotARegionError(otherwise)
    try:
        corners = [_numbers([one["x"], one["y"]] if isinstance(one, Mapping) else one, 2, otherwise) for one in value]
    except (TypeError, LookupError):
        raise NotARegionError(otherwise) from None
    if len(corners) < 3:
        raise NotARegionError(otherwise)
    return corners
