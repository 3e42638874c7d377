"""The picture of a robot's camera: floor and walls, crates by ray casting, and noise."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from itertools import product

import numpy as np
import numpy.typing as npt

from warehouse.hall import CAMERA_M, COLOURS, CRATE_M, HALL_M, HEIGHT, WIDTH, Crate, Floats, Pose, pixel, rays

Bytes = npt.NDArray[np.uint8]

NOISE = 4.0
"""The standard deviation of the noise, on the scale 0-255."""
_SPARE = 32
_SHADES = (0.8, 0.65, 1.0)
"""The brightness of a crate's sides that face x, y and up."""
_WALL, _FLOOR, _TILE = 190, 120, 14


class Photographer:
    """Renders the camera's pictures. The noise is drawn once, and shifted at random for each picture."""

    def __init__(self, seed: int) -> None:
        self._random = np.random.default_rng(seed)
        noise = self._random.normal(0.0, NOISE, (HEIGHT + _SPARE, WIDTH + _SPARE, 3))
        self._noise = np.clip(noise, -20, 20).round().astype(np.int8).view(np.uint8)
        self._rays = rays()
        with np.errstate(divide="ignore"):
            reach = np.where(self._rays[..., 2] < 0, -CAMERA_M / self._rays[..., 2], np.inf)
        self._sides = np.multiply.outer(COLOURS, _SHADES).swapaxes(1, 2).astype(np.uint8)
        self._floor = self._rays[..., :2] * np.minimum(reach, 50.0)[..., None]

    def picture(self, pose: Pose, crates: Iterable[Crate]) -> Bytes:
        """Return the picture of `crates` from a camera at `pose`, as RGB: (240, 320, 3)."""
        picture = np.repeat(self._hall(pose)[..., None], 3, axis=2)
        for crate in sorted(crates, key=lambda one: -math.hypot(one.x - pose.x, one.y - pose.y)):
            self._draw(picture, pose, crate)
        row, column = self._random.integers(0, _SPARE, 2)
        # The noise can't overflow: no shade is near 0 or 255.
        picture += self._noise[row : row + HEIGHT, column : column + WIDTH]
        return picture

    def _hall(self, pose: Pose) -> Bytes:
        x, y = _turned(self._floor, pose.heading)
        x, y = x + np.float32(pose.x), y + np.float32(pose.y)
        tiles = (np.floor(x).astype(np.int16) + np.floor(y).astype(np.int16)) & 1
        inside = (np.abs(x) < HALL_M[0]) & (np.abs(y) < HALL_M[1])
        return np.where(inside, _FLOOR + _TILE * tiles, _WALL).astype(np.uint8)

    def _draw(self, picture: Bytes, pose: Pose, crate: Crate) -> None:
        """Cast the rays of the pixels around a crate, and colour those that meet it."""
        window = _window(pose, crate)
        if window is None:
            return
        part = self._rays[window]
        directions = np.stack([*_turned(part[..., :2], pose.heading), part[..., 2]])
        directions[directions == 0] = 1e-9
        half = CRATE_M / 2
        low = np.array([crate.x - half - pose.x, crate.y - half - pose.y, -CAMERA_M], np.float32)[:, None, None]
        one, other = low / directions, (low + np.float32(CRATE_M)) / directions
        enters, leaves = np.minimum(one, other), np.maximum(one, other).min(axis=0)
        is_met = enters.max(axis=0) < leaves
        picture[window][is_met] = self._sides[crate.colour][enters[:, is_met].argmax(axis=0)]


def _turned(ahead_left: Floats, heading: float) -> Iterator[Floats]:
    """Directions ahead and left of a robot as x and y of the hall."""
    cos, sin = np.float32(math.cos(heading)), np.float32(math.sin(heading))
    yield cos * ahead_left[..., 0] - sin * ahead_left[..., 1]
    yield sin * ahead_left[..., 0] + cos * ahead_left[..., 1]


def _window(pose: Pose, crate: Crate) -> tuple[slice, slice] | None:
    """The rows and columns in which a crate may be seen."""
    half = CRATE_M / 2
    corners = product((crate.x - half, crate.x + half), (crate.y - half, crate.y + half), (0, CRATE_M))
    seen = [pixel(pose, *corner) for corner in corners]
    pixels = [one for one in seen if one is not None]
    if len(pixels) < len(seen):
        return None
    (left, top), (right, bottom) = np.floor(np.min(pixels, axis=0)), np.ceil(np.max(pixels, axis=0))
    rows = slice(max(0, int(top)), min(HEIGHT, int(bottom) + 1))
    columns = slice(max(0, int(left)), min(WIDTH, int(right) + 1))
    return (rows, columns) if rows.start < rows.stop and columns.start < columns.stop else None
