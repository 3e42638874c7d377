"""Find crates in a picture by their colour, and compute their positions on the floor."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TypedDict

import numpy as np
import numpy.typing as npt

from warehouse.hall import CAMERA_M, FOCAL, HEIGHT, WIDTH, Pose, on_floor
from warehouse.picture import Bytes

_LEAST_COLOUR = 35
"""The least difference of red and blue on a crate; everything else is grey."""
_FEWEST_COLUMNS = 3
_LEAST_OF_WIDTH = 0.25
"""A row belongs to a crate if at least this share of its width is coloured."""
_MARGIN = 3
_MIDDLE_M = 0.3
"""The distance on the floor from a crate's nearest edge to its centre, averaged over directions."""
_WIDEST_M = 0.9
_FARTHEST_M = 7.5
_POSE_M = 0.05
_SAME_M = 0.7
"""Obstacles of two robots are the same if they are at most this far apart."""


class Box(TypedDict):
    """The bounding box of a crate in pixels; `grain` is the step between the examined rows and columns."""

    left: float
    right: float
    top: float
    bottom: float
    grain: int


class Obstacle(TypedDict):
    """The position of a crate on the floor and its expected error, in metres."""

    x: float
    y: float
    error: float


def boxes(image: Bytes, grain: int) -> list[Box]:
    """Return the crates that are visible down to the floor, from left to right, using every `grain`th row and column.

    If a crate hides another of its colour, both give one box that is too wide for a crate; `obstacles` drops it.
    """
    coarse = image[grain // 2 :: grain, grain // 2 :: grain]
    warmth = coarse[..., 0].astype(np.int16) - coarse[..., 2]
    found = [*_boxes(warmth > _LEAST_COLOUR, grain), *_boxes(warmth < -_LEAST_COLOUR, grain)]
    whole = [one for one in found if not _is_cut_off(one) and not any(_hides(other, one) for other in found)]
    return sorted(whole, key=lambda one: one["left"])


def obstacles(found: Sequence[Box], pose: Pose) -> list[Obstacle]:
    """Return the positions of the crates that were found in a picture taken at `pose`."""
    placed = []
    for box in found:
        place = on_floor(pose, (box["left"] + box["right"]) / 2, box["bottom"], _MIDDLE_M)
        if place is None:
            continue
        x, y, distance = place
        width = (box["right"] - box["left"]) / FOCAL * math.hypot(distance, CAMERA_M)
        if distance <= _FARTHEST_M and width <= _WIDEST_M:
            error = _POSE_M + box["grain"] / 4 * distance * distance / (FOCAL * CAMERA_M)
            placed.append(Obstacle(x=round(x, 3), y=round(y, 3), error=round(error, 3)))
    return placed


def merged(one: Sequence[Obstacle], other: Sequence[Obstacle]) -> list[Obstacle]:
    """Return the obstacles of both lists.

    Two entries for one crate become their mean, weighted by the inverse squares of their errors.
    """
    left = list(other)
    together = []
    for obstacle in one:
        near = min(left, key=lambda candidate: _apart(candidate, obstacle), default=None)
        if near is None or _apart(near, obstacle) > _SAME_M:
            together.append(obstacle)
        else:
            left.remove(near)
            together.append(_mean(obstacle, near))
    return together + left


def _mean(one: Obstacle, other: Obstacle) -> Obstacle:
    weights = one["error"] ** -2, other["error"] ** -2
    x, y = (np.average((one[axis], other[axis]), weights=weights) for axis in ("x", "y"))
    return Obstacle(x=round(float(x), 3), y=round(float(y), 3), error=round(sum(weights) ** -0.5, 3))


def _apart(one: Obstacle, other: Obstacle) -> float:
    return math.hypot(one["x"] - other["x"], one["y"] - other["y"])


def _boxes(mask: npt.NDArray[np.bool_], grain: int) -> Iterator[Box]:
    """One box for each run of neighbouring columns that have the colour."""
    has_colour = np.concatenate([[False], mask.sum(axis=0) >= 2, [False]])
    edges = np.flatnonzero(has_colour[1:] != has_colour[:-1])
    for start, stop in edges.reshape(-1, 2).tolist():
        width = stop - start
        rows = np.flatnonzero(mask[:, start:stop].sum(axis=1) >= max(1, _LEAST_OF_WIDTH * width))
        if width * grain >= _FEWEST_COLUMNS and len(rows):
            sides = (start, stop, int(rows[0]), int(rows[-1]) + 1)
            left, right, top, bottom = (grain * side - 0.5 for side in sides)
            yield Box(left=left, right=right, top=top, bottom=bottom, grain=grain)


def _is_cut_off(box: Box) -> bool:
    """Whether it reaches the edge of the picture at the left, the right or below."""
    grain = box["grain"]
    return box["left"] < grain or box["right"] > WIDTH - grain or box["bottom"] > HEIGHT - grain


def _hides(nearer: Box, box: Box) -> bool:
    """Whether `nearer`, which stands lower in the picture, may hide a part of `box`."""
    gap = _MARGIN * box["grain"] / 2
    return (
        nearer["bottom"] > box["bottom"]
        and nearer["left"] < box["right"] + gap
        and nearer["right"] > box["left"] - gap
        and nearer["top"] < box["bottom"] + gap
    )
