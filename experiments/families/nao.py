"""The paper's case study (section V) with any number of robots, on tags whose matching is known.

Labor and upkeep are those of `models/nao/pipeline.yaml`, varied by a seeded few percent so that the robots differ.
"""

from __future__ import annotations

from dataclasses import replace
from random import Random

from cfgplan.domain import Environment, InputPort, OutputPort, Similarity, Target, Transformation
from cfgplan.errors import InvalidValueError
from cfgplan.planning import Problem
from experiments.families.configurations import MILLISECONDS, cheap_configuration, without

POSITION = "Position and hasSource some Ball"
FUSED = "FusedPosition and hasSource some Ball"

PIPELINE: tuple[tuple[str, int, int, tuple[str, ...], tuple[str, ...]], ...] = (
    ("bottom_cam", 400, 60, (), ("YUVImage",)),
    (
        "subsampler",
        250,
        80,
        ("YUVImage",),
        tuple(
            f"{channel}{size}Image" for channel in "YUV" for size in ("640X480", "320X240", "160X120", "80X60", "40X30")
        ),
    ),
    ("segmenter", 350, 50, ("Y80X60Image", "V80X60Image"), ("ConvHull",)),
    ("ball_detector", 450, 90, ("ConvHull", "Y640X480Image", "Y320X240Image"), ("PixelPos",)),
    ("self_localization", 300, 20, (), ("Pose",)),
    ("ball_localization", 200, 10, ("PixelPos", "Pose"), (POSITION,)),
)
"""Label, labor and upkeep in milliseconds, what each input needs and each output gives (Table I)."""


def nao(
    seed: int,
    *,
    robots: int = 2,
    event: str = "registered",
    fusion: int = 0,
    sharing: int = 1,
    cameras: int = 1,
    horizon_s: int = 60,
) -> Problem:
    """Return a problem with one target, the ball's position, and `robots` NAOs that can all provide it.

    `event` is `registered` (nothing runs yet), `lost` (the first robot's pipeline has lost its segmenter) or
    `left` (the first robot's transformations but its camera have left the library while its pipeline
    runs). With `fusion` the target wants a position fused from that many different robots. Each group of
    `sharing` robots has a camera in common. A robot may use `cameras` of them, also those of neighbouring groups.
    """
    if robots < 1 or fusion > robots or fusion == 1:
        raise InvalidValueError("the case needs a robot, and at least two of them for a fusion")
    random = Random(seed)
    library = [t for robot in range(1, robots + 1) for t in _pipeline(random, f"nao{robot:02}")]
    if sharing > 1 or cameras > 1:
        library = _with_shared_cameras(library, robots, sharing, cameras)
    targets = (Target("ball", POSITION, "/result"),)
    running = Environment((), tuple(t for t in library if t.label.endswith("(nao01)")), targets)
    similarity = Similarity({tag: frozenset({tag}) for t in library for port in t.outputs for tag in (port.tag,)})
    if event != "registered":
        running = cheap_configuration(running, similarity, horizon_s)
    units = running.units
    if event == "lost":
        units = without(units, {"segmenter(nao01).1"})
    elif event == "left":
        library = [t for t in library if not t.label.endswith("(nao01)") or t.label == "bottom_cam(nao01)"]
    elif event != "registered":
        raise InvalidValueError(f"{event!r} is no event of the case: registered, lost or left")
    if fusion:
        ports = tuple(InputPort(f"position{i}", POSITION, distinct="sources") for i in range(1, fusion + 1))
        fuse = Transformation(
            "fuse_ball_pos",
            ports,
            (OutputPort("fused", FUSED),),
            labor_us=150 * MILLISECONDS,
            upkeep_us=10 * MILLISECONDS,
        )
        library.append(fuse)
        targets = (Target("ball", FUSED, "/result"),)
        similarity = Similarity({**similarity.offers, FUSED: frozenset({FUSED})})
    return Problem(Environment(units, tuple(library), targets), similarity, horizon_s)


def _with_shared_cameras(
    library: list[Transformation], robots: int, sharing: int, cameras: int
) -> list[Transformation]:
    """Keep one camera for each group of `sharing` robots. It films for `cameras` groups; the first follows the last."""
    groups = [range(first, min(first + sharing, robots + 1)) for first in range(1, robots + 1, sharing)]
    films: dict[str, list[str]] = {}
    for number, group in enumerate(groups):
        served = sorted({robot for step in range(cameras) for robot in groups[(number + step) % len(groups)]})
        films[f"bottom_cam(nao{group[0]:02})"] = [f"YUVImage and hasSource some {{nao{robot:02}}}" for robot in served]
    return [
        replace(t, outputs=tuple(OutputPort(f"out{i}", tag) for i, tag in enumerate(films[t.label])))
        if t.label in films
        else t
        for t in library
        if t.label in films or not t.label.startswith("bottom_cam")
    ]


def _pipeline(random: Random, robot: str) -> list[Transformation]:
    def tag(concept: str) -> str:
        return concept if concept == POSITION else f"{concept} and hasSource some {{{robot}}}"

    return [
        Transformation(
            f"{name}({robot})",
            tuple(InputPort(f"in{i}", tag(concept)) for i, concept in enumerate(needs)),
            tuple(OutputPort(f"out{i}", tag(concept)) for i, concept in enumerate(gives)),
            labor_us=round(labor * random.uniform(0.9, 1.1)) * MILLISECONDS,
            upkeep_us=round(upkeep * random.uniform(0.9, 1.1)) * MILLISECONDS,
            host=robot,
        )
        for name, labor, upkeep, needs, gives in PIPELINE
    ]
