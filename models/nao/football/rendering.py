"""Renders the bottom camera's pictures in YUYV 4:2:2: carpet and lines by a homography, balls by ray casting, noise."""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np
import numpy.typing as npt

from football import field
from football.camera import CENTRE, FOCAL, HEIGHT, WIDTH, Camera
from football.field import BALL_RADIUS_M, Bytes, Colour

cv2.setNumThreads(1)

NOISE = 4.0
"""The standard deviation of the luma's noise, on the scale 0-255."""
_GREY = 128
_SPARE = 64
_PANEL_COS = math.cos(math.radians(22))
_PANEL: Colour = (196, 128, 128)
_AMBIENT = 0.72
_WALL_ROWS = 6
_CHROMA = np.array([[0.5, 0.0, -0.25], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
"""Maps pixels of the luma to pixels of the chroma, which has every second column."""

_Floats = npt.NDArray[np.float32]


class Renderer:
    """Renders the camera's pictures. The noise is drawn once, and shifted at random for each picture."""

    def __init__(self, seed: int) -> None:
        self._random = np.random.default_rng(seed)
        shape = (HEIGHT + _SPARE, WIDTH + _SPARE)
        self._noise = np.clip(self._random.normal(0.0, NOISE, shape), -127, 127).round().astype(np.int8)

    def picture(self, camera: Camera, ball: tuple[float, float], light: float = 1.0) -> Bytes:
        """Return a picture, (480, 640, 2): luma, and chroma with U in even and V in odd columns. `ball` is in metres.

        A `light` below 1 makes the picture darker and greyer; the noise stays the same.
        """
        luma, chroma = _ground(camera)
        _wall(luma, chroma, camera)
        for place in sorted((*field.SPARE_BALLS, ball), key=lambda place: -_distance(camera, place)):
            _ball(luma, chroma, camera, place)
        if light < 1:
            luma = cv2.convertScaleAbs(luma, alpha=light)  # type: ignore[assignment]
            chroma = cv2.convertScaleAbs(chroma, alpha=light, beta=_GREY * (1 - light))  # type: ignore[assignment]
        row, column = self._random.integers(0, _SPARE, 2)
        luma = cv2.GaussianBlur(luma, (3, 3), 0.6)  # type: ignore[assignment]
        noise = self._noise[row : row + HEIGHT, column : column + WIDTH]
        picture = np.empty((HEIGHT, WIDTH, 2), np.uint8)
        picture[..., 0] = cv2.add(luma, noise, dtype=cv2.CV_8U)
        picture[..., 1] = chroma.reshape(HEIGHT, WIDTH)
        return picture


def _ground(camera: Camera) -> tuple[Bytes, Bytes]:
    """Luma, and both chromas beside each other: (480, 320, 2)."""
    texture = field.texture()
    to_picture = camera.from_ground @ np.linalg.inv(texture.from_field)
    luma = cv2.warpPerspective(
        texture.luma, to_picture, (WIDTH, HEIGHT), flags=cv2.INTER_LINEAR, borderValue=field.FLOOR[0]
    )
    halved = np.diag([2.0, 2.0, 1.0])
    halved[:2, 2] = 0.5
    chroma = cv2.warpPerspective(
        texture.chroma,
        _CHROMA @ to_picture @ halved,
        (WIDTH // 2, HEIGHT),
        flags=cv2.INTER_NEAREST,
        borderValue=field.FLOOR[1:],
    )
    return luma, chroma  # type: ignore[return-value]


def _wall(luma: Bytes, chroma: Bytes, camera: Camera) -> None:
    """Paint a wall above the horizon, where the homography would show the scene behind the camera."""
    left, right = camera.horizon(0) + _WALL_ROWS, camera.horizon(WIDTH) + _WALL_ROWS
    if max(left, right) <= 0:
        return
    for plane, width, colour in ((luma, WIDTH, field.WALL[:1]), (chroma, WIDTH // 2, field.WALL[1:])):
        corners = np.array([(0, -1), (width, -1), (width, right), (0, left)])
        cv2.fillConvexPoly(plane, corners.round().astype(np.int32), colour)


def _distance(camera: Camera, place: tuple[float, float]) -> float:
    return math.hypot(place[0] - camera.pose.x, place[1] - camera.pose.y)


def _ball(luma: Bytes, chroma: Bytes, camera: Camera, place: tuple[float, float]) -> None:
    """Cast the rays of the pixels around a ball; its edge is smoothed over one pixel."""
    centre = camera.seen_from(np.array([*place, BALL_RADIUS_M]))
    reach = float(np.linalg.norm(centre))
    if centre[2] <= BALL_RADIUS_M:
        return
    middle = CENTRE[0] + FOCAL * centre[0] / centre[2], CENTRE[1] + FOCAL * centre[1] / centre[2]
    size = FOCAL * BALL_RADIUS_M / centre[2] * 1.25 + 2
    columns = _within(middle[0] - size, middle[0] + size, WIDTH, even=True)
    rows = _within(middle[1] - size, middle[1] + size, HEIGHT)
    if not columns or not rows:
        return
    rays = np.empty((len(rows), len(columns), 3), np.float32)
    rays[..., 0] = (np.array(columns) - CENTRE[0]) / FOCAL
    rays[..., 1] = ((np.array(rows) - CENTRE[1]) / FOCAL)[:, None]
    rays[..., 2] = 1.0
    rays /= np.linalg.norm(rays, axis=2, keepdims=True)
    along = rays @ centre.astype(np.float32)
    beside = np.sqrt(np.maximum(reach * reach - along * along, 0.0))
    share = np.clip((BALL_RADIUS_M - beside) * (FOCAL / reach) + 0.5, 0.0, 1.0)
    depth = along - np.sqrt(np.maximum(BALL_RADIUS_M**2 - beside * beside, 0.0))
    normals = ((depth[..., None] * rays - centre.astype(np.float32)) / BALL_RADIUS_M) @ camera.turn.astype(np.float32)
    light = _AMBIENT + (1 - _AMBIENT) * np.clip(normals[..., 2], 0.0, 1.0)
    is_panel = (normals @ _rolled(place).T).max(axis=2) > _PANEL_COS
    shade = np.where(is_panel, _PANEL[0], field.WHITE[0]) * light
    window = np.s_[rows.start : rows.stop, columns.start : columns.stop]
    luma[window] = (share * shade + (1 - share) * luma[window]).astype(np.uint8)
    halved = np.s_[rows.start : rows.stop, columns.start // 2 : columns.stop // 2]
    pale = (0.5 * (share[:, 0::2] + share[:, 1::2]))[..., None]
    chroma[halved] = (pale * 128 + (1 - pale) * chroma[halved]).astype(np.uint8)


def _within(low: float, high: float, size: int, *, even: bool = False) -> range:
    start, stop = max(0, math.floor(low)), min(size, math.ceil(high) + 1)
    return range(start - start % 2, stop + stop % 2) if even and start < stop else range(start, stop)


def _rolled(place: Sequence[float]) -> _Floats:
    """The directions of the ball's panels once it has rolled to a place."""
    a, b = place[0] / BALL_RADIUS_M, -place[1] / BALL_RADIUS_M
    about_y = np.array([[math.cos(a), 0, math.sin(a)], [0, 1, 0], [-math.sin(a), 0, math.cos(a)]])
    about_x = np.array([[1, 0, 0], [0, math.cos(b), -math.sin(b)], [0, math.sin(b), math.cos(b)]])
    rolled: _Floats = (_PANELS @ (about_y @ about_x).T).astype(np.float32)
    return rolled


def _icosahedron() -> npt.NDArray[np.float64]:
    golden = (1 + math.sqrt(5)) / 2
    corners = [(0.0, s, t * golden) for s in (-1, 1) for t in (-1, 1)]
    every = [corner[turn:] + corner[:turn] for corner in corners for turn in range(3)]
    return np.array(every) / math.hypot(1, golden)


_PANELS = _icosahedron()
