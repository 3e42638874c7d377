"""Planning with open pairs of tags: pairs that matter are decided, and no claim depends on the others.

An update is planned as if every open pair matched. If it uses none of them, it is the answer: no completion of the
relation has a better one. Otherwise the pairs that it uses, and more of the same demands, are decided, and the planner
is called again. If they can't be decided, the answer is the best plan of the decided relation, with the optimistic
one's cost as its bound.

More matches make plans cheaper, with two exceptions. A required transformation that can be used only then has to be
used, and a pinned unit that can be fed only then has to be kept. If that may be the case, a bound or a refusal is taken
from the problem that requires nothing and lets such units go.
"""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Final

from cfgplan.costs import keep_cost_us, start_cost_us
from cfgplan.domain import ALL, Environment, InputPort, Similarity
from cfgplan.planners.reducing.closure import relevant
from cfgplan.planning import REFUSED, Decider, Feature, OnProgress, Pair, Plan, Planner, Problem, Progress, Status
from cfgplan.reasons import Providers, startable

FIRST_BATCH: Final = 16
GROWTH: Final = 8
"""The pairs asked in the first round, and how many times more each next round asks.

A round costs seconds, a pair few milliseconds (experiments/matching/deciding.py).
"""
LEAST_S: Final = 0.01
"""A planner may look for a plan for at least so long, even if the time is over."""


class Deciding:
    """A planner of problems with open pairs, which asks a decider, if there is one, about those that matter.

    With `asks_early` off it asks only where the decided pairs alone give no plan. `is_stopped` ends the asking.
    """

    def __init__(
        self, planner: Planner, decider: Decider | None = None, is_stopped: Callable[[], bool] = lambda: False
    ) -> None:
        self.asks_early = True
        self._planner = planner
        self._decider = decider
        self._is_stopped = is_stopped
        self._refined: tuple[Similarity, Similarity, Similarity] | None = None

    def known(self, problem: Problem) -> Problem:
        """The problem with the pairs that were decided since."""
        was = problem.similarity
        if self._decider is None or not was.open or was is self._decider.similarity:
            return problem
        now = self._decider.similarity
        if self._refined is None or self._refined[0] is not was or self._refined[1] is not now:
            self._refined = was, now, was.refined(now)
        return replace(problem, similarity=self._refined[2])

    def __call__(
        self, problem: Problem, *, time_limit_s: float | None = None, report: OnProgress | None = None
    ) -> Plan:
        """The answer to `known(problem)`; see `planning.Planner`."""
        budget = _Budget(self._planner, time_limit_s)
        batch = FIRST_BATCH
        while True:
            problem = self.known(problem)
            if not problem.similarity.open:
                return self._counted(budget.plan(problem, 1.0, report), budget)
            decided = replace(problem, similarity=problem.similarity.decided)
            if compelling := _compelling_pairs(problem):
                if not self._is_stopped() and self._learns(problem, compelling, len(compelling)):
                    continue
                return self._counted(_without_a_claim(budget.plan(decided, 1.0), compelling), budget)
            best = budget.plan(_optimistic(problem), 0.5, _bounds_only(problem, report))
            uses, holds = _hangs_on(problem, best, budget)
            if holds and best.status is not Status.FEASIBLE:
                best = best if best.change_set is not None else replace(best, cost_us=None)  # known of hopes alone
                if report is not None:
                    report(Progress(budget.elapsed_s, best.cost_us, best.bound_us))
                return self._counted(best, budget)
            certain = None if self.asks_early else budget.plan(decided, 1.0)
            is_enough = certain is not None and certain.change_set is not None
            if not uses or is_enough or self._is_stopped() or not self._learns(problem, uses, batch):
                certain = certain or budget.plan(decided, 1.0)
                return self._counted(_answer(problem, best, uses, certain, budget), budget)
            batch *= GROWTH

    def _learns(self, problem: Problem, uses: tuple[Pair, ...], batch: int) -> bool:
        """Have some pairs decided. Returns whether any was."""
        if self._decider is None:
            return False
        before = self._decider.similarity
        try:
            self._decider.decide([*_most_wanted(problem, uses, batch)])
        except KeyboardInterrupt:  # the best plan so far is wanted now
            return False
        return self._decider.similarity is not before

    def _counted(self, plan: Plan, budget: _Budget) -> Plan:
        counts = {} if self._decider is None else self._decider.counts
        return replace(plan, seconds=dict(budget.seconds), counts={**plan.counts, **counts})


