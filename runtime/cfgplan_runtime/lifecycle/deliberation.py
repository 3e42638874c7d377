"""The thinking half of a review: match, estimate, plan, judge. It changes nothing that runs."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from operator import is_

from cfgplan import validity
from cfgplan.api import World
from cfgplan.costs import keep_cost_us
from cfgplan.domain import ChangeSet, Environment, Similarity, Transformation
from cfgplan.errors import CfgplanError
from cfgplan.explaining.best_effort import BestEffort, best_effort
from cfgplan.planners.undecided import Deciding
from cfgplan.planning import Decider, Pair, Planner, Problem, Status
from cfgplan.reasons import unmet_reasons
from cfgplan.validity import Rule
from cfgplan_runtime.lifecycle.configuration import EstimatedLibrary, Situation, avoided_now, environment_to_plan
from cfgplan_runtime.lifecycle.reports import Decision
from cfgplan_runtime.lifecycle.seams import Estimator


@dataclass
class Thought:
    """What a review has found out so far. `change_set` is over units only."""

    running: Environment
    planned: Environment
    cost_before_us: int
    avoided: Mapping[str, str]
    decision: Decision = Decision.UNDECIDED
    cause: str = ""
    change_set: ChangeSet | None = None
    cost_us: int | None = None
    bound_us: int = 0
    is_proven: bool = False
    undecided: tuple[Pair, ...] = ()
    met: tuple[str, ...] = ()
    unmet: Mapping[str, str] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def timed(self, phase: str) -> Iterator[None]:
        """Count the wall time of a phase."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[phase] = self.seconds.get(phase, 0.0) + time.perf_counter() - start


@dataclass(frozen=True)
class Reach:
    """Which targets of a problem nothing can meet, and why, whatever runs."""

    problem: Problem
    unmet_reasons: Mapping[str, str]

    def holds_for(self, problem: Problem) -> bool:
        """Whether another problem has the same library, matching and targets (and costs: they change rarely)."""
        known, environment = self.problem.environment, problem.environment
        return (
            problem.similarity is self.problem.similarity
            and environment.targets == known.targets
            and len(environment.library) == len(known.library)
            and all(map(is_, environment.library, known.library))
        )


