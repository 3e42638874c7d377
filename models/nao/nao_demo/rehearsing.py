"""Calls the world's units one after the other without processes, for pictures and for comparisons on equal moments."""

from __future__ import annotations

import base64
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from football import scenario
from units import BallDetector, BallLocalization, BottomCam, FuseBallPos, Segmenter, SelfLocalization, Subsampler

_HULL, _BALL = (90, 220, 255), (60, 90, 255)
_QUALITY = 82


@dataclass(frozen=True, slots=True)
class Seen:
    """The outputs of a robot's units for one moment; None if they find nothing. `sizes` are the subsampled channels."""

    sizes: Mapping[str, Any]
    hull: Any
    ball: Mapping[str, float] | None
    position: Any


Call = Callable[..., Any]
"""Calls the code of a unit, given the unit's name, its code, and its values by input port."""


def _plainly(_unit: str, code: Callable[..., Any], **values: object) -> Any:
    return code(**values)


class Robot:
    """The units of one robot. Each is called through `call`, which may measure it."""

    def __init__(self, name: str, call: Call = _plainly) -> None:
        self.name = name
        self._call = call
        self._camera: Any = BottomCam(name)
        self._self_localization: Any = SelfLocalization(name)
        self._subsampler = Subsampler()
        self._segmenter = Segmenter()
        self._detector = BallDetector()
        self._localization = BallLocalization()

    def see(self, time_ns: int) -> Seen:
        """Take the picture at a time, in nanoseconds since the epoch, and search the ball in it."""
        call, ball, position = self._call, None, None
        image = call("bottom_cam", self._camera.picture, time_ns=time_ns)
        sizes = call("subsampler", self._subsampler, image=image)
        hull = call("segmenter", self._segmenter, y=sizes["y80"], v=sizes["v80"])
        pose = call("self_localization", self._self_localization.pose, time_ns=time_ns)
        if hull is not None:
            ball = call("ball_detector", self._detector, hull=hull, fine=sizes["y640"], coarse=sizes["y320"])
        if ball is not None:
            position = call("ball_localization", self._localization, pixel=ball, pose=pose)
        return Seen(sizes, hull, ball, position)


@dataclass(frozen=True, slots=True)
class View:
    """A picture as a data URI, and whether the ball was found in it."""

    robot: str
    uri: str
    has_ball: bool


def view(robot: Robot, time_ns: int) -> View:
    """Return the picture at a time, with the field's hull and the ball marked."""
    seen = robot.see(time_ns)
    channels = np.dstack([seen.sizes[name] for name in ("y640", "v640", "u640")])
    shown = cv2.cvtColor(channels, cv2.COLOR_YCrCb2BGR)
    if seen.hull is not None:
        cv2.polylines(shown, [seen.hull.round().astype(np.int32)], True, _HULL, 2, cv2.LINE_AA)
    if seen.ball is not None:
        centre = round(seen.ball["u"] * 16), round(seen.ball["v"] * 16)
        cv2.circle(shown, centre, round((seen.ball["radius"] + 4) * 16), _BALL, 2, cv2.LINE_AA, 4)
    _, data = cv2.imencode(".jpg", shown, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    uri = f"data:image/jpeg;base64,{base64.b64encode(data.tobytes()).decode()}"
    return View(robot.name, uri, seen.ball is not None)


@dataclass(frozen=True, slots=True)
class Comparison:
    """Root mean square errors in metres, of each robot alone and of both fused, over the same `moments`."""

    moments: int
    alone_m: Mapping[str, float]
    fused_m: float


def compare(robots: Sequence[Robot], times_ns: Iterable[int]) -> Comparison | None:
    """Compare two robots and their fusion with the true positions, at the times when both see the ball.

    None if both never see it at the same time.
    """
    fuse = FuseBallPos()
    first, second = robots
    errors: list[tuple[float, float, float]] = []
    for time_ns in times_ns:
        one, other = first.see(time_ns).position, second.see(time_ns).position
        if one is not None and other is not None:
            found = (one, other, fuse(first=one, second=other))
            here = scenario.ball(time_ns)
            errors.append(tuple(math.dist((p["x"], p["y"]), here) for p in found))  # type: ignore[arg-type]
    if not errors:
        return None
    rms = [math.sqrt(sum(error * error for error in column) / len(errors)) for column in zip(*errors, strict=True)]
    return Comparison(len(errors), {first.name: rms[0], second.name: rms[1]}, rms[2])