class _Budget:
    """A planner whose calls share one time limit."""

    def __init__(self, planner: Planner, limit_s: float | None) -> None:
        self._planner = planner
        self._limit_s = limit_s
        self.seconds: defaultdict[str, float] = defaultdict(float)
        self.elapsed_s = 0.0

    def plan(self, problem: Problem, share: float, report: OnProgress | None = None) -> Plan:
        """A plan, in a share of the time that is left."""
        start = time.monotonic()
        limit_s = None if self._limit_s is None else max(LEAST_S, share * self._limit_s)
        found = self._planner(problem, time_limit_s=limit_s, report=report)
        took_s = time.monotonic() - start
        self.elapsed_s += took_s
        if self._limit_s is not None:
            self._limit_s -= took_s
        for phase, seconds in found.seconds.items():
            self.seconds[phase] += seconds
        return found


def used_pairs(environment: Environment, similarity: Similarity) -> Iterator[Pair]:
    """The open pairs by which units subscribe and targets are met."""
    targets = {target.topic: target.tag for target in environment.stream_targets}
    tag_of = {
        (unit.id, port.name): port.tag
        for unit in environment.units
        if unit.transformation in environment.transformation
        for port in environment.transformation[unit.transformation].outputs
    }
    for unit in environment.units:
        kind = environment.transformation.get(unit.transformation)
        wanted = {} if kind is None else {name: port.tag for name, port in kind.input.items()}
        fed = [(tag_of.get((s.stream.unit, s.stream.port)), wanted.get(s.port)) for s in unit.subscriptions]
        published = [(tag_of.get((unit.id, p.port)), targets.get(p.topic)) for p in unit.publications]
        for offered, demanded in (*fed, *published):
            if offered is not None and demanded is not None and similarity.is_open(offered, demanded):
                yield offered, demanded


def _compelling_pairs(problem: Problem) -> tuple[Pair, ...]:
    """Return the open pairs that forbid plans if they match: at inputs that running units have to feed.

    An input that no plan can have adds none. If more than the cost is minimised, all pairs count: it is not known which
    other objectives improve with more matches.
    """
    if Feature.ORDER in problem.features:
        return tuple(problem.similarity.open_pairs())
    forbidding = [t for t in problem.environment.library if any(map(_takes_what_there_is, t.inputs))]
    used = _of_use(problem) if forbidding else frozenset()
    ports = [port for t in forbidding if t.label in used for port in t.inputs]
    tags = {port.tag for port in ports if _takes_what_there_is(port)}
    return tuple(pair for pair in problem.similarity.open_pairs() if pair[1] in tags) if tags else ()


def _takes_what_there_is(port: InputPort) -> bool:
    return port.count == ALL or port.starts_nothing


def _of_use(problem: Problem) -> frozenset[str]:
    """The transformations that a plan may use if all open pairs match."""
    environment = problem.environment
    providers = Providers(environment.library, problem.similarity.optimistic)
    possible = startable(environment, providers)
    return relevant(environment, providers, possible, iter)


def _without_a_claim(plan: Plan, undecided: tuple[Pair, ...]) -> Plan:
    """The plan without its proofs, which do not hold if the pairs match; it is unknown without a change set."""
    if plan.change_set is None:
        return replace(plan.unproven, status=Status.UNKNOWN, cost_us=None, reasons={}, undecided=undecided)
    return replace(plan.unproven, status=Status.FEASIBLE, undecided=undecided)


def _optimistic(problem: Problem) -> Problem:
    return replace(problem, similarity=problem.similarity.optimistic)


def _bounds_only(problem: Problem, report: OnProgress | None) -> OnProgress | None:
    """A reporter of bounds only, as an optimistic plan's cost may depend on open pairs; None if its bound may, too."""
    if report is None or not _is_monotone(problem):
        return None
    return lambda progress: report(replace(progress, cost_us=None))


def _hangs_on(problem: Problem, best: Plan, budget: _Budget) -> tuple[tuple[Pair, ...], bool]:
    """The open pairs that an optimistic answer depends on, and whether it holds however they are decided."""
    if best.change_set is None and best.status is Status.TOO_EXPENSIVE and not _is_monotone(problem):
        best = budget.plan(replace(_optimistic(problem), max_cost_us=None), 0.5)
        if best.status is not Status.OPTIMAL:
            return (), False
    if best.change_set is not None:
        after = problem.environment.update(best.change_set)
        pairs = {*used_pairs(after, problem.similarity)}
        if problem.survive is not None:  # units that survive a failure may be rewired
            pairs.update(_pairs_among(after, problem.similarity))
        return tuple(sorted(pairs)), not pairs
    if best.status is Status.INFEASIBLE and not problem.is_plain and not _is_monotone(problem):
        return tuple(problem.similarity.open_pairs()), False
    return (), best.status in REFUSED


