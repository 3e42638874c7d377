"""The review interval: everything that has happened is answered by one plan, which is carried out and put on record."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from importlib import import_module

from cfgplan.domain import Transformation
from cfgplan.planning import Plan, Planner, Problem, Progress
from cfgplan.reasons import unmet_reasons
from cfgplan_runtime.lifecycle.acting import Acting
from cfgplan_runtime.lifecycle.deliberation import Deliberation, Thought
from cfgplan_runtime.lifecycle.inbox import Outcome
from cfgplan_runtime.lifecycle.intake import Intake
from cfgplan_runtime.lifecycle.pending import Entry
from cfgplan_runtime.lifecycle.perturbations import (
    HorizonReached,
    MayStartAgain,
    ReviewRequested,
    Started,
    UpdateFailed,
)
from cfgplan_runtime.lifecycle.policy import Policy
from cfgplan_runtime.lifecycle.reports import Decision, Report, Review, ReviewBegan, Reviewed
from cfgplan_runtime.lifecycle.seams import Clock, Estimator, Middleware
from cfgplan_runtime.lifecycle.showing import silence_reason
from cfgplan_runtime.lifecycle.waiting import without_stopping
from cfgplan_runtime.supervision.delays import doubling_s

_MOST_NAMED = 4
_OPTIMISING = (Started, HorizonReached, ReviewRequested, MayStartAgain)


class WarmPlanner:
    """The planner's session as a planner; setting `stop` ends a plan early."""

    def __init__(self) -> None:
        from cfgplan.planners.cpsat.session import PlannerSession

        self._session = PlannerSession()
        self.stop: threading.Event | None = None

    def warm_up(self) -> None:
        """Import the solver, which takes long, before a plan needs it."""
        import_module("cfgplan.planners.fleet.search")

    def __call__(
        self,
        problem: Problem,
        *,
        time_limit_s: float | None = None,
        report: Callable[[Progress], None] | None = None,
    ) -> Plan:
        return self._session.plan(problem, time_limit_s=time_limit_s, report=report, stop=self.stop)


