"""From what has come in to perturbations: events of units and requests, in the order in which they came."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Future

from cfgplan.api import World
from cfgplan.domain import ComputationUnit
from cfgplan.errors import Fault, InputError
from cfgplan_runtime.children.messages import Flow
from cfgplan_runtime.lifecycle.back_off import BackOffs
from cfgplan_runtime.lifecycle.changes import (
    Change,
    KillUnit,
    LoseHost,
    RegainHost,
    ReplaceWorld,
    ReviewNow,
    Stop,
    WorldChange,
)
from cfgplan_runtime.lifecycle.configuration import Situation
from cfgplan_runtime.lifecycle.differing import difference
from cfgplan_runtime.lifecycle.inbox import Inbox, Outcome, Request
from cfgplan_runtime.lifecycle.noticing import Noticing
from cfgplan_runtime.lifecycle.pending import Pending
from cfgplan_runtime.lifecycle.perturbations import (
    HostBack,
    HostGone,
    MayStartAgain,
    Perturbation,
    ReviewRequested,
    TargetSilent,
    UnitGone,
    UnitKeepsFailing,
    WorldChanged,
)
from cfgplan_runtime.lifecycle.policy import Policy
from cfgplan_runtime.lifecycle.reports import BackedOff, Perturbed, Report, UnitEvent, WorldRefused
from cfgplan_runtime.lifecycle.seams import Clock, Estimator, Middleware
from cfgplan_runtime.lifecycle.silence import Giving
from cfgplan_runtime.lifecycle.warm_matching import WarmMatching
from cfgplan_runtime.lifecycle.worlds import LivingWorld
from cfgplan_runtime.supervision.events import (
    SIGNS,
    Event,
    InputLost,
    TopicsStatus,
    UnitDied,
    UnitStatus,
    UnitStopped,
)


class Intake:
    """Knows the world that holds now, and what has happened that no review has answered yet.

    `hear` and `request` are for any thread; the rest is the manager's thread's.
    """

    def __init__(
        self,
        world: World,
        middleware: Middleware,
        estimator: Estimator,
        clock: Clock,
        policy: Policy,
        tell: Callable[[Report], None],
    ) -> None:
        self._middleware = middleware
        self._estimator = estimator
        self._clock = clock
        self._policy = policy
        self._tell = tell
        self.living = LivingWorld(world)
        self.matching = WarmMatching(policy.reasoner, policy.match_limit_s)
        self.matching.take(self.living.world)
        self.situation = Situation(BackOffs(policy.back_off))
        self.inbox = Inbox()
        self.pending = Pending()
        self.faults: tuple[Fault, ...] = ()
        self.interrupt = threading.Event()
        """Set when something comes that a plan in the making can't know."""
        self.ending = threading.Event()
        """Set when the end is asked for."""
        self.stops: list[Outcome] = []
        """Who has asked for the end."""
        self.starting: frozenset[str] = frozenset()
        """New units of the update under way. That they die is a part of its failure; what else dies can't wait."""
        self.match_s = 0.0
        """Wall time that matching has taken since this was last set to 0."""
        self.not_started: list[str] = []
        """The transformations of those that died."""
        self._turning_away = threading.Lock()
        self._noticing = Noticing(self.situation, policy)
        self._giving = Giving()
        self._silent_s: dict[str, float] = {}
        """Since when each silent target has been silent, or a review was last asked for, or what runs was changed."""
        self._looked_at: tuple[ComputationUnit, ...] = ()

    def hear(self, event: Event) -> None:
        """Take note of an event."""
        is_sign = isinstance(event, SIGNS)
        self.inbox.put(event, self._clock.now(), is_urgent=not is_sign)
        if isinstance(event, UnitDied | InputLost):
            self.interrupt.set()
            if event.unit not in self.starting:
                self._abandon()
        if not is_sign:
            self._tell(UnitEvent(event))

    def request(self, change: Change) -> Outcome:
        """Take note of a request."""
        request = Request(change, Future())
        request.outcome.set_running_or_notify_cancel()  # who asks can't take it back
        self.inbox.put(request, self._clock.now())
        self.interrupt.set()
        if isinstance(change, Stop):
            self.hurry()
        return request.outcome

    def hurry(self) -> None:
        """Let whatever is under way come to its end: nobody wants it any more."""
        self.ending.set()
        self.interrupt.set()
        self._abandon()
        self.inbox.bell.set()

    def turn_away(self, error: Exception) -> None:
        """There is no manager any more: tell all who wait. For any thread."""
        with self._turning_away:
            self._answer(self.stops)
            self.stops = []
            self.pending.give_up(error)
            for arrival in self.inbox.take():
                if isinstance(arrival.item, Request):
                    arrival.item.outcome.set_exception(error)

    def take_in(self) -> None:
        """Make perturbations of everything that has come."""
        for arrival in self.inbox.take():
            if isinstance(arrival.item, Request):
                self._take_request(arrival.item, arrival.at_s)
            else:
                self._take_event(arrival.item, arrival.at_s)
        ended = self.situation.back_offs.ended(self._clock.now())
        if ended:
            self.perturb(MayStartAgain(ended), self._clock.now())

    def perturb(
        self, perturbation: Perturbation, at_s: float, outcomes: Iterable[Outcome] = (), *, delay_s: float = 0.0
    ) -> None:
        """Let a review be due, at once or later."""
        self.pending.add(perturbation, at_s, outcomes, due_s=at_s + delay_s)
        self._tell(Perturbed(perturbation))

    def blame(self, label: str, lived_s: float, cause: str, *, is_costly: bool = False) -> None:
        """A unit of a transformation has failed after so long a life; see `BackOffs.failed`."""
        now = self._clock.now()
        self._estimator.failed(label, now)
        self.situation.back_offs.failed(label, lived_s, now, cause, is_costly=is_costly)
        self.tell_back_off(label)

    def tell_back_off(self, label: str) -> None:
        """Report how it stands with a transformation, if it is not to be started for now."""
        backing_off = self.situation.back_offs.of(label, self._clock.now())
        if backing_off is not None:
            self._tell(BackedOff(backing_off))

    def refuse(self, by: str, faults: tuple[Fault, ...]) -> None:
        """Note that a new state of the world can't be used; without faults, that it is well again."""
        if faults or self.faults:
            self.faults = faults
            self._tell(WorldRefused(by, faults))

    def _take_event(self, event: Event, at_s: float) -> None:
        if isinstance(event, TopicsStatus):
            if self.living.may_be_silent or self.situation.silences:
                self._take_flows(event.flows, at_s)
            return
        if isinstance(event, UnitStatus) and self.living.may_be_silent:
            self._giving = self._giving.after_status(event, at_s)
        perturbation = self._noticing.perturbation(event, at_s)
        if perturbation is None:
            if isinstance(event, UnitStopped | UnitDied):
                self._answer(self.pending.waiting_for(event.unit))
            return
        if isinstance(perturbation, UnitGone):
            self._take_death(perturbation, at_s)
        elif isinstance(perturbation, UnitKeepsFailing):
            self._give_up(perturbation.unit, at_s, perturbation.text)
            self.perturb(perturbation, at_s)
        else:
            self.perturb(perturbation, at_s, delay_s=self._noticing.delay_s(perturbation, at_s))

    def _take_death(self, gone: UnitGone, at_s: float) -> None:
        situation, unit = self.situation, gone.unit
        if gone.how != "killed" and unit not in situation.failing:
            lived_s = at_s - situation.units[unit].since_s
            self.blame(gone.transformation, lived_s, gone.cause, is_costly=unit in self.starting)
        situation.forget(unit)
        outcomes = self.pending.waiting_for(unit)
        if unit in self.starting:
            self._answer(outcomes)
            self.not_started.append(gone.transformation)
        else:
            self.perturb(gone, at_s, outcomes)

    def _give_up(self, unit: str, at_s: float, cause: str) -> None:
        """Have the next review replace a unit that runs, and blame it."""
        running = self.situation.units.get(unit)
        if running is not None and unit not in self.situation.failing:
            self.blame(running.transformation.label, at_s - running.since_s, cause)
            self.situation.failing.add(unit)

    def _take_flows(self, flows: Mapping[str, Flow], at_s: float) -> None:
        """Have a review made for targets that are silent for too long, and again as long as they are."""
        running, wanted, situation = self._middleware.environment, self.living.world.environment, self.situation
        self._giving = self._giving.after_look(running, at_s)
        if running.units != self._looked_at:
            self._looked_at, self._silent_s = running.units, dict.fromkeys(self._silent_s, at_s)
        situation.silences = self._giving.silences(wanted, running, flows, at_s)
        self._silent_s = {one.target: self._silent_s.get(one.target, one.since_s) for one in situation.silences}
        for silence in situation.silences:
            allowed_us = wanted.target[silence.target].silent_us
            if allowed_us is None or at_s - self._silent_s[silence.target] <= allowed_us / 1e6:
                continue
            self._silent_s[silence.target] = at_s
            silent_s = at_s - silence.since_s
            for unit in silence.units:
                self._give_up(unit, at_s, f"it has given nothing for {silent_s:.1f} s")
            self.perturb(TargetSilent(silence.target, silence.topic, silent_s, silence.units), at_s)

    def _abandon(self) -> None:
        """Don't let an update that waits for slow units hold up what is more urgent."""
        if self.starting:
            self._middleware.abandon()

    def _answer(self, outcomes: Iterable[Outcome]) -> None:
        """Tell those who asked that no review will follow."""
        for outcome in outcomes:
            outcome.set_result(None)

    def _take_request(self, request: Request, at_s: float) -> None:
        change, outcome = request.change, request.outcome
        try:
            perturbation = self._perturbation_of(change, outcome)
        except InputError as error:
            if isinstance(change, ReplaceWorld):
                self.refuse(change.by, error.faults)
            outcome.set_exception(error)
            return
        if perturbation is not None:
            self.perturb(perturbation, at_s, [outcome])
        elif not isinstance(change, Stop | KillUnit):
            outcome.set_result(None)

    def _perturbation_of(self, change: Change, outcome: Outcome) -> Perturbation | None:
        match change:
            case Stop():
                self.stops.append(outcome)
                return None
            case KillUnit(unit):
                self._kill(unit)
                self.pending.wait_for(unit, outcome)
                return None
            case LoseHost(host, cause):
                self._lose_host(host)
                return HostGone(host, cause)
            case RegainHost(host):
                if host not in self.situation.lost_hosts:
                    raise InputError.of(f"host {host!r} is not gone")
                self.situation.lost_hosts -= {host}
                return HostBack(host)
            case ReviewNow(by):
                self.situation.back_offs.forgive_all()
                return ReviewRequested(by)
            case _:
                return self._change_world(change)

    def _kill(self, unit: str) -> None:
        running = self._middleware.environment.unit
        if unit not in running:
            known = ", ".join(running)
            raise InputError.of(f"no unit {unit!r} runs", mend=f"these run: {known}" if known else None)
        self.situation.killed.add(unit)
        self._middleware.kill(unit)

    def _lose_host(self, host: str) -> None:
        hosts = {one.host for one in self.living.world.environment.library if one.host is not None}
        if host not in hosts:
            mend = f"choose one of {', '.join(sorted(hosts))}" if hosts else "no transformation names a host"
            raise InputError.of(f"there is no host {host!r}", mend=mend)
        self.situation.lost_hosts |= {host}

    def _change_world(self, change: WorldChange) -> WorldChanged | None:
        living = self.living.after(change)
        before, after = self.living.world, living.world
        start = time.perf_counter()
        self.matching.take(after)
        self.match_s += time.perf_counter() - start
        self.living = living
        differs = difference(before, after)
        for label in (*differs.replaced_transformations, *differs.removed_transformations):
            self.situation.back_offs.forgive(label)
        if isinstance(change, ReplaceWorld):
            self.refuse(change.by, ())
        by = change.by if isinstance(change, ReplaceWorld) else type(change).__name__
        return WorldChanged(by, differs) if differs else None
