"""The world's units called one after the other, without any process: for pictures, and for fair comparisons."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from cfgplan_runtime.demo.stage import Stage


@dataclass(frozen=True, slots=True)
class Seen:
    """What a robot's units make of one moment; None where they find nothing. `sizes` are the subsampled channels."""

    sizes: Mapping[str, Any]
    hull: Any
    ball: Mapping[str, float] | None
    position: Mapping[str, Any] | None


Call = Callable[..., Any]
"""Calls a unit's code: the unit's name, its code, its values by input port."""


def _plainly(_unit: str, code: Callable[..., Any], **values: object) -> Any:
    return code(**values)


class Robot:
    """The units of one robot, called by `call`."""

    def __init__(self, stage: Stage, name: str, call: Call = _plainly) -> None:
        self.name = name
        self._call = call
        self._camera: Any = stage.code("units.py:BottomCam")(name)
        self._self_localization: Any = stage.code("units.py:SelfLocalization")(name)
        self._subsampler = stage.code("units.py:Subsampler")()
        self._segmenter = stage.code("units.py:Segmenter")()
        self._detector = stage.code("units.py:BallDetector")()
        self._localization = stage.code("units.py:BallLocalization")()

    def see(self, time_ns: int) -> Seen:
        """Take the picture of a moment and look for the ball in it."""
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
class Comparison:
    """Root mean squares of the errors at the same moments, in metres: of each robot alone, and of both fused."""

    moments: int
    alone_m: Mapping[str, float]
    fused_m: float


def compare(stage: Stage, robots: Sequence[Robot], times_ns: Iterable[int]) -> Comparison | None:
    """Hold two robots and their fusion against the truth, where both see the ball; None if that is nowhere."""
    truth, fuse = stage.code("football.scenario:ball"), stage.code("units.py:FuseBallPos")()
    first, second = robots
    errors: list[tuple[float, float, float]] = []
    for time_ns in times_ns:
        one, other = first.see(time_ns).position, second.see(time_ns).position
        if one is not None and other is not None:
            found = (one, other, fuse(first=one, second=other))
            here = truth(time_ns)
            errors.append(tuple(math.dist((p["x"], p["y"]), here) for p in found))  # type: ignore[arg-type]
    if not errors:
        return None
    rms = [math.sqrt(sum(error * error for error in column) / len(errors)) for column in zip(*errors, strict=True)]
    return Comparison(len(errors), {first.name: rms[0], second.name: rms[1]}, rms[2])