class Deliberation:
    """Plans updates, one after the other, with a planner that may remember.

    The decider is asked about open pairs of tags that matter: where a review optimises, and where there is no plan
    else, unless `is_stopped`.
    """

    def __init__(
        self,
        planner: Planner,
        estimator: Estimator,
        time_limit_s: float | None,
        decider: Decider,
        is_stopped: Callable[[], bool],
    ) -> None:
        self._planner = Deciding(planner, decider, is_stopped)
        self._estimator = estimator
        self._time_limit_s = time_limit_s
        self._library = EstimatedLibrary()
        self._reach: Reach | None = None

    def think(
        self, world: World, similarity: Similarity, running: Environment, situation: Situation, *, optimises: bool
    ) -> Thought:
        """The best update of what runs, and whether to carry it out now.

        One that only saves cost is put off, unless the review `optimises`.
        """
        start = time.perf_counter()
        avoided, costs, planned = self._planned(world, running, situation)
        cost_before_us = sum(
            keep_cost_us(costs[u.transformation], world.horizon_s) for u in running.units if u.transformation in costs
        )
        thought = Thought(running, planned, cost_before_us, avoided)
        thought.seconds["estimate"] = time.perf_counter() - start
        with thought.timed("plan"):
            try:
                problem = Problem(planned, similarity, world.horizon_s, world.max_cost_us)
                found = self._plan(problem, optimises=optimises)
            except CfgplanError as error:
                thought.cause = str(error)
                return thought
            except Exception as error:  # a planner's own fault must not end the life-cycle
                thought.cause = f"{type(error).__name__}: {error}"
                return thought
        with thought.timed("judge"):
            try:
                self._judge(thought, found, optimises=optimises)
            except Exception as error:  # what nobody has judged is not carried out
                thought.decision, thought.change_set = Decision.UNDECIDED, None
                thought.cause = f"the judge failed: {type(error).__name__}: {error}"
        return thought

    def prepare(self, world: World, similarity: Similarity, running: Environment, situation: Situation) -> None:
        """Plan for what runs as it is: a planner that remembers finds out what repairs will need."""
        _, _, planned = self._planned(world, running, situation)
        with suppress(Exception):  # a review would meet it again, and tell
            self._plan(Problem(planned, similarity, world.horizon_s, world.max_cost_us), optimises=False)

    def _plan(self, problem: Problem, *, optimises: bool) -> BestEffort:
        if self._reach is None or not self._reach.holds_for(problem):
            self._reach = Reach(problem, unmet_reasons(problem))
        self._planner.asks_early = optimises
        found = best_effort(
            problem, self._planner, time_limit_s=self._time_limit_s, impossible=self._reach.unmet_reasons
        )
        return replace(found, problem=self._planner.known(found.problem))

    def _planned(
        self, world: World, running: Environment, situation: Situation
    ) -> tuple[Mapping[str, str], Mapping[str, Transformation], Environment]:
        """What is left out for now, the estimated costs by label, and the environment to plan in."""
        wanted = world.environment
        avoided = avoided_now(wanted, running, situation)
        costs = {t.label: self._library.estimated(t, self._estimator, world.horizon_s) for t in wanted.library}
        return avoided, costs, environment_to_plan(wanted, running, situation, avoided, costs)

    def _judge(self, thought: Thought, found: BestEffort, *, optimises: bool) -> None:
        plan = found.plan
        thought.undecided = found.undecided
        # The planner does not know of what is left out, which may be all that is missing.
        left_out = f" (left out for now: {', '.join(sorted(thought.avoided))})" if thought.avoided else ""
        given_up = {label: f"{reason}{left_out}" for label, reason in found.given_up.items()}
        thought.warnings = tuple(why for name, why in plan.reasons.items() if name not in found.given_up)
        violations = validity.violations(thought.planned, found.problem.similarity)
        unmet_now = {violation.target for violation in violations if violation.rule is Rule.MET}
        thought.unmet = {label: why for label, why in given_up.items() if label in unmet_now}
        if plan.change_set is None:
            thought.cause = f"the plan is {plan.status}"
            if plan.status is Status.UNKNOWN:
                thought.cause = (
                    "it is not decided whether there is a plan" if found.undecided else "no plan was found in time"
                )
            return
        wrong = validity.plan_violations(found.problem, plan)
        if wrong:
            thought.cause = f"the answer of planner {plan.planner} is wrong: {'; '.join(map(str, wrong))}"
            return
        thought.change_set, thought.cost_us, thought.bound_us = plan.change_set, plan.cost_us, plan.bound_us
        thought.is_proven = found.exact and plan.status is Status.OPTIMAL and plan.required_proven
        met_now = [target.label for target in thought.planned.targets if target.label not in unmet_now]
        met_then = [target.label for target in found.problem.environment.targets]
        thought.decision = _decision(
            thought,
            _served(thought.planned, met_now, thought.planned),
            _served(thought.planned, met_then, found.problem.environment.update(plan.change_set)),
            is_sound=all(violation.rule is Rule.MET for violation in violations),
            optimises=optimises,
        )
        is_kept = thought.decision is Decision.KEPT
        thought.met = tuple(met_now if is_kept else met_then)
        thought.unmet = thought.unmet if is_kept else given_up


def _decision(
    thought: Thought, before: tuple[int, ...], after: tuple[int, ...], *, is_sound: bool, optimises: bool
) -> Decision:
    """What to do, by what is served before and after the update."""
    assert thought.change_set is not None and thought.cost_us is not None
    if is_sound and before > after and not thought.is_proven:
        return Decision.KEPT  # the planner had not the time to find as much as what runs serves
    if not thought.change_set:
        return Decision.KEPT
    if not is_sound or before < after:
        return Decision.APPLIED
    if thought.cost_us >= thought.cost_before_us and before == after:
        return Decision.KEPT
    return Decision.APPLIED if optimises else Decision.DEFERRED


def _served(wanted: Environment, met: list[str], running: Environment) -> tuple[int, ...]:
    """How many of the wanted targets of each priority are met, the highest first, and required transformations used."""
    levels = sorted({target.priority for target in wanted.targets}, reverse=True)
    used = _used(running).intersection(wanted.required) if wanted.required else ()
    by_priority = [sum(t.priority == level and t.label in met for t in wanted.targets) for level in levels]
    return *by_priority, len(used)


def _used(environment: Environment) -> set[str]:
    """The transformations of the units that serve some target, directly or through others."""
    topics = {target.topic for target in environment.targets}
    ahead = [unit for unit in environment.units if any(p.topic in topics for p in unit.publications)]
    seen: set[str] = set()
    while ahead:
        unit = ahead.pop()
        if unit.id not in seen:
            seen.add(unit.id)
            ahead += [environment.unit[s.unit] for s in unit.feeds.values() if s.unit in environment.unit]
    return {environment.unit[unit].transformation for unit in seen}
