"""The planner as a session: results of one plan speed up the next.

A manager keeps one session and calls it again after every change: a unit died, a transformation joined, a cost moved, a
target came. Unchanged parts are not recomputed: the closure and the network of the library, the landmarks, and the last
plan as a first one. The answer is as good as that of a new session.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from numbers import Real
from threading import Event
from typing import Final

from cfgplan.arguments import unsuitable
from cfgplan.domain import Environment
from cfgplan.planners.exact.candidates import ONLY_IN_THE_MODEL, Candidates
from cfgplan.planners.exact.configuration import wire
from cfgplan.planners.exact.memory import Memory
from cfgplan.planners.exact.pruning import lean
from cfgplan.planners.exact.solve_run import SolveRun
from cfgplan.planners.exact.solve_state import SolveState
from cfgplan.planners.exact.stages import STAGES
from cfgplan.planners.reducing.closure import Closure, asked_for
from cfgplan.planners.reducing.reduce import Reduced, reduce
from cfgplan.planners.solving.clock import Clock, ContradictionError, OutOfTimeError
from cfgplan.planners.tuning import USUAL, Tuning
from cfgplan.planners.undecided import Deciding
from cfgplan.planning import Feature, OnProgress, Plan, Problem, Status
from cfgplan.reasons import Providers, startable

SOLVED_AT_ONCE: Final = ONLY_IN_THE_MODEL | {Feature.ORDER, Feature.LATENCY}
"""A problem with one of these goes to the solver without bounds and first plans."""
ROOM_SHARE: Final = 0.5
"""The share of the time in which a plan is looked for as if one host had room for all."""


class PlannerSession:
    """A planner that remembers; `plan` is a `planning.Planner` with a way to stop it.

    It prepares for the next call after a plan that changes nothing, unless it `is_asked_once`.
    """

    def __init__(self, tuning: Tuning = USUAL, *, is_asked_once: bool = False) -> None:
        self._tuning = tuning
        self._is_asked_once = is_asked_once
        self._memory: Memory | None = None

    def plan(
        self,
        problem: Problem,
        *,
        time_limit_s: float | None = None,
        report: OnProgress | None = None,
        stop: Event | None = None,
    ) -> Plan:
        """Return the optimal update. Stopped by the clock, by `stop` or by Ctrl-C it is the best one so far.

        Ctrl-C sets `stop`; a second one raises KeyboardInterrupt. If the time limit leaves no plan, a first one is
        looked for, as long as `Clock.for_a_first_plan` lasts.
        """
        if not isinstance(problem, Problem):
            raise unsuitable("plan()", "problem", "a Problem", problem)
        if not (time_limit_s is None or (isinstance(time_limit_s, Real) and time_limit_s >= 0)):
            raise unsuitable("plan()", "time_limit_s", "a number of 0 or more or None", time_limit_s)
        if problem.similarity.open:
            return Deciding(partial(self.plan, stop=stop))(problem, time_limit_s=time_limit_s, report=report)
        clock = Clock(time_limit_s, stop, self._tuning)
        part = _reduced(problem, clock)
        if not part.is_roomy and time_limit_s is not None:
            clock = clock.with_limit(time_limit_s * ROOM_SHARE, self._tuning)
        state = SolveState(part.problem, clock, part.reporting(report), problem)
        answer = self._planned(part, state)
        if answer is None or (state.are_ties_proven and not answer.ties_proven):
            answer = self._planned_again(part, state, answer, time_limit_s, report)
        if answer.status is Status.UNKNOWN and time_limit_s is not None and not clock.stop.is_set():
            return self._planned_first(problem, clock.for_a_first_plan(problem), report) or answer
        return answer

    def _planned(self, part: Reduced, state: SolveState) -> Plan | None:
        """The answer to the whole problem by a plan of the part; None if it gives none."""
        clock, problem = state.clock, part.problem
        _choose_stages(state)
        clock.run(lambda: self._plan(state), lambda: _so_far(part, state))
        clock.end("search")
        found, memory = state.plan(), self._memory
        answer = part.answer(found)
        if memory is not None:
            memory.keep_plan(state)
            is_unchanged = (
                not self._is_asked_once and problem.is_plain and found.status is Status.OPTIMAL and not found.change_set
            )
            if is_unchanged and not memory.structure.has_required and not clock.is_over():
                clock.run(lambda: memory.settle(problem, clock), lambda: _so_far(part, state))
        return answer

    def _plan(self, state: SolveState) -> None:
        """Go through the stages; if one fails, leave the whole library to the solver, with a boolean for each wire."""
        try:
            self._go_through_stages(state)
        except ContradictionError as error:
            state.begin_again(str(error))
            from cfgplan.planners.exact.fleet import solve_by_full_model

            solve_by_full_model(Candidates(state.problem, clock=state.clock), state)

    def _go_through_stages(self, state: SolveState) -> None:
        if not self._tuning.is_solver_only:
            offer_running_units(state)
        self._memory = Memory.of(state.problem, self._memory, state.clock)
        state.clock.end("closure")
        work = SolveRun(state, self._memory)
        for stage in state.clock.each(STAGES, 1):
            if stage(work):
                break

    def _planned_again(
        self,
        before: Reduced,
        known: SolveState,
        answer: Plan | None,
        time_limit_s: float | None,
        report: OnProgress | None,
    ) -> Plan:
        """Plan a whole problem after a part of it gave no answer, or an answer with unproven ties."""
        problem = before.whole
        clock = known.clock.with_limit(time_limit_s, self._tuning)
        part = _reduced(problem, clock, is_certain=True)
        state = SolveState(part.problem, clock, part.reporting(report), problem)
        is_about_cost = not problem.environment.required and Feature.ORDER not in problem.features
        if is_about_cost:
            state.bound_us = known.bound_us + before.rent_us - part.rent_us
        if answer is not None and answer.change_set is not None:
            units = part.part_of(problem.after(answer).units)
            state.offer(Candidates(part.problem, among={unit.transformation for unit in units}), units)
        if is_about_cost and state.is_at_bound:
            state.prove_cost()
        found = PlannerSession(self._tuning, is_asked_once=True)._planned(part, state)
        assert found is not None
        return found

    def _planned_first(self, problem: Problem, clock: Clock, report: OnProgress | None) -> Plan | None:
        """A first plan of a problem, with the bound that is proven by then.

        Required transformations come before the largest cost: None if a plan within it leaves some unused.
        """
        part = _reduced(problem, clock, is_certain=True)
        found = self._planned(part, SolveState(part.problem, clock, part.reporting(report), problem))
        assert found is not None
        is_too_cheap = found.unused_required and not found.required_proven and problem.max_cost_us is not None
        return None if is_too_cheap else found


def _reduced(problem: Problem, clock: Clock, *, is_certain: bool = False) -> Reduced:
    """The reduced problem; the whole problem if the time ends before it is known."""
    if not clock.tuning.reduces:
        return Reduced(problem, problem)
    try:
        return reduce(problem, clock, is_certain=is_certain)
    except OutOfTimeError:
        pass
    except KeyboardInterrupt:  # the best plan so far is wanted now
        clock.interrupt()
    return Reduced(problem, problem)


def _choose_stages(state: SolveState) -> None:
    clock = state.clock
    is_solver_only = clock.tuning.is_solver_only or bool(SOLVED_AT_ONCE & state.problem.features)
    clock.tuning = replace(clock.tuning, is_solver_only=is_solver_only)


def _so_far(part: Reduced, state: SolveState) -> Plan:
    found = state.plan()
    return part.answer(found) or Plan(found.planner, Status.UNKNOWN)


def plan(
    problem: Problem,
    *,
    time_limit_s: float | None = None,
    report: OnProgress | None = None,
    stop: Event | None = None,
) -> Plan:
    """The optimal update, see `planning.Planner`; `stop` ends it early with the best plan so far, as Ctrl-C does."""
    return PlannerSession(is_asked_once=True).plan(problem, time_limit_s=time_limit_s, report=report, stop=stop)


def offer_running_units(state: SolveState) -> None:
    """Offer the running units without needless ones, first wired as they are, then rewired where they must be.

    It ignores the clock, so that any time limit gives a plan. With features that first plans don't know, nothing is
    rewired.
    """
    problem, environment = state.problem, state.problem.environment
    labels = {unit.transformation for unit in environment.units}
    library = tuple(t for t in environment.library if t.label in labels)
    providers = Providers(library, problem.similarity)
    possible = startable(Environment((), library), providers)
    if not possible.issuperset(t.label for t in library if t.pinned) or any(
        possible.isdisjoint(providers.of(target.tag)) for target in environment.targets
    ):
        return
    candidates = Candidates(problem, Closure(providers, possible, possible, asked_for(environment) & possible))
    units = [c.running for c in candidates.all if c.running is not None]
    state.offer(candidates, units if problem.is_plain else lean(candidates, units))
    if ONLY_IN_THE_MODEL & problem.features:
        return
    rewired = wire(candidates, [i for i, c in enumerate(candidates.all) if c.running is not None and c.may_run])
    if rewired is not None and not problem.is_plain:
        cold = [unit for unit in units if unit.standby]
        rewired = lean(candidates, [*rewired, *cold])
    if rewired is not None:
        state.offer(candidates, rewired)