class Reviewing:
    """Does one review after the other."""

    def __init__(
        self,
        middleware: Middleware,
        planner: Planner | None,
        estimator: Estimator,
        clock: Clock,
        policy: Policy,
        intake: Intake,
        tell: Callable[[Report], None],
    ) -> None:
        self._middleware = middleware
        self._clock = clock
        self._policy = policy
        self._intake = intake
        self._tell = tell
        self._warm = WarmPlanner() if planner is None else None
        chosen = planner or self._warm
        assert chosen is not None
        self._deliberation = Deliberation(
            chosen,
            estimator,
            policy.time_limit_s,
            intake.matching,
            lambda: intake.interrupt.is_set() or intake.ending.is_set(),
        )
        self._acting = Acting(middleware, intake, clock, policy.postpone_s)
        self._number = 0
        self._failures = 0
        self._owes_optimising = False
        self._answered: list[tuple[Outcome, Review]] = []
        self.optimised = False
        """Whether the last review has planned for a whole horizon from then on."""
        self.costs: Mapping[str, Transformation] = {}
        """The library of the last review, with estimated costs, by label."""

    def review(self, is_closing: Callable[[], bool]) -> Review | None:
        """Answer everything that is pending; None if the end of the manager came in between."""
        intake, at_s, time_s = self._intake, self._clock.now(), time.time()
        entries = intake.pending.take()
        self._number += 1
        self._tell(ReviewBegan(self._number, tuple(entry.perturbation for entry in entries)))
        detect_s = at_s - min(entry.at_s for entry in entries)
        for chance in range(self._policy.interruptions + 1):
            is_last = chance == self._policy.interruptions
            intake.interrupt.clear()
            intake.take_in()
            entries += intake.pending.take()
            optimises = self._owes_optimising or any(isinstance(e.perturbation, _OPTIMISING) for e in entries)
            thought = self._think(optimises=optimises, stop=intake.ending if is_last else intake.interrupt)
            self._let_wait(thought)
            thought.unmet = self._reasons(thought)
            intake.take_in()
            if is_closing() or intake.stops:
                intake.pending.put_back(entries)
                return None
            if is_last or not (intake.pending.entries or intake.interrupt.is_set()):
                break
        try:
            failed = self._act(thought)
        except BaseException:
            intake.pending.put_back(entries)
            raise
        review = self._record(at_s, time_s, entries, thought, failed)
        review = replace(review, seconds={"detect": detect_s, "match": intake.match_s, **thought.seconds})
        intake.match_s = 0.0
        self._follow_up(failed, optimises=optimises)
        self.optimised = failed is None and (optimises or review.decision is Decision.APPLIED)
        self.costs = thought.planned.transformation
        self._answered += [(outcome, review) for entry in entries for outcome in entry.outcomes]
        self._tell(Reviewed(review))
        return review

    def prepare(self) -> None:
        """Let the planner see what runs now, so that it repairs that fast; a loss breaks in."""
        intake = self._intake
        intake.interrupt.clear()
        if self._warm is not None and intake.inbox.is_empty:
            self._warm.stop = intake.interrupt
            self._deliberation.prepare(
                intake.living.world, intake.matching.similarity, self._middleware.environment, intake.situation
            )

    def warm_up(self) -> None:
        """Do in a thread of its own what the first difficult plan would have to wait for."""
        if self._warm is not None:
            threading.Thread(target=self._warm.warm_up, name="cfgplan-warm-up", daemon=True).start()

    def settle_outcomes(self) -> None:
        """Tell those who asked that their review is over."""
        answered, self._answered = self._answered, []
        for outcome, review in answered:
            outcome.set_result(review)

    def _think(self, *, optimises: bool, stop: threading.Event) -> Thought:
        intake, running = self._intake, self._middleware.environment
        intake.situation.note(running, self._clock.now())
        if self._warm is not None:
            self._warm.stop = stop
        return self._deliberation.think(
            intake.living.world, intake.matching.similarity, running, intake.situation, optimises=optimises
        )

    def _let_wait(self, thought: Thought) -> None:
        """Where targets are given up for what may start again, keep units that only wait for it, and hurry it on."""
        intake, situation, change_set = self._intake, self._intake.situation, thought.change_set
        refusals = situation.back_offs.refusals()
        avoided = situation.back_offs.avoided - refusals.avoided
        if change_set is None or not thought.unmet or avoided.isdisjoint(thought.avoided):
            return
        hoped = self._deliberation.think(
            intake.living.world,
            intake.matching.similarity,
            thought.running,
            replace(situation, back_offs=refusals),
            optimises=True,
        )
        thought.seconds["plan"] += hoped.seconds.get("plan", 0.0)
        if hoped.change_set is None or not set(hoped.met) - set(thought.met):
            return
        for label in sorted({unit.transformation for unit in hoped.change_set.started} & avoided):
            if situation.back_offs.shorten(label, self._clock.now()):
                intake.tell_back_off(label)
        spared = set(change_set.stopped).difference(hoped.change_set.stopped, situation.failing)
        thought.change_set = without_stopping(change_set, thought.running, spared)
        if not thought.change_set and thought.decision is Decision.APPLIED:
            thought.decision = Decision.KEPT

    def _reasons(self, thought: Thought) -> Mapping[str, str]:
        """Why targets are given up; where all that is missing is left out for now, that is the reason."""
        if not (thought.unmet and thought.avoided):
            return thought.unmet
        world, similarity = self._intake.living.world, self._intake.matching.similarity
        impossible, impossible_now = (
            unmet_reasons(Problem(environment, similarity, world.horizon_s, world.max_cost_us))
            for environment in (world.environment, thought.planned)
        )
        some = [f"{label} ({thought.avoided[label]})" for label in sorted(thought.avoided)[:_MOST_NAMED]]
        more = len(thought.avoided) - len(some)
        left_out = f"left out for now: {', '.join(some)}{f' and {more} more' if more else ''}"
        return {
            label: left_out if label in impossible_now.keys() - impossible.keys() else reason
            for label, reason in thought.unmet.items()
        }

    def _act(self, thought: Thought) -> UpdateFailed | None:
        if thought.change_set is None:
            return UpdateFailed(thought.cause)
        return self._acting.act(thought)

    def _record(
        self, at_s: float, time_s: float, entries: tuple[Entry, ...], thought: Thought, failed: UpdateFailed | None
    ) -> Review:
        silent = {one.target: silence_reason(one, at_s) for one in self._intake.situation.silences}
        is_failed = failed is not None and thought.change_set is not None
        return Review(
            self._number,
            at_s,
            time_s,
            tuple(entry.perturbation for entry in entries),
            Decision.FAILED if is_failed else thought.decision,
            self._intake.living.world.horizon_s,
            thought.cost_before_us,
            thought.cost_us,
            thought.bound_us,
            thought.is_proven,
            thought.change_set,
            tuple(label for label in thought.met if label not in silent),
            {**{label: reason for label, reason in silent.items() if label in thought.met}, **thought.unmet},
            tuple(sorted(thought.avoided)),
            warnings=(*self._intake.matching.warnings, *thought.warnings),
            cause="" if failed is None else failed.cause,
            undecided=thought.undecided,
        )

    def _follow_up(self, failed: UpdateFailed | None, *, optimises: bool) -> None:
        """After a failure comes another review: at once if the next plan is sure to be another one, else later."""
        if failed is None:
            self._failures, self._owes_optimising = 0, False
            return
        self._failures += 1
        self._owes_optimising = optimises
        is_other = bool(failed.transformations) or (failed.is_stale and self._failures == 1)
        delay_s = doubling_s(self._failures + 1, self._policy.retry_s, self._policy.most_retry_s)
        self._intake.perturb(failed, self._clock.now(), delay_s=0.0 if is_other else delay_s)
