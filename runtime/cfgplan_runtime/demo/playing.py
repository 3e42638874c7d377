"""Plays the story on running processes, by a manager that is told nothing but what happens."""

from __future__ import annotations

import math
import os
import queue
import signal
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

from cfgplan import api
from cfgplan.domain import ChangeSet, ComputationUnit, Environment, Subscription
from cfgplan.explaining.why_not import requiring
from cfgplan.planning import Problem, Status
from cfgplan_runtime.demo.listening import Listener, Sample
from cfgplan_runtime.demo.stage import Stage
from cfgplan_runtime.demo.story import Begin, Kill, Offer, Register, Step
from cfgplan_runtime.errors import RuntimeFaultError
from cfgplan_runtime.lifecycle.manager import Manager
from cfgplan_runtime.lifecycle.perturbations import UnitGone
from cfgplan_runtime.lifecycle.reports import Decision, Report, Review, Reviewed
from cfgplan_runtime.lifecycle.seams import DeclaredCosts
from cfgplan_runtime.runtime import Runtime
from cfgplan_runtime.supervision.observation import Observation

TOPIC = "/result"
PRELOADED = ("numpy", "cv2")
"""What all units import: the nursery imports it once, so that a unit is there in milliseconds."""
_NOTHING_S = 1.5
"""How long to watch that nothing comes."""
LONGEST_S = 120.0
"""How long anything may take before the play is given up."""


@dataclass(frozen=True, slots=True)
class Alternative:
    """A plan that was not chosen, and what it would cost, in microseconds of CPU time over the horizon."""

    what: str
    cost_us: int


@dataclass(frozen=True, slots=True)
class Silence:
    """The longest time without a position around an event: the last before, the first after, frames without one."""

    last: Sample
    first: Sample
    lost_frames: int


@dataclass(frozen=True)
class Played:
    """What came of a step. Times in nanoseconds since the epoch; `first` is the first position of a moment after it."""

    step: Step
    began_ns: int
    ended_ns: int
    before: Environment
    after: Environment
    review: Review
    samples: tuple[Sample, ...]
    others: tuple[Alternative, ...]
    observed: tuple[Observation, ...]
    first: Sample | None = None
    silence: Silence | None = None

    @property
    def gone(self) -> tuple[str, ...]:
        """The units that have died."""
        return tuple(one.unit for one in self.review.perturbations if isinstance(one, UnitGone))

    @property
    def left(self) -> Environment:
        """What was left of what ran before when those had died, with the targets of afterwards."""
        units = (replace(u, subscriptions=_living(u, self.gone)) for u in self.before.units if u.id not in self.gone)
        return replace(self.before, units=tuple(units), targets=self.after.targets)

    @property
    def changes(self) -> ChangeSet:
        """What the update has changed in what was left."""
        return self.left.change_to(self.after.units)

    @property
    def source(self) -> str | None:
        """The transformation whose positions are on the topic after the step."""
        publishing = (u for u in self.after.units if any(p.topic == TOPIC for p in u.publications))
        return next((unit.transformation for unit in publishing), None)

    @property
    def updated_ns(self) -> int:
        """When the update had been carried out."""
        return _updated_ns(self.review)

    @property
    def settled(self) -> tuple[Sample, ...]:
        """The positions of moments after the update."""
        return tuple(sample for sample in self.samples if sample.time_ns >= self.updated_ns)

    @property
    def rms_error_m(self) -> float | None:
        """The root mean square of the errors of the positions after the update."""
        squares = [sample.error_m**2 for sample in self.settled]
        return math.sqrt(sum(squares) / len(squares)) if squares else None


def _updated_ns(review: Review) -> int:
    seconds = sum(took for phase, took in review.seconds.items() if phase != "detect")
    return round((review.time_s + seconds) * 1e9)


def _living(unit: ComputationUnit, gone: Sequence[str]) -> tuple[Subscription, ...]:
    return tuple(subscription for subscription in unit.subscriptions if subscription.stream.unit not in gone)


def play(
    stage: Stage,
    story: Sequence[Step],
    step_s: float,
    begins: Callable[[Step], None],
    ends: Callable[[Played], None],
) -> tuple[Played, ...]:
    """Play the story; each step is watched for `step_s` seconds. `begins` and `ends` are told as it goes on.

    Raises RuntimeFaultError if a step does not come to its end.
    """
    played: list[Played] = []
    world = api.load(stage.environment_file)
    with Runtime(folder=stage.folder, preload=PRELOADED) as runtime:
        listener = Listener(TOPIC, runtime.id, stage.code("football.scenario:ball"))
        try:
            player = _Player(stage, runtime, listener, step_s)
            begins(story[0])
            with Manager(world, runtime, estimator=DeclaredCosts(failure_us=0), report=player.hear) as manager:
                for step in story:
                    if step is not story[0]:
                        begins(step)
                    played.append(player.play(step, manager))
                    ends(played[-1])
        finally:
            runtime.close()
            listener.close()
    return tuple(played)


