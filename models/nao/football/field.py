"""The field: its dimensions in metres, and a picture of it from above as a texture for the renderer.

The origin is the field's centre, x points to the opponent's goal, y to the left.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
import numpy.typing as npt

Bytes = npt.NDArray[np.uint8]
Colour = tuple[int, int, int]
"""Luma Y and chroma U (Cb) and V (Cr) as in JPEG: 0-255; a chroma of 128 is grey."""

LENGTH_M, WIDTH_M = 9.0, 6.0
CARPET_M = (10.4, 7.4)
"""The green carpet, with its border around the lines."""
LINE_M = 0.05
BALL_RADIUS_M = 0.05
SPARE_BALLS = ((0.9, 4.3), (-2.6, -4.2), (5.8, 0.6))
"""Positions of distractor balls beside the field."""

GREEN: Colour = (88, 112, 92)
WHITE: Colour = (225, 128, 128)
FLOOR: Colour = (102, 116, 142)
WALL: Colour = (150, 132, 122)

TEXELS_PER_M = 200.0
_AREAS_M = ((0.6, 2.2), (1.65, 4.0))
"""Depth and width of the goal area and the penalty area."""
_SHIFT = 4
_HALF = 1 << (_SHIFT - 1)
"""Drawing coordinates are in sixteenths of a texel, from the centre of the first texel."""
_TUFT = 256


@dataclass(frozen=True)
class Texture:
    """The carpet from above: luma, and chroma at half the resolution."""

    luma: Bytes
    chroma: Bytes
    from_field: npt.NDArray[np.float64]
    """Takes field coordinates (x, y, 1) in metres to texels of the luma."""


@cache
def texture() -> Texture:
    """Return the texture of the carpet; it is computed once per process."""
    luma, chroma = _carpet(GREEN[:1]), _carpet(GREEN[1:])
    random = np.random.default_rng(1)
    grass = cv2.GaussianBlur(random.normal(0.0, 9.0, (_TUFT, _TUFT)).astype(np.float32), (0, 0), 1.5)
    rows, columns = (-(-size // _TUFT) for size in luma.shape[:2])
    tufts = np.tile(grass.round().astype(np.int8), (rows, columns))[: luma.shape[0], : luma.shape[1]]
    luma = cv2.add(luma, np.ascontiguousarray(tufts), dtype=cv2.CV_8U)  # type: ignore[assignment]
    _draw_lines(luma, WHITE[:1])
    _draw_lines(chroma, WHITE[1:])
    halved = cv2.resize(chroma, (luma.shape[1] // 2, luma.shape[0] // 2), interpolation=cv2.INTER_AREA)
    half = np.array(CARPET_M) / 2
    from_field = np.array(
        [
            [TEXELS_PER_M, 0.0, half[0] * TEXELS_PER_M - 0.5],
            [0.0, TEXELS_PER_M, half[1] * TEXELS_PER_M - 0.5],
            [0.0, 0.0, 1.0],
        ]
    )
    return Texture(luma, halved.astype(np.uint8), from_field)


def _carpet(colour: Sequence[int]) -> Bytes:
    shape = (round(CARPET_M[1] * TEXELS_PER_M), round(CARPET_M[0] * TEXELS_PER_M))
    return np.full(shape if len(colour) == 1 else (*shape, len(colour)), colour, np.uint8)


def _draw_lines(image: Bytes, colour: Sequence[int]) -> None:
    thickness = round(LINE_M * TEXELS_PER_M)

    def length(metres: float) -> int:
        return round(metres * TEXELS_PER_M * (1 << _SHIFT))

    def texel(x: float, y: float) -> tuple[int, int]:
        return length(x + CARPET_M[0] / 2) - _HALF, length(y + CARPET_M[1] / 2) - _HALF

    def rectangle(left: float, low: float, right: float, high: float) -> None:
        cv2.rectangle(image, texel(left, low), texel(right, high), colour, thickness, cv2.LINE_AA, _SHIFT)

    rectangle(-LENGTH_M / 2, -WIDTH_M / 2, LENGTH_M / 2, WIDTH_M / 2)
    rectangle(0.0, -WIDTH_M / 2, 0.0, WIDTH_M / 2)
    cv2.circle(image, texel(0.0, 0.0), length(0.75), colour, thickness, cv2.LINE_AA, _SHIFT)
    for side in (-1, 1):
        goal_line = side * LENGTH_M / 2
        for depth, width in _AREAS_M:
            rectangle(goal_line - side * depth, -width / 2, goal_line, width / 2)
        cv2.circle(image, texel(goal_line - side * 1.3, 0.0), length(LINE_M), colour, -1, cv2.LINE_AA, _SHIFT)
