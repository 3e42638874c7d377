"""A manager that does nothing but remember what it was asked, and says what it is told to say."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future

from cfgplan_runtime.lifecycle.basis import Preview
from cfgplan_runtime.lifecycle.changes import Change, Declare
from cfgplan_runtime.lifecycle.deliberation import Findings
from cfgplan_runtime.lifecycle.perturbations import ReviewRequested, UnitGone
from cfgplan_runtime.lifecycle.reports import (
    BackingOff,
    Decision,
    Phase,
    Report,
    Review,
    Snapshot,
    TargetView,
    UnitView,
)
from cfgplan_runtime.supervision.observation import Observation

from cfgplan.domain import (
    ChangeSet,
    ComputationUnit,
    Environment,
    InputPort,
    OutputPort,
    Publication,
    Stream,
    Subscription,
    Target,
    Transformation,
)
from cfgplan.planning import Problem, Similarity

CAMERA = ComputationUnit("camera.1", "camera")
DETECTOR = ComputationUnit(
    "detector.1", "detector", (Subscription("image", Stream("camera.1", "image")),), (Publication("ball", "/result"),)
)
REVIEW = Review(
    number=1,
    at_s=10.0,
    time_s=1_700_000_000.5,
    perturbations=(UnitGone("detector.1", "detector", "died", "exited with 3"), ReviewRequested()),
    decision=Decision.APPLIED,
    horizon_s=60,
    cost_before_us=1_000_000,
    cost_us=2_000_000,
    bound_us=2_000_000,
    is_proven=True,
    change_set=ChangeSet(started=(DETECTOR,)),
    met=("ball",),
    unmet={"goal": "nothing gives Goal"},
    seconds={"detect": 0.001, "plan": 0.002, "apply": 0.01},
)


def observation(unit: str, steps: int = 100) -> Observation:
    return Observation(unit, unit.split(".")[0], 300_000, 20_000, 900_000, 25 << 20, steps, 30.0, 0, None, {}, {})


SNAPSHOT = Snapshot(
    at_s=12.0,
    phase=Phase.STABLE,
    environment=Environment((CAMERA, DETECTOR), (), (Target("ball", "Ball", "/result"),)),
    targets=(
        TargetView("ball", "Ball", "/result", 1, Stream("detector.1", "ball"), unit="detector.1"),
        TargetView("goal", "Goal", "/goal", 0, None, "nothing gives Goal"),
    ),
    units=(UnitView(CAMERA, None, observation("camera.1")), UnitView(DETECTOR, "nao1", observation("detector.1"))),
    pending=(),
    reviews=(REVIEW,),
    backing_off=(BackingOff("segmenter", 3, 4.0, "exited with 3"),),
    lost_hosts=(),
    declared=("robot2",),
    horizon_s=60,
    horizon_left_s=float("inf"),
    cost_us=2_000_000,
)

FORESEEN_IN = Environment(
    (CAMERA, DETECTOR),
    (
        Transformation("camera", outputs=(OutputPort("image", "Image"),)),
        Transformation("detector", (InputPort("image", "Image"),), (OutputPort("ball", "Ball"),)),
    ),
    (Target("ball", "Ball", "/result"),),
)


class FakeManager:
    def __init__(self, snapshot: Snapshot = SNAPSHOT) -> None:
        self.requested: list[Change] = []
        self.supposed: list[Change] = []
        self.listeners: list[Callable[[Report], None]] = []
        self.refuse: Exception | None = None
        self.is_slow = False
        self.foreseen: Findings | None = None
        self._snapshot = snapshot

    def request(self, change: Change) -> Future[Review | None]:
        self.requested.append(change)
        future: Future[Review | None] = Future()
        if self.refuse is not None:
            future.set_exception(self.refuse)
        elif not self.is_slow:
            future.set_result(REVIEW)
        return future

    def preview(self) -> Future[Preview]:
        future: Future[Preview] = Future()
        if not self.is_slow:
            findings = self.foreseen or Findings(
                Environment((CAMERA,)), Environment(), unmet={"goal": "nothing gives Goal"}, cause="no time"
            )
            problem = Problem(FORESEEN_IN, Similarity({tag: frozenset({tag}) for tag in ("Image", "Ball")}), 60)
            future.set_result(Preview(findings, problem, {"unit": {"camera.1": "1234"}}))
        return future

    def suppose(self, change: Change) -> Findings:
        self.supposed.append(change)
        return self.foreseen or Findings(Environment((CAMERA,)), Environment(), cause="no time")

    def snapshot(self) -> Snapshot:
        return self._snapshot

    def shows(self, snapshot: Snapshot) -> None:
        """From now on there is this."""
        self._snapshot = snapshot

    @property
    def declared(self) -> Declare:
        change = self.requested[-1]
        assert isinstance(change, Declare)
        return change
