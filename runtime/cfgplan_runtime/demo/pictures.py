"""What a robot's camera sees at a moment, with what its units find in it, as a picture for the page."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from typing import Any

from cfgplan_runtime.demo.stage import Stage

_HULL = (90, 220, 255)
_BALL = (60, 90, 255)


@dataclass(frozen=True, slots=True)
class View:
    """A picture as a data URI, and whether the ball was found in it."""

    robot: str
    uri: str
    has_ball: bool


def view(stage: Stage, robot: str, time_ns: int) -> View:
    """Take the picture of a moment again and run the robot's units on it."""
    import cv2
    import numpy as np

    camera: Any = stage.code("units.py:BottomCam")(robot)
    image = camera.picture(time_ns)
    sizes = stage.code("units.py:Subsampler")()(image=image)
    shown = cv2.cvtColor(np.dstack([sizes["y640"], sizes["v640"], sizes["u640"]]), cv2.COLOR_YCrCb2BGR)
    hull = stage.code("units.py:Segmenter")()(y=sizes["y80"], v=sizes["v80"])
    ball = None
    if hull is not None:
        cv2.polylines(
            shown, [hull.round().astype(np.int32)], isClosed=True, color=_HULL, thickness=2, lineType=cv2.LINE_AA
        )
        ball = stage.code("units.py:BallDetector")()(hull=hull, fine=sizes["y640"], coarse=sizes["y320"])
    if ball is not None:
        centre = round(ball["u"] * 16), round(ball["v"] * 16)
        cv2.circle(shown, centre, round((ball["radius"] + 4) * 16), _BALL, 2, cv2.LINE_AA, 4)
    _, data = cv2.imencode(".jpg", shown, [cv2.IMWRITE_JPEG_QUALITY, 82])
    return View(robot, f"data:image/jpeg;base64,{base64.b64encode(data.tobytes()).decode()}", ball is not None)
