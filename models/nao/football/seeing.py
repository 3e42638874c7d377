"""Finds the ball in an image: subsampled channels, the convex hull of the green field, and the ball within it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
import numpy.typing as npt

from football.camera import HEIGHT, WIDTH, Camera, Pose
from football.field import BALL_RADIUS_M, Bytes

cv2.setNumThreads(1)

Points = npt.NDArray[np.float32]
"""Pixels of the full image, (n, 2): u, v."""

SIZES = (640, 320, 160, 80, 40)
"""Widths of the subsampled images; each is 3/4 as high."""
_GREEN_V = 112
_GREEN_Y = (40, 140)
_BRIGHTER = 34
"""Lines and balls are brighter than the grass by at least this much luma."""
_LIKELY = (0.72, 1.5)
"""The radius of the largest disc inside a ball's bright pixels, at least and at most, in radii of a ball at that place.
A line's is below 0.5."""
_MOST_CANDIDATES = 4
_SMALLEST = 6.0
"""The radius in pixels of the full image of a ball 4.5 m away. Balls further away are not searched."""
_RINGS = (0.3, 0.15, 0.08, 0.06)
"""The largest distance from the circle, in radii, of the points that the next circle is fitted to. It shrinks, so that
a line that touches the ball is excluded step by step."""
_SECTORS, _FEWEST_SECTORS = 16, 10
"""A ball's outline has points in at least this many sectors; the end of a line at the edge of the image has fewer."""


@dataclass(frozen=True)
class Seen:
    """A ball in an image: its centre and radius in pixels of the full image."""

    u: float
    v: float
    radius: float


def subsampled(channel: Bytes) -> dict[int, Bytes]:
    """Return a channel in all `SIZES`, by width; each is computed from the next larger one."""
    images: dict[int, Bytes] = {}
    for width in SIZES:
        size = (width, width * HEIGHT // WIDTH)
        if channel.shape != size[::-1]:
            enlarges = channel.shape[1] < width
            channel = cv2.resize(channel, size, interpolation=cv2.INTER_LINEAR if enlarges else cv2.INTER_AREA)  # type: ignore[assignment]
        images[width] = channel
    return images


def field_hull(luma: Bytes, v: Bytes) -> Points | None:
    """Return the convex hull of the green area of small Y and V images, (n, 2), in pixels of the full image.

    None if hardly any pixel is green.
    """
    mask = ((v < _GREEN_V) & (luma > _GREEN_Y[0]) & (luma < _GREEN_Y[1])).astype(np.uint8)
    mask = cv2.morphologyEx(mask, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))  # type: ignore[assignment]
    outlines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    large = [outline for outline in outlines if len(outline) > 2 and cv2.contourArea(outline) > 0.005 * mask.size]
    if not large:
        return None
    hull = cv2.convexHull(np.concatenate(large)).reshape(-1, 2).astype(np.float32)
    scale = WIDTH / mask.shape[1]
    middle = (np.array(mask.shape[::-1], np.float32) - 1) / 2
    grown = (hull - middle) * ((middle + 0.5) / middle) + middle  # from the centres of the outer pixels to their edges
    full: Points = ((grown + 0.5) * scale - 0.5).astype(np.float32)
    return full


def find_ball(hull: Points, fine: Bytes, coarse: Bytes) -> Seen | None:
    """Return the ball inside the hull, or None.

    It is found by its size in `coarse`, the 320 x 240 luma, and measured in `fine`, the 640 x 480 luma.
    """
    scale = fine.shape[1] / coarse.shape[1]
    inside = np.zeros(coarse.shape, np.uint8)
    corners = (hull + 0.5) / scale - 0.5
    cv2.fillConvexPoly(inside, corners.round().astype(np.int32), 255)
    grass = float(np.median(coarse[::8, ::8][inside[::8, ::8] > 0])) if inside[::8, ::8].any() else 0.0
    bright = cv2.bitwise_and(inside, cv2.threshold(coarse, grass + _BRIGHTER, 255, cv2.THRESH_BINARY)[1])
    discs = cv2.distanceTransform(bright, cv2.DIST_L2, 5)
    likeness = discs * (scale / _radii())[:: round(scale), None]
    for _ in range(_MOST_CANDIDATES):
        _, best, _, (column, row) = cv2.minMaxLoc(likeness)
        if best < _LIKELY[0]:
            return None
        u, v = (column + 0.5) * scale - 0.5, (row + 0.5) * scale - 0.5
        radius = float(_radii()[min(HEIGHT - 1, round(v))])
        if best <= _LIKELY[1]:
            seen = _measured(fine, u, v, radius, grass + _BRIGHTER)
            if seen is not None:
                return seen
        cv2.circle(likeness, (column, row), math.ceil(max(best, 1.0) * radius / scale) + 1, 0, -1)
    return None


