"""Section V of the paper as a list of steps, each with its event and alternatives, and the robots' declarations."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import yaml
from cfgplan_runtime.lifecycle.changes import Declare, Individual

WORLD = Path(__file__).parents[1]
"""The folder of the environment files and of the unit code."""


@dataclass(frozen=True, slots=True)
class Begin:
    """The start: only the target is given."""


@dataclass(frozen=True, slots=True)
class Register:
    """A robot declares itself and its transformations."""

    robot: str


@dataclass(frozen=True, slots=True)
class Kill:
    """The process of a transformation's unit is killed, by signal 9."""

    transformation: str


@dataclass(frozen=True, slots=True)
class Offer:
    """Transformations of a stage's file become available under a name."""

    name: str
    stage: str


Act: TypeAlias = Begin | Register | Kill | Offer


@dataclass(frozen=True, slots=True)
class Step:
    """One step: its title, its place in the paper, its event, and alternative plans to compare with.

    `others` has a description of each alternative plan, and the transformation that it must use.
    """

    title: str
    section: str
    happens: str
    act: Act
    others: tuple[tuple[str, str], ...] = ()


_PUFFS_BALL = ("Puff's ball instead of Piff's", "ball_localization(puff)")
_FUSED = ("both, fused", "fuse_ball_pos")

SECTION_V = (
    Step("Only a target", "V-A", "Somebody wants the ball's position on topic /result. No robot is there.", Begin()),
    Step(
        "Piff registers",
        "V-A",
        "The robot Piff comes and offers what it can run: six transformations.",
        Register("piff"),
    ),
    Step(
        "The segmenter is killed",
        "V-B",
        "kill -9 ends the process that finds the field in Piff's images.",
        Kill("segmenter(piff)"),
    ),
    Step("Puff registers", "V-C", "A second robot comes and offers the same six.", Register("puff"), (_PUFFS_BALL,)),
    Step(
        "A fusion is offered",
        "V-C",
        "There is now a transformation that makes one ball position of two.",
        Offer("fusion", "4-fusion-available"),
        (_PUFFS_BALL, _FUSED),
    ),
    Step(
        "The fusion is required",
        "V-C",
        "The fusion is to be used wherever that is possible, whatever it costs.",
        Offer("fusion", "5-fusion-required"),
    ),
)


def declared_by(robot: str) -> Declare:
    """Return the declaration that a robot makes when it registers: itself, and the pipeline that it can run."""
    text = (WORLD / "pipeline.yaml").read_text(encoding="utf-8").replace("${NAO}", robot)
    return Declare(robot, _transformations(text), (Individual(robot, ("NAO",)),))


def offered(name: str, stage: str) -> Declare:
    """Return a declaration of the transformations in a stage's file; they belong to no robot."""
    return Declare(name, _transformations((WORLD / f"{stage}.yaml").read_text(encoding="utf-8")))


def _transformations(text: str) -> dict[str, object]:
    return {"transformations": yaml.safe_load(text)["transformations"]}
