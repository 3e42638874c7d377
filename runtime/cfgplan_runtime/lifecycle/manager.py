"""The manager: keeps what runs the best that the world allows (paper, Figure 1 and section IV-C).

One thread waits for perturbations (stable interval) and answers them (review interval). Units run on in the threads
or processes of the middleware meanwhile, and what happens there is never lost: it waits in the inbox.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from math import inf
from types import TracebackType

from cfgplan.api import World
from cfgplan.costs import keep_cost_us
from cfgplan.domain import Environment
from cfgplan.errors import Fault
from cfgplan.planning import Planner
from cfgplan_runtime.errors import RuntimeFaultError
from cfgplan_runtime.lifecycle.changes import Change, Stop
from cfgplan_runtime.lifecycle.inbox import Outcome
from cfgplan_runtime.lifecycle.intake import Intake
from cfgplan_runtime.lifecycle.perturbations import HorizonReached, Started
from cfgplan_runtime.lifecycle.policy import Policy
from cfgplan_runtime.lifecycle.reports import Decision, Ended, Observed, Phase, Report, Review, Snapshot
from cfgplan_runtime.lifecycle.reviewing import Reviewing
from cfgplan_runtime.lifecycle.seams import Clock, DeclaredCosts, Estimator, Middleware, SystemClock
from cfgplan_runtime.lifecycle.showing import saving_us, target_views, unit_views
from cfgplan_runtime.supervision.observation import Observation

_LONG_S = 3600.0


class Manager:
    """Reviews the configuration of a middleware whenever it is perturbed; every part can be replaced.

    `planner` is by default one that remembers from plan to plan, `estimator` believes what is declared, `clock` is
    the computer's. `report` gets everything that happens, see `listen`. Raises InputError for a world whose tags
    can't be matched. As a context manager it works in a thread of its own, and stops all units at the end; or call
    `step` or `run`.
    """

    def __init__(
        self,
        world: World,
        middleware: Middleware,
        *,
        planner: Planner | None = None,
        estimator: Estimator | None = None,
        clock: Clock | None = None,
        policy: Policy | None = None,
        report: Callable[[Report], None] | None = None,
    ) -> None:
        self._middleware = middleware
        self._policy = policy or Policy()
        self._clock = clock or SystemClock()
        self._estimator = estimator or DeclaredCosts()
        self._listeners = () if report is None else (report,)
        self._intake = Intake(world, middleware, self._estimator, self._clock, self._policy, self._tell)
        self._reviewing = Reviewing(
            middleware, planner, self._estimator, self._clock, self._policy, self._intake, self._tell
        )
        self._reviews: tuple[Review, ...] = ()
        self._phase = Phase.STABLE
        self._observations: Mapping[str, Observation] = {}
        self._cycle_began_s = inf
        self._observe_at_s = inf
        self._is_busy = self._is_closing = False
        self._thread: threading.Thread | None = None
        self._quiet = threading.Condition()
        self._intake.perturb(Started(), self._clock.now())
        middleware.listen(self._intake.hear)

    # What others ask, from any thread.

    def request(self, change: Change) -> Outcome:
        """Ask for a change; what it gives resolves when the review that took it in is over.

        None comes of what changes nothing. The future raises InputError for a bad change, and RuntimeFaultError
        if the manager ends before.
        """
        outcome = self._intake.request(change)
        if self._phase is Phase.STOPPED:
            self._turn_away()
        return outcome

    def refuse(self, by: str, faults: tuple[Fault, ...]) -> None:
        """Note that a new state of the world's file can't be used; without faults, that it is well again."""
        self._intake.refuse(by, faults)

    def listen(self, listener: Callable[[Report], None]) -> None:
        """Have everything told that happens, from several threads; `listener` returns at once and never raises."""
        self._listeners = (*self._listeners, listener)

    def snapshot(self) -> Snapshot:
        """Everything there is to know now."""
        running, world, reviews = self._middleware.environment, self.world, self._reviews
        now, situation = self._clock.now(), self._intake.situation
        return Snapshot(
            now,
            self._phase,
            Environment(running.units, world.environment.library, world.environment.targets),
            target_views(world.environment, running, reviews, situation.silences, now),
            unit_views(running, situation, self._observations),
            tuple(entry.perturbation for entry in self._intake.pending.entries),
            reviews,
            situation.back_offs.view(now),
            tuple(sorted(situation.lost_hosts)),
            tuple(sorted(self._intake.living.declared)),
            world.horizon_s,
            max(0.0, self._horizon_at_s - now),
            self._running_cost_us(running, world),
            saving_us(reviews),
            self._intake.faults,
            self._intake.living.removed,
        )

    @property
    def world(self) -> World:
        """The world that holds now."""
        return self._intake.living.world

    @property
    def silent(self) -> frozenset[str]:
        """Labels of targets that count as unmet, since nothing comes for them."""
        return frozenset(silence.target for silence in self._intake.situation.silences)

    @property
    def is_settled(self) -> bool:
        """Whether nothing is to be reviewed."""
        return self._intake.inbox.is_empty and not self._is_busy and self._intake.pending.is_empty

    def settle(self, timeout_s: float | None = None) -> bool:
        """Wait until nothing is to be reviewed; whether that is so."""
        with self._quiet:
            return self._quiet.wait_for(lambda: self.is_settled, timeout_s)

    def wait(self, timeout_s: float | None = None) -> bool:
        """Wait for the manager's end; whether it has come."""
        with self._quiet:
            return self._quiet.wait_for(lambda: self._phase is Phase.STOPPED, timeout_s)

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
        self._is_closing = True
        self._intake.hurry()
        if self._thread is not None:
            self._thread.join()

    def __enter__(self) -> Manager:
        self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self.stop()
        else:
            self.close()

    # Work, in one thread.

    def run(self, for_s: float = inf) -> None:
        """Work in the calling thread, for so long or until stopped."""
        end = self._clock.now() + for_s
        while self._phase is not Phase.STOPPED and self._clock.now() < end:
            self.step(end - self._clock.now())

    def step(self, timeout_s: float = 0.0) -> None:
        """Wait for a perturbation at most so long, and answer it if one comes."""
        intake = self._intake
        if intake.inbox.is_empty and not self._is_closing:
            self._wait(self._clock.now() + timeout_s)
        self._is_busy = True
        self._take_in()
        now = self._clock.now()
        if self._is_closing or intake.stops:
            self._end()
        elif intake.pending.due_s <= now:
            self._phase = Phase.REVIEW
            self._gather()
            self._review()
        elif self._observe_at_s <= now:
            self._observe()
        self._is_busy = False
        with self._quiet:
            self._quiet.notify_all()

    @property
    def _horizon_at_s(self) -> float:
        return self._cycle_began_s + (self.world.horizon_s or inf)

    def _wait(self, until_s: float) -> None:
        """Wait until something comes in, or is due."""
        due_s = min(self._intake.pending.due_s, self._intake.situation.back_offs.next_end_s)
        until_s = min(until_s, due_s, self._horizon_at_s, self._observe_at_s, self._clock.now() + _LONG_S)
        if until_s > self._clock.now():
            self._clock.wait(self._intake.inbox.bell, until_s - self._clock.now())

    def _take_in(self) -> None:
        self._intake.take_in()
        if self._horizon_at_s <= self._clock.now():
            self._intake.perturb(HorizonReached(self.world.horizon_s), self._horizon_at_s)
            self._cycle_began_s = inf

    def _gather(self) -> None:
        """What comes shortly after the first perturbation has the same origin, often enough."""
        end = self._clock.now() + self._policy.gather_s
        while self._clock.now() < end:
            self._clock.wait(self._intake.inbox.bell, end - self._clock.now())
            self._take_in()

    def _review(self) -> None:
        if any(isinstance(entry.perturbation, HorizonReached) for entry in self._intake.pending.entries):
            self._observe()
        review = self._reviewing.review(lambda: self._is_closing)
        if review is not None:
            self._reviews = (*self._reviews, review)[-self._policy.reviews_kept :]
            if self._reviewing.optimised:
                self._cycle_began_s = self._clock.now()
        if self._observe_at_s == inf:
            self._observe_at_s = self._clock.now() + self._policy.observe_every_s
        self._phase = Phase.STABLE
        self._reviewing.settle_outcomes()
        if review is not None and review.decision is Decision.APPLIED:
            self._reviewing.prepare()

    def _observe(self) -> None:
        now = self._clock.now()
        found = tuple(self._middleware.observe())
        self._observe_at_s = now + self._policy.observe_every_s
        self._observations = {seen.unit: seen for seen in found}
        self._estimator.observe(found, now)
        self._tell(Observed(found))

    def _running_cost_us(self, running: Environment, world: World) -> int:
        library, estimated = world.environment.transformation, self._reviewing.costs
        return sum(
            keep_cost_us(estimated.get(unit.transformation, library[unit.transformation]), world.horizon_s)
            for unit in running.units
            if unit.transformation in library
        )

    def _work(self) -> None:
        self._reviewing.warm_up()
        try:
            self.run()
        except RuntimeFaultError as error:
            self._finish(str(error))
        except BaseException as error:
            self._finish(f"{type(error).__name__}: {error}")
            raise

    def _end(self) -> None:
        if not self._is_closing:
            self._middleware.stop()
        self._finish("")

    def _finish(self, cause: str) -> None:
        self._phase = Phase.STOPPED
        self._turn_away()
        self._tell(Ended(cause))
        with self._quiet:
            self._quiet.notify_all()

    def _turn_away(self) -> None:
        """Whoever still waits is told that there is no manager any more."""
        self._intake.turn_away(RuntimeFaultError("the manager has ended"))

    def _tell(self, report: Report) -> None:
        for listener in self._listeners:
            listener(report)
