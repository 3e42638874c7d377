"""What a robot's camera sees at a moment, with what its units find in it, as a picture for the page."""

from __future__ import annotations

import base64
from dataclasses import dataclass

from cfgplan_runtime.demo.rehearsing import Robot

_HULL = (90, 220, 255)
_BALL = (60, 90, 255)
_QUALITY = 82


@dataclass(frozen=True, slots=True)
class View:
    """A picture as a data URI, and whether the ball was found in it."""

    robot: str
    uri: str
    has_ball: bool


def view(robot: Robot, time_ns: int) -> View:
    """Take the picture of a moment again and mark the field's hull and the ball."""
    import cv2
    import numpy as np

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
