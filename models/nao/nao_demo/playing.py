"""Plays the story on running processes. The manager gets only the events of the story, no instructions."""

from __future__ import annotations

import os
import queue
import signal
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from typing import Protocol

from cfgplan_runtime.errors import RuntimeFaultError
from cfgplan_runtime.lifecycle.changes import Declare
from cfgplan_runtime.lifecycle.kinds import sentence
from cfgplan_runtime.lifecycle.manager import Manager
from cfgplan_runtime.lifecycle.perturbations import UnitGone
from cfgplan_runtime.lifecycle.reports import Decision, Report, Review, Reviewed
from cfgplan_runtime.lifecycle.seams import DeclaredCosts
from cfgplan_runtime.operating.control_client import connect
from cfgplan_runtime.operating.control_server import ControlServer
from cfgplan_runtime.operating.flows import Flows
from cfgplan_runtime.operating.methods import Methods
from cfgplan_runtime.operating.records import report_record
from cfgplan_runtime.operating.stream_rates import StreamRates
from cfgplan_runtime.operating.taps import LeasedTaps
from cfgplan_runtime.runtime import Runtime
from cfgplan_runtime.streams.run_folder import base_folder

from cfgplan import api
from cfgplan.explaining.what_if import requiring
from cfgplan.planning import Problem, Status
from nao_demo.listening import Listener, Sample
from nao_demo.played import TOPIC, Alternative, Played, silence
from nao_demo.story import WORLD, Begin, Kill, Offer, Register, Step, declared_by, offered

PRELOADED = ("numpy", "cv2")
"""Packages that all units import. The nursery imports them once, so that a unit starts within milliseconds."""
_BEFORE_NS = 1_000_000_000
"""The last position before a step is searched this far back."""
_NOTHING_S = 1.5
"""If no target can be met, the topic is watched for this long."""
_LOOK_S = 0.2
LONGEST_S = 120.0
"""The longest time that one action may take before the play is aborted."""


class Audience(Protocol):
    """Receives the events of a play."""

    def is_served(self, url: str) -> None:
        """Take the address at which the page of the run is served."""

    def begins(self, step: Step) -> None:
        """Take a step that begins."""

    def answers(self, answered: Played) -> None:
        """Take the manager's answer to the step; it has no positions yet."""

    def watches(self, sample: Sample | None) -> None:
        """Take the newest position, or None before the first; called a few times a second while a step is watched."""

    def ends(self, played: Played) -> None:
        """Take the result of a step that has ended, with its positions."""


def play(story: Sequence[Step], step_s: float, audience: Audience, port: int | None = None) -> tuple[Played, ...]:
    """Play the story, and watch each step for `step_s` seconds. With a `port` (0: any), the run's page is served there.

    Returns the results of the steps. Raises RuntimeFaultError if a step does not finish within `LONGEST_S`.
    """
    played: list[Played] = []
    world = api.load(WORLD / "0-target-only.yaml")
    with Runtime(folder=WORLD, preload=PRELOADED) as runtime:
        listener = Listener(TOPIC, runtime.id)
        try:
            player = _Player(runtime, listener, step_s)
            manager = Manager(world, runtime, estimator=DeclaredCosts(failure_us=0), report=player.hear)
            with _served(manager, runtime, port, audience):
                audience.begins(story[0])
                for step in story:
                    if step is not story[0]:
                        audience.begins(step)
                    answered = player.answered(step, manager)
                    audience.answers(answered)
                    played.append(player.watched(answered, manager, audience))
                    audience.ends(played[-1])
        finally:
            runtime.close()
            listener.close()
    return _without_gaps(played, listener)