def _measured(fine: Bytes, u: float, v: float, radius: float, threshold: float) -> Seen | None:
    """Fit a circle to the outline around a candidate; None if no circle of about the right size fits."""
    reach = math.ceil(1.6 * radius) + 2
    left, top = max(0, round(u) - reach), max(0, round(v) - reach)
    window = fine[top : round(v) + reach + 1, left : round(u) + reach + 1]
    _, bright = cv2.threshold(cv2.GaussianBlur(window, (3, 3), 0), threshold, 255, cv2.THRESH_BINARY)
    outlines, _ = cv2.findContours(bright, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    if not outlines:
        return None
    points = np.concatenate(outlines).reshape(-1, 2) + np.array([left, top], np.float64)
    inner = (points[:, 0] > 0) & (points[:, 0] < WIDTH - 1) & (points[:, 1] > 0) & (points[:, 1] < HEIGHT - 1)
    points = points[inner]
    found = Seen(u, v, radius)
    for width in _RINGS:
        apart = np.hypot(points[:, 0] - found.u, points[:, 1] - found.v) - found.radius
        ring = points[np.abs(apart) < max(width * found.radius, 1.0)]
        if not _is_round(ring - (found.u, found.v)):
            return None
        found = _circle(ring)
        if not 0.7 < found.radius / radius < 1.4 or math.hypot(found.u - u, found.v - v) > radius:
            return None
    return found


def _is_round(points: npt.NDArray[np.float64]) -> bool:
    """Whether points lie on enough sides of the origin."""
    sector = np.floor(np.arctan2(points[:, 1], points[:, 0]) * (_SECTORS / (2 * math.pi))).astype(np.int64)
    return len(np.unique(sector)) >= _FEWEST_SECTORS


def _circle(points: npt.NDArray[np.float64]) -> Seen:
    """The circle of least squares (Kåsa): x² + y² = 2 a x + 2 b y + c."""
    middle = points.mean(axis=0)
    x, y = (points - middle).T
    matrix = np.column_stack([2 * x, 2 * y, np.ones(len(x))])
    (a, b, c), *_ = np.linalg.lstsq(matrix, x * x + y * y, rcond=None)
    return Seen(float(a + middle[0]), float(b + middle[1]), math.sqrt(max(c + a * a + b * b, 0.0)))


@cache
def _radii() -> npt.NDArray[np.float64]:
    """How large a ball looks by the row of its centre, as the camera stands; infinite where it would be too small."""
    camera = Camera(Pose(0.0, 0.0, 0.0))
    radii = np.full(HEIGHT, np.inf)
    for row in range(HEIGHT):
        place = camera.point_at_height((WIDTH - 1) / 2, row, BALL_RADIUS_M)
        if place is not None:
            away = math.hypot(*place, camera.height - BALL_RADIUS_M)
            limb = place[1] + BALL_RADIUS_M * (1 + BALL_RADIUS_M**2 / away**2 / 2)
            pixel = camera.pixel(np.array([place[0], limb, BALL_RADIUS_M]))
            if pixel is not None and abs(pixel[0] - (WIDTH - 1) / 2) >= _SMALLEST:
                radii[row] = abs(pixel[0] - (WIDTH - 1) / 2)
    return radii
