"""The planner as a session: what one plan has found out about a problem helps with the next.

A manager keeps one session and asks it again after every change: a unit died, a transformation joined,
a cost moved, a target came. What did not change is not computed anew: the closure and the network of
the library, the landmarks, and the last plan as a first one. The answer is as good as a cold one.
"""

from __future__ import annotations

from collections.abc import Callable
from threading import Event

import numpy as np

from cfgplan.planners.cpsat.bounds import Bound
from cfgplan.planners.cpsat.chains import chained_bound
from cfgplan.planners.cpsat.clock import Clock, OutOfTimeError
from cfgplan.planners.cpsat.greedy import first_plan, improved, is_plan, with_less
from cfgplan.planners.cpsat.grounding import Grounding
from cfgplan.planners.cpsat.network import Ints, costs
from cfgplan.planners.cpsat.prepared import Prepared
from cfgplan.planners.cpsat.rest import Left, Rest
from cfgplan.planners.cpsat.site import Site
from cfgplan.planners.cpsat.standing import Stage, Standing
from cfgplan.planners.cpsat.structure import Structure
from cfgplan.planners.cpsat.tightening import begun, tightened
from cfgplan.planners.cpsat.weighing import Weighing
from cfgplan.planning import Plan, Problem, Progress, Status
from cfgplan.reasons import unmet_reasons

ATTEMPTS = 30
"""How many members of the first plan are tried to be done without."""


