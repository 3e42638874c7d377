"""The manager: keeps the running configuration optimal (paper, Figure 1 and section IV-C).

One thread waits for perturbations (stable interval) and answers them (review interval). Meanwhile units keep running in
the threads or processes of the middleware, and their events wait in the inbox. `decisions.decide` decides about each
item; the manager carries out the effects.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import replace
from math import inf

from cfgplan.api import World
from cfgplan.arguments import unsuitable
from cfgplan.domain import Environment, Statement
from cfgplan.errors import Fault, InputError
from cfgplan.facts import FactValue
from cfgplan.planning import Planner
from cfgplan.validity import kept_us
from cfgplan_runtime.errors import (
    AbandonedError,
    ApplyError,
    NoSourceError,
    RuntimeFaultError,
    StaleChangeSetError,
)
from cfgplan_runtime.lifecycle import transitions
from cfgplan_runtime.lifecycle.basis import Preview, preview_of
from cfgplan_runtime.lifecycle.changes import Change, Stop
from cfgplan_runtime.lifecycle.configuration import as_it_runs
from cfgplan_runtime.lifecycle.decisions import BreakIn, breaks_in, decide, first_state
from cfgplan_runtime.lifecycle.deliberation import Deliberation, Findings
from cfgplan_runtime.lifecycle.guarded_estimator import GuardedEstimator
from cfgplan_runtime.lifecycle.inbox import (
    Asked,
    FactSeen,
    Inbox,
    Item,
    Leave,
    OldCode,
    Outcome,
    PreviewAsked,
    QualityTold,
    Unusable,
)
from cfgplan_runtime.lifecycle.kinds import Urgency, kind_of
from cfgplan_runtime.lifecycle.perturbations import Started
from cfgplan_runtime.lifecycle.policy import Policy
from cfgplan_runtime.lifecycle.reports import Report, Snapshot, TargetView, UnitEvent
from cfgplan_runtime.lifecycle.seams import DeclaredCosts, Estimator, FailureStore, Middleware, SystemClock, TimeSource
from cfgplan_runtime.lifecycle.state import State
from cfgplan_runtime.lifecycle.stream_qualities import quality_views
from cfgplan_runtime.lifecycle.supposing import Supposing
from cfgplan_runtime.lifecycle.transitions import Effect, Input, TimedInput
from cfgplan_runtime.lifecycle.views import saving_us, target_views, unit_views
from cfgplan_runtime.lifecycle.warm_matching import WarmMatching
from cfgplan_runtime.lifecycle.worlds import WorldVersion
from cfgplan_runtime.supervision.events import Event
from cfgplan_runtime.supervision.listeners import Listeners

_LONG_S = 3600.0
_UNDONE = (ApplyError, NoSourceError, StaleChangeSetError)
"""What `Middleware.apply` may raise while the middleware itself goes on."""


class Manager:
    """Reviews the configuration of a `middleware` whenever it is perturbed; every part can be replaced.

    `world` is what is wanted at first, and `policy` how reviews are made. By default `planner` reuses proofs of earlier
    plans, `estimator` uses declared costs, and `clock` is the computer's. `report` is the first listener, see `listen`.
    The first review carries out the plan of `first`, unless it is stale by then. Raises InputError for a world whose
    tags can't be matched, InvalidValueError for a `world`, `planner` or `policy` of another kind. As a context manager
    it works in a thread of its own, and stops all units at the end; or call `step` or `run`.
    """

    def __init__(
        self,
        world: World,
        middleware: Middleware,
        *,
        planner: Planner | None = None,
        estimator: Estimator | None = None,
        clock: TimeSource | None = None,
        policy: Policy | None = None,
        report: Callable[[Report], None] | None = None,
        first: Preview | None = None,
    ) -> None:
        if not isinstance(world, World):
            raise unsuitable("Manager()", "world", "a World", world)
        if not (planner is None or callable(planner)):
            raise unsuitable("Manager()", "planner", "a function or None", planner)
        if not (policy is None or isinstance(policy, Policy)):
            raise unsuitable("Manager()", "policy", "a Policy or None", policy)
        self._middleware = middleware
        self._clock = clock or SystemClock()
        self._estimator = GuardedEstimator(estimator or DeclaredCosts())
        self._listeners: Listeners[Report] = Listeners(() if report is None else (report,))
        self._inbox = Inbox()
        self._interrupt, self._ending = threading.Event(), threading.Event()
        """`_interrupt`: something has come that the plan under way can't know. `_ending`: the end was asked for."""
        policy = policy or Policy()
        self._state = first_state(world, policy, self._clock.now())
        self._matching = WarmMatching(policy.reasoner, policy.match_limit_s)
        self._matching.take(self.world)
        self._deliberation = Deliberation(
            planner,
            self._estimator,
            policy,
            self._matching,
            lambda: self._interrupt.is_set() or self._ending.is_set(),
        )
        self._first = first
        self._supposing = Supposing(planner, policy)
        self._is_busy = False
        self._thread: threading.Thread | None = None
        self._quiet = threading.Condition()
        self._turning_away = threading.Lock()
        self._decide(Started())
        middleware.listen(self._hear)

    # Any thread may call these.

    def request(self, change: Change) -> Outcome:
        """Ask for a change. Returns a future that is done when the review of the change is over.

        Its result is the review, or None if nothing changes. It raises InputError for a bad change, and
        RuntimeFaultError if the manager ends before.
        """
        outcome: Outcome = Future()
        outcome.set_running_or_notify_cancel()  # who asks can't take it back
        self._put(Asked(change, outcome))
        if self._state.is_over:
            self._turn_away()
        return outcome

    def preview(self) -> Future[Preview]:
        """Ask for a preview of a review. Returns a future, done when no review is due or under way.

        It raises RuntimeFaultError if the manager ends before.
        """
        outcome: Future[Preview] = Future()
        outcome.set_running_or_notify_cancel()
        self._put(PreviewAsked(outcome))
        if self._state.is_over:
            self._turn_away()
        return outcome

    def suppose(self, change: Change) -> Findings:
        """Return the plan of a review after a change, with the costs of the last review. The run is not changed.

        It is made in the calling thread, and no review waits for it. Only changes of the world and of the hosts in
        service can be supposed. Raises InputError for others, and for a bad one.
        """
        return self._supposing.think(self._state, change)

    def observe_fact(self, name: str, value: FactValue) -> None:
        """Pass on a stream's `value` of a fact, by its key `name`. Thread-safe."""
        self._put(FactSeen(name, value))

    def tell_quality(self, statement: Statement, value: float) -> None:
        """Pass on the quality of an output that a topic tells. Thread-safe.

        The `statement` is about one attribute of the output; `value` is in units of this attribute.
        """
        self._put(QualityTold(statement, value))

    def refuse(self, by: str, faults: tuple[Fault, ...]) -> None:
        """Report that the world's file, called `by`, has these `faults`; without any, that it is valid again."""
        self._put(Unusable(by, faults))

    def note_old_code(self, file: str, units: tuple[str, ...]) -> None:
        """Report the `units` that run with other code than `file` has now; an empty tuple says that none does."""
        self._put(OldCode(file, units))

    def listen(self, listener: Callable[[Report], None]) -> None:
        """Call `listener` with every report, from several threads; it returns at once."""
        self._listeners.add(listener)

    def snapshot(self) -> Snapshot:
        """A frozen view of the configuration, targets, hosts and reviews at this moment."""
        state, running, now = self._state, self._middleware.environment, self._clock.now()
        world, situation, seen = state.version.world, state.situation, state.plan_input.world.environment
        return Snapshot(
            now,
            state.phase,
            as_it_runs(world.environment, running),
            self.targets,
            unit_views(running, situation, state.observations),
            tuple(entry.perturbation for entry in state.entries),
            state.reviews,
            situation.back_offs.view(now),
            situation.lost_hosts(world.environment),
            tuple(sorted(state.version.declared)),
            world.horizon_s,
            max(0.0, state.horizon_at_s - now),
            _running_cost_us(running, state),
            saving_us(state.reviews),
            state.faults,
            state.version.removed,
            situation.clocks_ahead_us,
            tuple(seen.variable.values()),
            seen.left_out,
            seen.barred,
            {name: now - last.at_s for name, last in state.heard.items()},
            seen.qualities_now,
            quality_views(world.environment.with_facts(situation.facts), state, now),
            state.old_code,
        )

    @property
    def targets(self) -> tuple[TargetView, ...]:
        """Each target as it is at this moment: a small part of `snapshot`."""
        state, running = self._state, self._middleware.environment
        wanted = state.version.world.environment
        return target_views(wanted, running, state.reviews, state.situation.silences, self._clock.now())

    @property
    def world(self) -> World:
        """The world that holds now."""
        return self._state.version.world

    @property
    def silent(self) -> frozenset[str]:
        """Labels of targets that count as unmet because no element comes for them."""
        return frozenset(silence.target for silence in self._state.situation.silences)

    @property
    def is_settled(self) -> bool:
        """True while no review is due or under way."""
        return self._inbox.is_empty and not self._is_busy and self._state.is_settled

    def settle(self, timeout_s: float | None = None) -> bool:
        """Wait until no review is due or under way. Returns False if `timeout_s` seconds pass before."""
        with self._quiet:
            return self._quiet.wait_for(lambda: self.is_settled, timeout_s)

    def wait(self, timeout_s: float | None = None) -> bool:
        """Wait for the manager's end. Returns False if `timeout_s` seconds pass before."""
        with self._quiet:
            return self._quiet.wait_for(lambda: self._state.is_over, timeout_s)

    # The thread.

    def start(self) -> None:
        """Begin to work, in a thread."""
        self._thread = threading.Thread(target=self._work, name="cfgplan-manager", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Stop every unit, then end."""
        self.request(Stop())
        if self._thread is not None:
            self._thread.join()

    def close(self) -> None:
        """End after the step that is under way; units are left to the middleware."""
        self._put(Leave())
        if self._thread is not None:
            self._thread.join()

    def __enter__(self) -> Manager:
        self.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            self.stop()
        else:
            self.close()

    # Work, in one thread.

    def run(self, for_s: float = inf) -> None:
        """Work in the calling thread for `for_s` seconds, or until stopped."""
        end = self._clock.now() + for_s
        while not self._state.is_over and self._clock.now() < end:
            self.step(end - self._clock.now())

    def step(self, timeout_s: float = 0.0) -> None:
        """Wait up to `timeout_s` seconds for a perturbation, and answer it if one comes."""
        if self._inbox.is_empty:
            self._wait(self._clock.now() + timeout_s)
        self._is_busy = True
        self._take_in()
        while self._state.doing is not None:  # a review that gathers what comes
            self._wait(inf)
            self._take_in()
        self._settle()

    def _wait(self, until_s: float) -> None:
        """Wait until something comes in or is due, or until `until_s`."""
        now = self._clock.now()
        until_s = min(until_s, self._state.wake_s, now + _LONG_S)
        if until_s > now:
            self._clock.wait(self._inbox.waker, until_s - now)

    def _take_in(self) -> None:
        """Decide about everything that has come, then about the work that is due."""
        self._interrupt.clear()
        self._decide_arrivals()
        if not self._state.is_over:
            self._decide(transitions.Tick(time.time()))

    def _decide_arrivals(self) -> None:
        while arrival := self._inbox.take():
            self._decide(arrival.item, arrival.at_s)

    def _decide(self, what: Input, at_s: float | None = None) -> None:
        """Decide about an item that comes now, or came at `at_s`, and carry out the effects."""
        at_s = self._clock.now() if at_s is None else at_s
        self._state, effects = decide(self._state, TimedInput(at_s, what, self._middleware.environment))
        for effect in effects:
            self._carry_out(effect)

    def _carry_out(self, effect: Effect) -> None:
        match effect:
            case transitions.Tell(report):
                self._tell(report)
            case transitions.Respond(outcome, answer):
                if isinstance(answer, Exception):
                    outcome.set_exception(answer)
                else:
                    outcome.set_result(answer)
            case transitions.Match():
                self._match(effect)
            case transitions.Terminate(unit):
                self._middleware.kill(unit)
            case transitions.Observe():
                found = tuple(self._middleware.observe())
                self._estimator.observe(found, self._clock.now())
                self._decide(transitions.Seen(found))
            case transitions.LearnOfFailure(place):
                self._estimator.failed(place.label, self._clock.now(), place.host)
            case transitions.Remember(place, failures):
                if isinstance(self._middleware, FailureStore):
                    with suppress(RuntimeFaultError):  # it is closed, and its units died of that
                        self._middleware.remember(place.label, place.host, failures)
            case transitions.MakePlan():
                self._plan(effect)
            case transitions.MakePreview():
                self._preview(effect)
            case transitions.JudgeGiven(plan_input, change_set):
                self._decide(transitions.GivenJudged(self._deliberation.judged(plan_input, change_set)))
            case transitions.MakeLook(plan_input, hopes, unmet, known):
                self._interrupt.clear()
                looked = self._deliberation.look(plan_input, hopes, unmet, known, stop=self._interrupt)
                self._interrupt.clear()
                self._decide_arrivals()
                self._decide(looked)
            case transitions.ApplyUpdate():
                self._apply(effect)
            case transitions.Prepare(plan_input):
                self._interrupt.clear()
                if self._inbox.is_empty:
                    self._deliberation.prepare(plan_input, stop=self._interrupt)
            case transitions.StopAll():
                self._middleware.stop()
                self._decide(transitions.Finished())

    def _match(self, order: transitions.Match) -> None:
        start = time.perf_counter()
        found: WorldVersion | InputError
        try:
            found = order.version.after(order.change)
            self._matching.take(found.world)
        except InputError as error:
            found = error
        self._decide(transitions.Matched(order.asked, found, time.perf_counter() - start))

    def _plan(self, order: transitions.MakePlan) -> None:
        stop = self._ending if order.is_last else self._interrupt
        first, self._first = self._first, None
        if first is not None and first.holds_for(order.plan_input):
            findings = first.findings
        else:
            findings = self._deliberation.think(order.plan_input, optimises=order.optimises, stop=stop)
        was_interrupted = self._interrupt.is_set()
        self._interrupt.clear()
        self._decide_arrivals()
        self._decide(transitions.Planned(findings, was_interrupted))

    def _preview(self, order: transitions.MakePreview) -> None:
        preview = preview_of(self._deliberation, order.plan_input, self._interrupt)
        for outcome in order.outcomes:
            if self._interrupt.is_set():
                self._put(PreviewAsked(outcome))
            else:
                outcome.set_result(preview)

    def _apply(self, order: transitions.ApplyUpdate) -> None:
        start, failed = time.perf_counter(), None
        try:
            if self._ending.is_set():  # it came before there was an update to abandon
                raise AbandonedError("the manager is to end")
            self._middleware.apply(order.change_set, basis=order.basis, keeps_new=True)
        except Exception as error:
            if isinstance(error, RuntimeFaultError) and not isinstance(error, _UNDONE):
                raise  # nothing runs any more
            failed = error
        seconds = time.perf_counter() - start
        self._decide_arrivals()
        self._decide(transitions.Updated(seconds, failed))

    def _work(self) -> None:
        self._deliberation.warm_up()
        try:
            self.run()
        except RuntimeFaultError as error:
            self._finish(str(error))
        except BaseException as error:
            self._finish(f"{type(error).__name__}: {error}")
            raise

    def _finish(self, cause: str) -> None:
        self._decide(transitions.Finished(cause))
        self._settle()

    def _settle(self) -> None:
        """Wake the threads that wait until the manager is settled or has ended."""
        self._is_busy = False
        if self._state.is_over:
            self._turn_away()
        with self._quiet:
            self._quiet.notify_all()

    def _turn_away(self) -> None:
        """Fail the requests that came after the end. For any thread."""
        with self._turning_away:
            while arrival := self._inbox.take():
                if isinstance(arrival.item, Asked | PreviewAsked):
                    arrival.item.outcome.set_exception(RuntimeFaultError("the run has ended"))

    # From any thread.

    def _hear(self, event: Event) -> None:
        is_sign = kind_of(event).urgency is Urgency.SIGN
        self._put(event, is_urgent=not is_sign)
        if not is_sign:
            running = self._state.situation.units.get(getattr(event, "unit", None) or "")
            self._tell(UnitEvent(event, None if running is None else running.host))

    def _put(self, item: Item, *, is_urgent: bool = True) -> None:
        """Queue an item, and break into the work under way if the item can't wait."""
        self._inbox.put(item, self._clock.now(), is_urgent=is_urgent)
        how = breaks_in(self._state.doing, item)
        if BreakIn.END in how:
            self._ending.set()
        if BreakIn.INTERRUPT in how:
            self._interrupt.set()
        if BreakIn.ABANDON in how:
            self._middleware.abandon()

    def _tell(self, report: Report) -> None:
        self._listeners.tell(report)


def _running_cost_us(running: Environment, state: State) -> int:
    """The cost of the running units over the horizon, by the estimates of the last review."""
    world = state.version.world
    library = tuple(state.costs.get(known.label, known) for known in world.environment.library)
    return kept_us(as_it_runs(replace(world.environment, library=library), running), world.horizon_s)