@contextmanager
def _served(manager: Manager, runtime: Runtime, port: int | None, audience: Audience) -> Iterator[None]:
    """The manager at work; `cfgplan ctl` reaches it, and a page shows it where a port is named."""
    flows, rates, world = Flows(), StreamRates(), str(WORLD / "0-target-only.yaml")
    taps = LeasedTaps(runtime, base_folder() / runtime.id)
    runtime.listen(flows.hear)
    manager.listen(rates.hear)
    manager.listen(taps.hear)
    with (
        ControlServer(
            base_folder() / runtime.id, Methods(manager, flows, rates=rates, taps=taps).by_name(), world
        ) as server,
        ExitStack() as more,
    ):
        manager.listen(lambda report: server.publish({**report_record(report), "says": sentence(report)}))
        if port is not None:
            from cfgplan_runtime.page.server import PageServer

            page = more.enter_context(PageServer(lambda: connect(runtime.id), port=port))
            audience.is_served(page.url)
        with manager:
            yield


def _without_gaps(played: Sequence[Played], listener: Listener) -> tuple[Played, ...]:
    """Each step with the positions that came until the next one began, also those after it was told."""
    ends_ns = [*(step.began_ns for step in played[1:]), played[-1].ended_ns]
    return tuple(
        replace(step, ended_ns=end_ns, samples=listener.samples(step.began_ns, end_ns))
        for step, end_ns in zip(played, ends_ns, strict=True)
    )


class _Player:
    def __init__(self, runtime: Runtime, listener: Listener, step_s: float) -> None:
        self._runtime, self._listener = runtime, listener
        self._step_s = step_s
        self._reviews: queue.SimpleQueue[Review] = queue.SimpleQueue()

    def hear(self, report: Report) -> None:
        if isinstance(report, Reviewed):
            self._reviews.put(report.review)

    def answered(self, step: Step, manager: Manager) -> Played:
        """A step with what the manager has made of it up to now."""
        before, began_ns = self._runtime.environment, time.time_ns()
        review = self._act(step, manager)
        after = manager.snapshot().environment
        return Played(step, began_ns, time.time_ns(), before, after, review, self._others(step, manager))

    def watched(self, answered: Played, manager: Manager, audience: Audience) -> Played:
        """Return a step with the positions that came while it was watched.

        Raises RuntimeFaultError if no position came for `LONGEST_S` seconds although the targets are met.
        """
        began_ns, review, first = answered.began_ns, answered.review, None
        if review.met:
            first = self._listener.wait_for(began_ns, LONGEST_S)
            if first is None or self._listener.wait_for(answered.updated_ns, LONGEST_S) is None:
                raise RuntimeFaultError(f"no position came on {TOPIC} for {LONGEST_S:.0f} s")
        self._watch(self._step_s if review.met else min(self._step_s, _NOTHING_S), began_ns, audience)
        observed = (view.observation for view in manager.snapshot().units)
        return replace(
            answered,
            ended_ns=time.time_ns(),
            samples=self._listener.samples(began_ns),
            observed=tuple(one for one in observed if one is not None),
            first=first,
            silence=silence(self._listener.samples(began_ns - _BEFORE_NS), began_ns, answered.updated_ns),
        )

    def _watch(self, span_s: float, began_ns: int, audience: Audience) -> None:
        end = time.monotonic() + span_s
        while (left_s := end - time.monotonic()) > 0:
            samples = self._listener.samples(began_ns)
            audience.watches(samples[-1] if samples else None)
            time.sleep(min(_LOOK_S, left_s))

    def _act(self, step: Step, manager: Manager) -> Review:
        match step.act:
            case Begin():
                return self._review()
            case Register(robot):
                return _declared(declared_by(robot), manager)
            case Offer(name, stage):
                return _declared(offered(name, stage), manager)
            case Kill(transformation):
                return self._kill(transformation, manager)

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
        """The costs of plans that must use a certain transformation."""
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


def _declared(change: Declare, manager: Manager) -> Review:
    try:
        review = manager.request(change).result(LONGEST_S)
    except TimeoutError:
        review = None
    if review is None:
        raise RuntimeFaultError(f"nothing came of what {change.name} declared")
    return review