def _pairs_among(environment: Environment, similarity: Similarity) -> Iterator[Pair]:
    """The open pairs between what units offer and what units and targets demand."""
    kinds = {unit.transformation for unit in environment.units} & environment.transformation.keys()
    offered = {port.tag for label in kinds for port in environment.transformation[label].outputs}
    demanded = {port.tag for label in kinds for port in environment.transformation[label].inputs}
    demanded.update(target.tag for target in environment.stream_targets)
    return ((o, d) for d in demanded for o in offered & similarity.open.get(d, frozenset()) if similarity.is_open(o, d))


def _most_wanted(problem: Problem, uses: tuple[Pair, ...], batch: int) -> Iterator[Pair]:
    """The pairs used, then others of the same demands, those first that are offered most cheaply."""
    yield from uses
    environment, similarity = problem.environment, problem.similarity
    dear_us = _cost_us(problem, startable(environment, Providers(environment.library, similarity.optimistic)))
    others = {
        (offered, demanded)
        for demanded in {demanded for _, demanded in uses}
        for offered in similarity.open[demanded] & dear_us.keys()
        if similarity.is_open(offered, demanded)
    }
    wanted = sorted(others.difference(uses), key=lambda pair: (dear_us[pair[0]], pair))
    yield from wanted[: max(0, batch - len(uses))]


def _cost_us(problem: Problem, possible: Iterable[str]) -> Mapping[str, int]:
    """For each tag the cost of the cheapest transformation that offers it, by itself."""
    environment = problem.environment
    running = {unit.transformation for unit in environment.units}
    dear_us: dict[str, int] = {}
    for label in possible:
        kind = environment.transformation[label]
        cost_us = (keep_cost_us if label in running else start_cost_us)(kind, problem.horizon_s)
        for port in kind.outputs:
            dear_us[port.tag] = min(cost_us, dear_us.get(port.tag, cost_us))
    return dear_us


def _answer(problem: Problem, best: Plan, uses: tuple[Pair, ...], certain: Plan, budget: _Budget) -> Plan:
    """The best plan of the decided relation, with the bound that holds however the open pairs are decided."""
    if best.change_set is not None and not uses and (certain.change_set is None or best.rank < certain.rank):
        certain = best  # it was only stopped by the clock
    is_comparable = _is_monotone(problem) or (
        not _doubtful(problem)
        and best.status is Status.OPTIMAL
        and certain.change_set is not None
        and len(best.unused_required) == len(certain.unused_required)
    )
    relaxed = best if is_comparable else budget.plan(_relaxed(problem), 1.0)
    if relaxed.status in REFUSED:
        return replace(relaxed, cost_us=None)
    if certain.change_set is None:
        reasons = certain.reasons if certain.status is Status.UNKNOWN else {}
        return Plan(certain.planner, Status.UNKNOWN, None, None, relaxed.bound_us, reasons, undecided=uses)
    assert certain.cost_us is not None
    is_optimal = is_comparable and relaxed.bound_us == certain.cost_us
    is_as_good = best.change_set is not None and best.rank == certain.rank
    return replace(
        certain,
        status=Status.OPTIMAL if is_optimal else Status.FEASIBLE,
        bound_us=relaxed.bound_us,
        ties_proven=is_optimal and is_as_good and best.ties_proven,
        required_proven=best.required_proven and len(best.unused_required) == len(certain.unused_required),
        undecided=() if is_optimal else uses,
    )


def _is_monotone(problem: Problem) -> bool:
    """Return whether further matches never make a plan more expensive."""
    return not problem.environment.required and not _doubtful(problem)


def _doubtful(problem: Problem) -> frozenset[str]:
    """The pinned transformations with running units that can be fed only if open pairs match."""
    environment, similarity = problem.environment, problem.similarity
    running = {unit.transformation for unit in environment.units}
    pinned = frozenset(t.label for t in environment.library if t.pinned and t.label in running)
    if not pinned:
        return pinned
    pessimistic, optimistic = (
        startable(environment, Providers(environment.library, each))
        for each in (similarity.decided, similarity.optimistic)
    )
    return pinned & optimistic - pessimistic


def _relaxed(problem: Problem) -> Problem:
    """The optimistic problem without requirements and doubtful pins: its optimum bounds every valid update."""
    doubtful, environment = _doubtful(problem), problem.environment
    library = tuple(
        replace(t, required=False, pinned=t.pinned and t.label not in doubtful) for t in environment.library
    )
    return replace(_optimistic(problem), environment=replace(environment, library=library))