class PlannerSession:
    """A planner that remembers; `plan` is a `planning.Planner` with a way to stop it."""

    def __init__(self, grounding: Grounding = Grounding.CUTS) -> None:
        self._grounding = grounding
        self._structure: Structure | None = None
        self._last: frozenset[str] = frozenset()
        self._rest: Rest | None = None

    def plan(
        self,
        problem: Problem,
        *,
        time_limit_s: float | None = None,
        report: Callable[[Progress], None] | None = None,
        stop: Event | None = None,
    ) -> Plan:
        """The optimal update. Stopped by the clock, by `stop` or by Ctrl-C it is the best one so far."""
        if problem.notions:
            from cfgplan.planners import fleet

            return fleet.plan(problem, time_limit_s=time_limit_s, report=report, stop=stop)
        clock = Clock(time_limit_s, stop)
        if self._structure is None or not self._structure.serves(problem):
            try:
                self._structure = Structure.of(problem, self._structure, clock)
            except OutOfTimeError:
                return Plan("cpsat", Status.UNKNOWN, seconds=clock.end("closure"))
            self._rest = None
        structure = self._structure
        if not structure.meets_targets:
            reasons = unmet_reasons(problem, structure.givers, structure.possible)
            return Plan("cpsat", Status.INFEASIBLE, reasons=reasons, seconds=clock.end("closure"))
        clock.end("closure")
        standing: Standing | None = None
        try:
            if structure.has_required:
                standing = self._with_required(problem, structure, clock, report)
            else:
                prepared = self._prepare(problem, structure, clock)
                clock.end("bounds")
                standing = Standing(Site(problem, structure.givers, prepared.labels), prepared, clock, report)
                if standing.stage is not Stage.DONE and not clock.is_over():
                    from cfgplan.planners.cpsat.search import Search  # the solver takes long to import

                    Search(standing, prepared, self._grounding).run()
        except KeyboardInterrupt:
            clock.stop.set()
        clock.end("search")
        if standing is None:
            return Plan("cpsat", Status.UNKNOWN, seconds=clock.seconds)
        if standing.best is not None:
            self._last = frozenset(unit.transformation for unit in standing.best.units)
        found = standing.plan()
        if found.status is Status.OPTIMAL and not found.change_set and not structure.has_required:
            self._settle(problem, structure, clock)
        return found

    def _prepare(self, problem: Problem, structure: Structure, clock: Clock) -> Prepared:
        """Bounds on the cost from both sides, and what may still be used between them."""
        network = structure.network
        counts = {
            "transformations": len(problem.environment.library),
            "startable": len(structure.possible),
            "relevant": len(network.labels),
            "demands": len(network.fact_of_tag),
            "merged demands": len(network.core.givers),
        }
        weighing = Weighing.of(problem, network, structure.pinned)
        quick = weighing.least(chained_bound(network.core, weighing.weight)) if weighing.counts_starts else 0
        plan, bound = self._first_plan(problem, structure, weighing, quick, clock)
        if plan is not None and weighing.counts_starts and weighing.of_plan(plan) == quick:
            left = Left(plan, quick, [])
        else:
            left = self._left(structure, weighing, plan, bound, clock)
        value = weighing.least(max(left.value, quick))
        labels = left.labels
        if plan is not None and value < weighing.of_plan(plan) and clock.is_over():
            labels = plan
        counts |= {"landmarks": len(left.landmarks), "left by bounds": len(labels)}
        is_left = np.zeros(len(network.labels), np.bool_)
        is_left[labels] = True
        return Prepared(
            [network.labels[i] for i in labels.tolist()],
            None if plan is None else [network.labels[i] for i in plan.tolist()],
            None if plan is None else weighing.cost_us(weighing.of_plan(plan)),
            weighing.cost_us(value),
            [[network.labels[i] for i in members[is_left[members]].tolist()] for members in left.landmarks],
            counts,
            fewest_started=weighing.started(value),
        )

    def _left(
        self, structure: Structure, weighing: Weighing, plan: Ints | None, bound: Bound | None, clock: Clock
    ) -> Left:
        """What landmarks leave of the network, from where they stood at rest if that is near."""
        cost = weighing.weight
        if plan is not None and self._rest is not None and not weighing.counts_starts:
            left = self._rest.left(cost, plan, clock)
            if left is not None:
                return left
        limit = int(cost.sum()) if plan is None else weighing.of_plan(plan)
        bound = tightened(bound or _known_bound(structure, weighing), limit - weighing.step + 1, limit, clock)
        structure.remember(bound, weighing.scale)
        return Left.by(bound, limit)

    def _with_required(
        self, problem: Problem, structure: Structure, clock: Clock, report: Callable[[Progress], None] | None
    ) -> Standing:
        """Try to use all required transformations; only if that is impossible, see how many can be used."""
        from cfgplan.planners.cpsat.required import any_plan, prepared_with_all
        from cfgplan.planners.cpsat.search import Search

        prepared, first = prepared_with_all(problem, structure, self._grounding, ATTEMPTS, clock)
        clock.end("bounds")
        standing = Standing(Site(problem, structure.givers, prepared.labels), prepared, clock, report)
        standing.best = first or any_plan(problem, structure, clock)
        if Search(standing, prepared, self._grounding).run_with_all_required():
            return standing
        prepared = Prepared(structure.network.labels)
        standing = Standing(Site(problem, structure.givers, prepared.labels), prepared, clock, report)
        Search(standing, prepared, self._grounding).run()
        return standing

    def _first_plan(
        self, problem: Problem, structure: Structure, weighing: Weighing, quick: int, clock: Clock
    ) -> tuple[Ints | None, Bound | None]:
        """The plan at rest or the last one, mended where units died; or a new one if that no longer is one.

        A new one is better than the cheapest support only if `quick`, a bound, does not say that there is none, nor
        the first landmarks, which are returned.
        """
        network, cost = structure.network, weighing.weight
        known = set(network.pinned)
        if self._rest is not None and self._rest.is_below(cost):
            known |= set(self._rest.plan.tolist())
        else:
            known |= {network.number[label] for label in self._last if label in network.number}
        plan: set[int] | None
        bound = None
        if is_plan(network, known):
            running = {unit.transformation for unit in problem.environment.units}
            plan = improved(network, cost, known, {i for i in known if network.labels[i] not in running})
        else:
            plan = first_plan(network, cost, 0, clock.is_over)
            limit = 0 if plan is None else int(cost[list(plan)].sum())
            if plan is not None and limit > quick:
                bound = begun(_known_bound(structure, weighing), limit - weighing.step + 1, limit, clock)
                if bound.value <= limit - weighing.step:
                    numbers = bound.core.labels.tolist()
                    without = {numbers[label]: value for label, value in bound.without().items()}
                    plan = with_less(network, cost, plan, ATTEMPTS, clock.is_over, without)
        return None if plan is None else np.array(sorted(plan), np.int64), bound

    def _settle(self, problem: Problem, structure: Structure, clock: Clock) -> None:
        """Where a proven plan changes nothing, there is time to see what will be needed when something does."""
        network = structure.network
        _, cost = costs(problem, network, structure.pinned)
        plan = np.array(sorted({network.number[label] for label in self._last} | set(network.pinned)), np.int64)
        if self._rest is not None and np.array_equal(self._rest.cost, cost) and np.array_equal(self._rest.plan, plan):
            return
        library = problem.environment.transformation
        dearest = max((library[network.labels[i]].labor_us for i in plan.tolist()), default=0)
        landmarks, weights = structure.landmarks()
        bound = Bound(network.core, cost, landmarks)
        bound.recharge(weights)
        self._rest = Rest.of(plan, cost, int(cost[plan].sum()) + dearest, bound, clock)


def _known_bound(structure: Structure, weighing: Weighing) -> Bound:
    """The bound by the landmarks that are remembered."""
    landmarks, weights = structure.landmarks()
    bound = Bound(structure.network.core, weighing.weight, landmarks)
    bound.recharge([weight * weighing.scale for weight in weights])
    return bound