class _Player:
    def __init__(self, stage: Stage, runtime: Runtime, listener: Listener, step_s: float) -> None:
        self._stage, self._runtime, self._listener = stage, runtime, listener
        self._step_s = step_s
        self._reviews: queue.SimpleQueue[Review] = queue.SimpleQueue()

    def hear(self, report: Report) -> None:
        if isinstance(report, Reviewed):
            self._reviews.put(report.review)

    def play(self, step: Step, manager: Manager) -> Played:
        before = self._runtime.environment
        began_ns = time.time_ns()
        review = self._act(step, manager)
        first = None
        if review.met:
            first = self._listener.wait_for(began_ns, LONGEST_S)
            if first is None or self._listener.wait_for(_updated_ns(review), LONGEST_S) is None:
                raise RuntimeFaultError(f"no position came on {TOPIC} for {LONGEST_S:.0f} s after: {step.title}")
        time.sleep(self._step_s if review.met else min(self._step_s, _NOTHING_S))
        snapshot = manager.snapshot()
        samples = self._listener.samples(began_ns)
        return Played(
            step,
            began_ns,
            time.time_ns(),
            before,
            snapshot.environment,
            review,
            samples,
            self._others(step, manager),
            tuple(view.observation for view in snapshot.units if view.observation is not None),
            first,
            _silence(self._listener.samples(began_ns - _AROUND_NS, began_ns + _AROUND_NS)),
        )

    def _act(self, step: Step, manager: Manager) -> Review:
        match step.act:
            case Begin():
                return self._review()
            case Register(robot):
                review = manager.request(self._stage.robot(robot)).result(LONGEST_S)
            case Offer(name, stage):
                review = manager.request(self._stage.offer(name, stage)).result(LONGEST_S)
            case Kill(transformation):
                return self._kill(transformation, manager)
        if review is None:
            raise RuntimeFaultError(f"nothing came of this step: {step.title}")
        return review

    def _kill(self, transformation: str, manager: Manager) -> Review:
        unit = next(u.id for u in self._runtime.environment.units if u.transformation == transformation)
        pid = self._runtime.pid(unit)
        if pid is None:
            raise RuntimeFaultError(f"{unit} has no process")
        os.kill(pid, signal.SIGKILL)
        while True:
            review = self._review()
            if any(isinstance(one, UnitGone) and one.unit == unit for one in review.perturbations):
                return self._last_applied(review, manager)

    def _last_applied(self, review: Review, manager: Manager) -> Review:
        """The review that has mended it: on a busy computer it may take more than one."""
        manager.settle(LONGEST_S)
        while not self._reviews.empty():
            later = self._reviews.get()
            review = later if later.decision is Decision.APPLIED else review
        return review

    def _review(self) -> Review:
        try:
            return self._reviews.get(timeout=LONGEST_S)
        except queue.Empty:
            raise RuntimeFaultError(f"no review for {LONGEST_S:.0f} s") from None

    def _others(self, step: Step, manager: Manager) -> tuple[Alternative, ...]:
        """What plans would cost now that must use a certain transformation."""
        if not step.others:
            return ()
        world = manager.world
        similarity = api.match_ports(world).similarity
        problem = Problem(
            replace(world.environment, units=self._runtime.environment.units), similarity, world.horizon_s
        )
        found = []
        for what, label in step.others:
            plan = api.plan(requiring(problem, [label]))
            if plan.status is Status.OPTIMAL and plan.cost_us is not None:
                found.append(Alternative(what, plan.cost_us))
        return tuple(found)


_AROUND_NS = 1_500_000_000
_FRAME_NS = 1_000_000_000 / 15


def _silence(samples: Sequence[Sample]) -> Silence | None:
    """The longest pause between positions of following moments."""
    pairs = list(pairwise(samples))
    if not pairs:
        return None
    last, first = max(pairs, key=lambda pair: pair[1].time_ns - pair[0].time_ns)
    return Silence(last, first, max(0, round((first.time_ns - last.time_ns) / _FRAME_NS) - 1))
