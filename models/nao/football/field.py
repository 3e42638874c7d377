"""The field: its measures in metres, and its look from above as a texture for the renderer.

The origin is the field's centre, x points to the opponent's goal, y to the left.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
import numpy.typing as npt

Bytes = npt.NDArray[np.uint8]
Colour = tuple[int, int, int]
"""Luma Y and the colour differences U (Cb) and V (Cr), as JPEG has them: 0-255, 128 is no colour."""

LENGTH_M, WIDTH_M = 9.0, 6.0
CARPET_M = (10.4, 7.4)
"""The green carpet, with its border around the lines."""
LINE_M = 0.05
BALL_RADIUS_M = 0.05
SPARE_BALLS = ((0.9, 4.3), (-2.6, -4.2), (5.8, 0.6))
"""Balls that lie beside the field, and are not the ball."""

GREEN: Colour = (88, 112, 92)
WHITE: Colour = (225, 128, 128)
FLOOR: Colour = (102, 116, 142)
WALL: Colour = (150, 132, 122)

TEXELS_PER_M = 200.0
_AREAS_M = ((0.6, 2.2), (1.65, 4.0))
"""Goal area and penalty area: depth and width."""
_SHIFT = 4


@dataclass(frozen=True)
class Texture:
    """The carpet from above: luma, and the colour differences at half the resolution."""

    luma: Bytes
    chroma: Bytes
    from_field: npt.NDArray[np.float64]
    """Takes field coordinates (x, y, 1) in metres to texels of the luma."""


@cache
def texture() -> Texture:
    """The carpet; made once per process."""
    size = (round(CARPET_M[0] * TEXELS_PER_M), round(CARPET_M[1] * TEXELS_PER_M))
    lines = np.zeros((size[1], size[0]), np.uint8)
    _rectangle(lines, -LENGTH_M / 2, -WIDTH_M / 2, LENGTH_M / 2, WIDTH_M / 2)
    _rectangle(lines, 0.0, -WIDTH_M / 2, 0.0, WIDTH_M / 2)
    for side in (-1, 1):
        goal_line = side * LENGTH_M / 2
        for depth, width in _AREAS_M:
            _rectangle(lines, goal_line - side * depth, -width / 2, goal_line, width / 2)
        cv2.circle(lines, _texel(goal_line - side * 1.3, 0.0), _length(LINE_M), 255, -1, cv2.LINE_AA, _SHIFT)
    thickness = round(LINE_M * TEXELS_PER_M)
    cv2.circle(lines, _texel(0.0, 0.0), _length(0.75), 255, thickness, cv2.LINE_AA, _SHIFT)
    share = lines[..., None].astype(np.float32) / 255
    grass = cv2.GaussianBlur(np.random.default_rng(1).normal(0.0, 9.0, lines.shape).astype(np.float32), (0, 0), 1.5)
    colours = share * np.array(WHITE, np.float32) + (1 - share) * np.array(GREEN, np.float32)
    colours[..., 0] += grass * (1 - share[..., 0])
    pixels = np.clip(colours, 0, 255).astype(np.uint8)
    chroma = cv2.resize(pixels[..., 1:], (size[0] // 2, size[1] // 2), interpolation=cv2.INTER_AREA)
    half = np.array(CARPET_M) / 2
    from_field = np.array(
        [
            [TEXELS_PER_M, 0.0, half[0] * TEXELS_PER_M - 0.5],
            [0.0, TEXELS_PER_M, half[1] * TEXELS_PER_M - 0.5],
            [0.0, 0.0, 1.0],
        ]
    )
    return Texture(np.ascontiguousarray(pixels[..., 0]), chroma.astype(np.uint8), from_field)


def _rectangle(lines: Bytes, left: float, low: float, right: float, high: float) -> None:
    thickness = round(LINE_M * TEXELS_PER_M)
    cv2.rectangle(lines, _texel(left, low), _texel(right, high), 255, thickness, cv2.LINE_AA, _SHIFT)


def _texel(x: float, y: float) -> tuple[int, int]:
    return _length(x + CARPET_M[0] / 2), _length(y + CARPET_M[1] / 2)


def _length(metres: float) -> int:
    return round(metres * TEXELS_PER_M * (1 << _SHIFT))
