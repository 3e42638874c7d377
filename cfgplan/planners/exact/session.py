"""The planner as a session: what one plan has found out about a problem helps with the next.

A manager keeps one session and asks it again after every change: a unit died, a transformation joined,
a cost moved, a target came. What did not change is not computed anew: the closure and the network of
the library, the landmarks, and the last plan as a first one. The answer is as good as a cold one.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from functools import partial
from threading import Event
from typing import TYPE_CHECKING

import numpy as np

from cfgplan.domain import Similarity
from cfgplan.planners.bounding.bounds import Bound, tightened
from cfgplan.planners.exact.candidates import Candidates
from cfgplan.planners.exact.deciding import decide
from cfgplan.planners.exact.prepared import Prepared
from cfgplan.planners.exact.preparing import Preparation
from cfgplan.planners.exact.required import offer, offer_any_plan, prepared_with_all
from cfgplan.planners.exact.rest import Rest
from cfgplan.planners.exact.standing import Standing
from cfgplan.planners.exact.structure import Structure
from cfgplan.planners.exact.wiring import what_runs
from cfgplan.planners.networks.core import Ints
from cfgplan.planners.networks.greedy import cost_of, first_plan, improved, is_plan, with_less
from cfgplan.planners.networks.network import Network, Weighing, costs
from cfgplan.planners.solving.clock import Clock
from cfgplan.planners.tuning import USUAL, Tuning
from cfgplan.planners.undecided import Deciding
from cfgplan.planning import Plan, Problem, Progress, Status
from cfgplan.reasons import unmet_reasons

if TYPE_CHECKING:
    from cfgplan.planners.exact.search import Landmarks, Search


class _Course:
    """What the stages of one plan hand on to each other."""

    structure: Structure
    preparation: Preparation
    prepared: Prepared
    candidates: Candidates

    def __init__(self, standing: Standing) -> None:
        self.standing = standing
        self.problem, self.clock = standing.problem, standing.clock
        self.is_new = True
        """Whether nothing is known of this structure yet."""
        self.has_ended = False
        self.is_fleet = not self.problem.is_plain or self.clock.tuning.is_solver_only

    def take(self, prepared: Prepared) -> None:
        """Go on with what preprocessing found, and bring the standing forward by it."""
        self.prepared, self.candidates = prepared, self.structure.candidates(self.problem, prepared.labels)
        prepared.tell(self.standing, self.candidates)

    def decides(self, among: Collection[str] | None = None) -> bool:
        """Search without the solver. True if that proves the cost; the solver has then broken ties if it had to."""
        candidates = decide(self.standing, self.structure, among)
        self.clock.end("bounds")
        if candidates is not None and not self.standing.is_over:
            _search(candidates, self.standing).run()
            self.clock.end("search")
        self.has_ended = candidates is not None
        return self.has_ended


class PlannerSession:
    """A planner that remembers; `plan` is a `planning.Planner` with a way to stop it."""

    def __init__(self, tuning: Tuning = USUAL) -> None:
        self._tuning = tuning
        self._structure: Structure | None = None
        self._last: frozenset[str] = frozenset()
        self._rest: Rest | None = None
        self._aside: tuple[Structure, frozenset[str], Rest | None] | None = None
        """What is remembered of another matching: where pairs are open, none and all of them match by turns."""

    def plan(
        self,
        problem: Problem,
        *,
        time_limit_s: float | None = None,
        report: Callable[[Progress], None] | None = None,
        stop: Event | None = None,
    ) -> Plan:
        """The optimal update. Stopped by the clock, by `stop` or by Ctrl-C it is the best one so far."""
        if problem.similarity.open:
            return Deciding(partial(self.plan, stop=stop))(problem, time_limit_s=time_limit_s, report=report)
        clock = Clock(time_limit_s, stop, self._tuning)
        standing = Standing(problem, clock, report)
        clock.run(lambda: self._bring_forward(standing), standing.plan)
        clock.end("search")
        self._remember(standing)
        found, structure = standing.plan(), self._structure
        is_at_rest = problem.is_plain and found.status is Status.OPTIMAL and not found.change_set
        if is_at_rest and structure is not None and not structure.has_required and not clock.is_over():
            clock.run(lambda: self._settle(problem, structure, clock), lambda: found)
        return found

    def _bring_forward(self, standing: Standing) -> None:
        """Go through the stages of a plan until nothing is left to be proven."""
        course = _Course(standing)
        self._offer_what_runs(course)
        stages = (
            self._close,
            self._plan_fleet,
            self._use_all_required,
            self._decide_all,
            self._raise_bound,
            self._decide_what_is_left,
            self._close_gap,
            self._solve,
        )
        for stage in standing.clock.each(stages, 1):
            if not course.has_ended:
                stage(course)

    def _offer_what_runs(self, course: _Course) -> None:
        if course.is_fleet:
            from cfgplan.planners.exact.running import offer_what_runs

            offer_what_runs(course.standing)
        elif (units := what_runs(course.problem)) is not None:
            course.standing.offer(units)

    def _close(self, course: _Course) -> None:
        """The closure of the library, and its network; known already where nothing but costs and units changed."""
        problem, standing = course.problem, course.standing
        self._turn_to(problem.similarity)
        if self._structure is None or not self._structure.serves(problem):
            self._structure = Structure.of(problem, self._structure, course.clock)
            self._rest = None
        structure = course.structure = self._structure
        course.clock.end("closure")
        if structure.meets_targets:
            standing.counts = structure.counts()
            standing.fewest_unused = structure.hopeless_required
        else:
            standing.is_infeasible, standing.reasons = True, unmet_reasons(problem, possible=structure.closure.possible)
            course.has_ended = True

    def _turn_to(self, similarity: Similarity) -> None:
        """Turn to what is remembered of this matching, and set aside what is known of the last one."""
        structure, aside = self._structure, self._aside
        if structure is None or structure.similarity == similarity:
            return
        self._aside = structure, self._last, self._rest
        if aside is not None and aside[0].similarity == similarity:
            self._structure, self._last, self._rest = aside

    def _plan_fleet(self, course: _Course) -> None:
        """Plan what asks for more than the paper in stages of its own."""
        if course.is_fleet:
            from cfgplan.planners.exact.fleet import plan_fleet

            course.has_ended = True
            candidates = Candidates(course.problem, course.structure.closure, clock=course.clock)
            plan_fleet(candidates, course.standing, self._last)

    def _use_all_required(self, course: _Course) -> None:
        """Try to use all required transformations; only if that is impossible, see how many can be used."""
        standing, structure = course.standing, course.structure
        if not structure.has_required:
            return
        course.has_ended = True
        offer_any_plan(standing, structure)
        every = Prepared(structure.network.labels)
        for prepared in course.clock.each((prepared_with_all(standing, structure), every), 1):
            course.clock.end("bounds")
            course.take(prepared)
            search = _search(course.candidates, standing, prepared.landmarks())
            if prepared.holds_for is None:
                search.run()
            elif search.run_with_all_required():
                return

    def _decide_all(self, course: _Course) -> None:
        """Search a structure of which nothing is known yet."""
        course.is_new = not course.structure.has_landmarks
        if course.is_new and not course.decides():
            course.has_ended = course.clock.is_over() and course.standing.best is not None

    def _raise_bound(self, course: _Course) -> None:
        """Find a plan and a bound, and leave out labels by reduced costs."""
        standing, is_first = course.standing, not self._last
        self._remember(standing)
        course.preparation = self._prepare(standing, course.structure, is_first=is_first)
        course.take(course.preparation.prepared(course.clock))

    def _decide_what_is_left(self, course: _Course) -> None:
        prepared = course.prepared
        is_less = 2 * len(prepared.labels) <= len(course.structure.network.labels)
        if (is_less or not course.is_new) and not course.standing.is_over and not course.decides(prepared.labels):
            course.take(prepared)
        course.clock.end("bounds")

    def _close_gap(self, course: _Course) -> None:
        """Bring bound and plan closer."""
        if course.preparation.may_go_on and not course.standing.is_over:
            course.preparation.go_on(course.clock)
            course.take(course.preparation.prepared(course.clock))
            course.clock.end("bounds")

    def _solve(self, course: _Course) -> None:
        """Leave to the solver what is still open."""
        if not course.standing.is_over:
            landmarks = course.prepared.landmarks()
            _search(course.candidates, course.standing, landmarks, course.preparation.missed).run()
            course.clock.end("search")

    def _remember(self, standing: Standing) -> None:
        if standing.best is not None:
            self._last = frozenset(unit.transformation for unit in standing.best.units if not unit.standby)

    def _prepare(self, standing: Standing, structure: Structure, *, is_first: bool) -> Preparation:
        """A plan and a bound, and the labels that reduced costs leave between them.

        The plan is that at rest or the last one, mended where units died. It is a new one if that no longer is a plan,
        or in a session's first call, where the last plan is what runs; then ways to do without members are tried too.
        """
        problem, clock, network = standing.problem, standing.clock, structure.network
        weighing = Weighing.of(problem, network, structure.pinned)
        plan = self._mended(problem, network, weighing.weight, clock)
        is_new = plan is None or is_first
        if is_new:
            found = (plan, first_plan(network, weighing.weight, 0, clock))
            plan = min((one for one in found if one is not None), key=partial(cost_of, weighing.weight), default=None)
        if plan is not None and standing.best is None:
            offer(plan, standing, structure)
        if is_new and plan is not None:
            plan = with_less(network, weighing.weight, plan, clock.tuning.begin.attempts, clock)
        labels = None if plan is None else np.array(sorted(plan), np.int64)
        left = None
        if labels is not None and self._rest is not None and not weighing.counts_starts:
            left = self._rest.left(weighing.weight, weighing.step, labels, clock)
        preparation = Preparation(structure, weighing, labels, left, clock.tuning.close)
        if left is None:
            preparation.begin(_known_bound(structure, weighing.weight, weighing.scale), clock)
        return preparation

    def _mended(self, problem: Problem, network: Network, cost: Ints, clock: Clock) -> set[int] | None:
        """The plan at rest or the last one, less what is not worth it any more; None if it no longer is a plan."""
        known = set(network.pinned)
        if self._rest is not None:
            known |= set(self._rest.plan.tolist())
        else:
            known |= {network.number[label] for label in self._last if label in network.number}
        if not is_plan(network, known):
            return None
        running = {unit.transformation for unit in problem.environment.units}
        return improved(network, cost, known, {i for i in known if network.labels[i] not in running}, clock)

    def _settle(self, problem: Problem, structure: Structure, clock: Clock) -> None:
        """After a proven plan that changes nothing, prepare for the next one: remember its `Rest`."""
        network = structure.network
        _, cost = costs(problem, network, structure.pinned)
        plan = np.array(sorted({network.number[label] for label in self._last} | set(network.pinned)), np.int64)
        if self._rest is not None and np.array_equal(self._rest.cost, cost) and np.array_equal(self._rest.plan, plan):
            return
        library = problem.environment.transformation
        dearest = max((library[network.labels[i]].labor_us for i in plan.tolist()), default=0)
        limit = int(cost[plan].sum()) + dearest
        self._rest = self._rest and self._rest.moved(plan, cost, limit, clock)
        if self._rest is None:
            value = int(cost[plan].sum())
            close = tightened(_known_bound(structure, cost), value, value, clock)
            structure.remember(lambda: close, 1)
            bound = _known_bound(structure, cost)
            self._rest = Rest.of(plan, cost, int(clock.tuning.rest.room * limit), bound, clock)


def _search(
    candidates: Candidates,
    standing: Standing,
    landmarks: Landmarks = (),
    missed: Callable[[Collection[str], Clock], Landmarks] = lambda *_: (),
) -> Search:
    """A search in the constraint model, which is built here; raises OutOfTimeError."""
    from cfgplan.planners.exact.search import Search  # the solver takes long to import

    candidates.clock = standing.clock
    return Search(candidates, standing, landmarks=landmarks, missed=missed)


def _known_bound(structure: Structure, weight: Ints, scale: int = 1) -> Bound:
    """The bound by the landmarks that are remembered."""
    landmarks, weights = structure.landmarks()
    bound = Bound(structure.network.core, weight, landmarks)
    bound.recharge([weight * scale for weight in weights])
    return bound


def plan(
    problem: Problem,
    *,
    time_limit_s: float | None = None,
    report: Callable[[Progress], None] | None = None,
    stop: Event | None = None,
) -> Plan:
    """The optimal update, see `planning.Planner`; `stop` ends it early with the best plan so far, as Ctrl-C does."""
    return PlannerSession().plan(problem, time_limit_s=time_limit_s, report=report, stop=stop)
