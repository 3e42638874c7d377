"""The planning half of a review: match, estimate, plan, judge. It changes no running unit."""

from __future__ import annotations

import threading
import time
from collections import ChainMap
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Set
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from operator import is_
from typing import TYPE_CHECKING

from cfgplan import validity
from cfgplan.api import World
from cfgplan.domain import ChangeSet, ComputationUnit, Environment, Objective, Statement
from cfgplan.errors import CfgplanError
from cfgplan.explaining.best_effort import BestEffort, best_effort
from cfgplan.explaining.what_if import only_targets
from cfgplan.onward import reached
from cfgplan.planners.undecided import Deciding
from cfgplan.planning import Failures, Feature, Measured, Pair, Plan, Planner, Problem, Progress, Status, fresh_unit_ids
from cfgplan.reasons import unmet_reasons
from cfgplan.shared_states import double_owners
from cfgplan.summary import some
from cfgplan.unmet import Reason
from cfgplan.validity import Rule
from cfgplan.validity.facts import meeting_targets, needed_by
from cfgplan.validity.hosts import costs_there
from cfgplan_runtime.lifecycle.back_off import Place
from cfgplan_runtime.lifecycle.configuration import (
    EstimatedLibrary,
    PlanInput,
    as_it_runs,
    avoided_now,
    environment_to_plan,
    gone_host,
)
from cfgplan_runtime.lifecycle.guarded_estimator import GuardedEstimator
from cfgplan_runtime.lifecycle.looks import LOOK_S, PAYS
from cfgplan_runtime.lifecycle.policy import Policy
from cfgplan_runtime.lifecycle.reports import Decision
from cfgplan_runtime.lifecycle.warm_matching import WarmMatching

if TYPE_CHECKING:
    from cfgplan.matching import Matches

_MOST_AVOIDED_NAMED = 4


@dataclass(frozen=True)
class Findings:
    """The findings of a review. `change_set` is over units only."""

    running: Environment
    planned: Environment
    cost_before_us: int = 0
    avoided: Mapping[str, str] = field(default_factory=dict)
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
    hurried: tuple[str, ...] = ()
    """Transformations that are avoided though no other can replace them."""
    seconds: Mapping[str, float] = field(default_factory=dict, compare=False)
    """Wall time of each phase."""
    found: BestEffort | None = field(default=None, compare=False)
    """The planner's answer, with the problem that it solves; None if the planner gave none."""
    error: Exception | None = field(default=None, compare=False)
    """An exception of the planner or of the judge."""


@dataclass(frozen=True)
class Looked:
    """The planned look at the last of the `tried` places, which observes the outputs of `statements`.

    `findings` is None if no look is worth its cost, or the units of none of the `tried` could run.
    """

    tried: tuple[Place, ...] = ()
    statements: tuple[Statement, ...] = ()
    findings: Findings | None = None

    @property
    def place(self) -> Place:
        return self.tried[-1]


@dataclass(frozen=True)
class UnmetTargets:
    """The targets of a problem that no configuration can meet, with the reasons."""

    problem: Problem
    unmet_reasons: Mapping[str, Reason]

    def holds_for(self, problem: Problem) -> bool:
        """Whether another problem has the same library, omitted transformations, matching and targets (and costs: they
        change rarely).
        """
        known, environment = self.problem.environment, problem.environment
        return (
            problem.similarity is self.problem.similarity
            and environment.targets == known.targets
            and len(environment.library) == len(known.library)
            and all(map(is_, environment.library, known.library))
            and environment.omitted == known.omitted
        )


class Deliberation:
    """Plans updates, one after the other, with a planner that may remember.

    The reasoner decides open pairs that a plan would use, if a review optimises or no plan exists without them, unless
    `is_stopped`.
    """

    def __init__(
        self,
        planner: Planner | None,
        estimator: GuardedEstimator,
        policy: Policy,
        matching: WarmMatching | Matches,
        is_stopped: Callable[[], bool] = lambda: False,
    ) -> None:
        from cfgplan.planners.cpsat import PlannerSession

        self._session = None if planner else PlannerSession()
        self._stop: threading.Event | None = None
        self._planner = Deciding(planner or self._remembering, matching, is_stopped)
        self._estimator = estimator
        self._time_limit_s = policy.time_limit_s
        self._matching = matching
        self._library = EstimatedLibrary()
        self._reach: UnmetTargets | None = None

    def warm_up(self) -> None:
        """Import the solver in a thread of its own, so that the first difficult plan need not wait for it."""
        if self._session is not None:
            threading.Thread(target=_import_solver, name="cfgplan-warm-up", daemon=True).start()

    def think(self, plan_input: PlanInput, *, optimises: bool, stop: threading.Event) -> Findings:
        """The best update of the running units, and whether to carry it out now.

        An update that only saves cost is put off, unless the review `optimises`. `stop` ends planning early.
        """
        self._stop = stop
        findings = self._letting_wait(self._think(plan_input, optimises=optimises), plan_input)
        estimates = (self._estimator.warning,) if self._estimator.warning else ()
        warnings = (*self._matching.warnings, *estimates, *findings.warnings)
        out_of_reach = {
            target.label: gone_host(target.host)
            for target in plan_input.world.environment.targets
            if plan_input.situation.is_lost(target.host)
        }
        return replace(findings, unmet={**out_of_reach, **findings.unmet}, warnings=warnings)

    def judged(self, plan_input: PlanInput, change_set: ChangeSet) -> Findings:
        """The findings about a given change set over units; without a change set if it is not valid."""
        findings = self._begun(plan_input)
        wanted = self.problem(findings.planned, plan_input.world)
        try:
            asked = [_given(problem, change_set) for problem in (wanted, *(less for less, _ in _asking_less(wanted)))]
            valid = (found for found in asked if not validity.plan_violations(found.problem, found.plan))
            judged = _judged(findings, next(valid, asked[0]), {}, optimises=True)
        except Exception as error:  # the judge's own fault must not end the life-cycle
            return replace(findings, cause=str(error) or type(error).__name__)
        unmet = [label for label in findings.planned.target if label not in asked[0].problem.environment.target]
        given_up = dict.fromkeys(unmet, "the plan that was given does not meet it")
        return replace(
            judged, decision=Decision.APPLIED, met=tuple(asked[0].problem.environment.target), unmet=given_up
        )

    def look(
        self,
        plan_input: PlanInput,
        hopes: Mapping[Place, Mapping[Statement, int]],
        unmet: Mapping[str, str],
        known: Collection[Place],
        *,
        stop: threading.Event,
    ) -> Looked:
        """Plan a look at the first place that a plan would use if its outputs had the hoped deviations.

        The new units feed no topic. `unmet` has the targets that are not met now, with the reasons. The hope of a
        place without a host counts only on hosts where the transformation has no `known` place.
        """
        self._stop, tried, left = stop, list[Place](), dict(hopes)
        while left:  # if no look is worth its cost, a single plan shows it
            optimistic, before = self._hopeful(plan_input, left.values(), known), len(tried)
            promising = [place for place in left if _new_there(optimistic, place, known)]
            for place in promising:
                alone = optimistic if len(promising) == 1 else self._hopeful(plan_input, [hopes[place]], known)
                if not (new := _new_there(alone, place, known)):
                    continue
                host = new[0].host
                units = _needed_for_a_look(alone, [unit for unit in new if unit.host == host], hopes[place])
                if not _pays(alone, units, unmet):
                    continue
                tried.append(place._replace(host=host))
                findings = self._run_for_nobody(plan_input, ChangeSet(started=units))
                if findings is not None:
                    statements = tuple(statement._replace(host=host) for statement in hopes[place])
                    return Looked(tuple(tried), statements, replace(findings, unmet=unmet))
                del left[place]
            if len(tried) == before:
                break
        return Looked(tuple(tried))

    def _hopeful(
        self, plan_input: PlanInput, hopes: Iterable[Mapping[Statement, int]], known: Collection[Place]
    ) -> Findings:
        """The best update if outputs had the hoped deviations."""
        hoped = ChainMap(*map(dict, hopes))
        as_stated = {
            statement._replace(host=place.host): 0
            for place in known
            for statement in hoped
            if (statement.transformation, statement.host) == (place.label, None)
        }
        seen = dict(ChainMap(dict(hoped), dict(plan_input.situation.qualities), as_stated))
        environment = plan_input.world.environment.with_qualities(seen)
        world = replace(plan_input.world, environment=environment)
        return self._think(replace(plan_input, world=world), optimises=True)

    def _run_for_nobody(self, plan_input: PlanInput, change_set: ChangeSet) -> Findings | None:
        """Return the start of units that no target needs; None if it breaks another rule, or units of two modes
        would write one named state.
        """
        findings, new = self._begun(plan_input), {unit.id for unit in change_set.started}
        library = plan_input.world.environment.transformation
        if any(isinstance(library[unit.transformation].run.state, str) for unit in change_set.started):
            return None
        wanted = self.problem(findings.planned, plan_input.world)
        for problem in (wanted, *(less for less, _ in _asking_less(wanted))):
            given = _given(problem, change_set)
            broken = validity.plan_violations(given.problem, given.plan)
            if all(violation.rule is Rule.LEAN and violation.unit in new for violation in broken):
                met = tuple(given.problem.environment.target)
                decision = Decision.APPLIED
                return replace(findings, change_set=change_set, cost_us=given.plan.cost_us, decision=decision, met=met)
        return None

    def prepare(self, plan_input: PlanInput, *, stop: threading.Event) -> None:
        """Plan for the running units, so that a planner with a memory is ready for repairs."""
        if self._session is None:
            return
        self._stop = stop
        planned = self._begun(plan_input).planned
        with suppress(Exception):  # a review would meet it again, and tell
            self._plan(self.problem(planned, plan_input.world), optimises=False)

    def _remembering(
        self,
        problem: Problem,
        *,
        time_limit_s: float | None = None,
        report: Callable[[Progress], None] | None = None,
    ) -> Plan:
        assert self._session is not None
        return self._session.plan(problem, time_limit_s=time_limit_s, report=report, stop=self._stop)

    def _think(self, plan_input: PlanInput, *, optimises: bool) -> Findings:
        seconds: dict[str, float] = {}
        with _timed("estimate", seconds):
            findings = replace(self._begun(plan_input), seconds=seconds)
        with _timed("plan", seconds):
            try:
                problem = self.problem(findings.planned, plan_input.world)
                found, asked, given_up = self._plan(problem, optimises=optimises)
            except CfgplanError as error:
                return replace(findings, cause=str(error), error=error)
            except Exception as error:  # a planner's own fault must not end the life-cycle
                return replace(findings, cause=f"{type(error).__name__}: {error}", error=error)
        findings = replace(findings, planned=asked.environment)
        with _timed("judge", seconds):
            try:
                found = replace(found, plan=where_spares_are(found.problem, found.plan))
                judged = _judged(findings, found, self._impossible(asked), optimises=optimises)
                return replace(judged, warnings=(*given_up, *judged.warnings))
            except Exception as error:  # what nobody has judged is not carried out
                return replace(findings, cause=f"the judge failed: {type(error).__name__}: {error}", error=error)

    def problem(self, planned: Environment, world: World) -> Problem:
        """The problem of planning in an environment that `think` has planned in."""
        is_bearable = world.survive is not Failures.HOSTS or planned.hosts
        survive = world.survive if is_bearable else None
        return Problem(planned, self._matching.similarity, world.horizon_s, world.max_cost_us, survive)

    def _plan(self, problem: Problem, *, optimises: bool) -> tuple[BestEffort, Problem, tuple[str, ...]]:
        """The best update; the problem that it solves, which may ask for less; and sentences about the demands given
        up.
        """
        found, asked, given_up = self._best(problem, optimises=optimises), problem, tuple[str, ...]()
        for less, why in _asking_less(problem):
            if found.plan.change_set is not None and not found.given_up.keys() - self._impossible(asked).keys():
                break
            other = self._best(less, optimises=optimises)
            if _worth(other) > _worth(found):
                found, asked, given_up = other, less, (*given_up, why)
        return found, asked, given_up

    def _impossible(self, problem: Problem) -> Mapping[str, Reason]:
        """The targets of a problem that no configuration can meet, with the reasons."""
        if self._reach is None or not self._reach.holds_for(problem):
            self._reach = UnmetTargets(problem, unmet_reasons(problem))
        return self._reach.unmet_reasons

    def _best(self, problem: Problem, *, optimises: bool) -> BestEffort:
        self._planner.asks_early = optimises
        impossible = self._impossible(problem)
        found = best_effort(problem, self._planner, time_limit_s=self._time_limit_s, impossible=impossible)
        return replace(found, problem=self._planner.known(found.problem))

    def _begun(self, plan_input: PlanInput) -> Findings:
        """The findings before planning: the transformations left out, the environment to plan in, and the cost of
        keeping all units.
        """
        wanted, horizon_s, avoided = plan_input.world.environment, plan_input.world.horizon_s, avoided_now(plan_input)
        costs = self._library.estimated(wanted, self._estimator, horizon_s)
        now = as_it_runs(replace(wanted, library=tuple(costs.values())), plan_input.running)
        planned = environment_to_plan(plan_input, avoided, costs)
        return Findings(plan_input.running, planned, validity.kept_us(now, horizon_s), avoided)

    def _letting_wait(self, findings: Findings, plan_input: PlanInput) -> Findings:
        """If targets fail for transformations that back off, shorten these waits, and keep units that wait for them."""
        situation = plan_input.situation
        refusals = situation.back_offs.refusals()
        waiting = situation.back_offs.avoided - refusals.avoided
        avoided = {place.label for place in waiting if place.host is not None or place.label in findings.avoided}
        if findings.change_set is None or not findings.unmet or not avoided:
            return findings
        optimistic = replace(plan_input, situation=replace(situation, back_offs=refusals))
        hoped = self._think(optimistic, optimises=True)
        plan_s = findings.seconds["plan"] + hoped.seconds["plan"]
        findings = replace(findings, seconds={**findings.seconds, "plan": plan_s})
        if hoped.change_set is None or not set(hoped.met) - set(findings.met):
            return findings
        assert findings.change_set is not None
        spared = set(findings.change_set.stopped).difference(hoped.change_set.stopped, situation.failing)
        change_set = without_stopping(findings.change_set, findings.running, spared)
        is_kept = not change_set and findings.decision is Decision.APPLIED
        return replace(
            findings,
            change_set=change_set,
            decision=Decision.KEPT if is_kept else findings.decision,
            hurried=tuple(sorted({unit.transformation for unit in hoped.change_set.started} & avoided)),
        )


def _asking_less(problem: Problem) -> Iterator[tuple[Problem, str]]:
    """The problem without demands that may be impossible with the remaining hosts, and these demands in words."""
    if any(link.is_measured for link in problem.environment.links):
        problem = replace(problem, environment=problem.environment.with_declared_links)
        yield problem, "a link between hosts carries less than its streams need"
    if problem.survive is not None:
        problem = replace(problem, survive=None)
        yield problem, "the configuration does not survive every failure"
    if any(transformation.min_instances for transformation in problem.environment.library):
        library = tuple(replace(t, min_instances=0) if t.min_instances else t for t in problem.environment.library)
        problem = replace(problem, environment=replace(problem.environment, library=library))
        yield problem, "there is no room for as many instances as are asked for"


def _new_there(findings: Findings, place: Place, known: Collection[Place]) -> list[ComputationUnit]:
    """Return the units that an update starts at a place (without a host: anywhere but at `known` places); none if
    the update is not worth it.
    """
    if findings.change_set is None or findings.decision is not Decision.APPLIED:
        return []
    new = (unit for unit in findings.change_set.started if unit.transformation == place.label and not unit.standby)
    if place.host is not None:
        return [unit for unit in new if unit.host == place.host]
    return [unit for unit in new if place._replace(host=unit.host) not in known]


def _needed_for_a_look(
    optimistic: Findings, looked_at: Iterable[ComputationUnit], statements: Iterable[Statement]
) -> tuple[ComputationUnit, ...]:
    """Return the new units that a look needs, without topics: the units that are looked at, and those that feed them.

    If another stream must say how good it is, all new units of the plan are needed.
    """
    if optimistic.change_set is None:
        return ()
    new = {unit.id: unit for unit in optimistic.change_set.started if not unit.standby}
    stated = map(optimistic.planned.stated, statements)
    if all(each is not None and each.observe is not None for each in stated):
        feeders = {unit.id: [one.stream.unit for one in unit.subscriptions] for unit in new.values()}
        needed = reached([unit.id for unit in looked_at], lambda unit: feeders.get(unit, ()))
        new = {unit_id: unit for unit_id, unit in new.items() if unit_id in needed}
    return tuple(replace(unit, publications=()) for unit in new.values())


def _pays(optimistic: Findings, units: Iterable[ComputationUnit], unmet: Mapping[str, str]) -> bool:
    """Whether a plan that a look may lead to meets more targets, or saves PAYS times the cost of the look's `units`.

    If the file orders other objectives before cost, the plan was found better by these.
    """
    if not unmet.keys().isdisjoint(optimistic.met) or optimistic.planned.minimise[0] is not Objective.COST:
        return True
    library = optimistic.planned.transformation
    costs = (costs_there(optimistic.planned, unit, library[unit.transformation]) for unit in units)
    look_us = sum(labor_us + LOOK_S * upkeep_us for labor_us, upkeep_us, _ in costs)
    return optimistic.cost_before_us - (optimistic.cost_us or 0) >= PAYS * look_us


def _given(problem: Problem, change_set: ChangeSet) -> BestEffort:
    """A given change set as an unproven plan, for the targets that it meets."""
    after = problem.environment.update(change_set)
    problem = only_targets(problem, after.meeting(after.units).keys())
    values, unused = validity.values_of(problem, after), validity.unused_required(after)
    order = problem.environment.minimise if Feature.ORDER in problem.features else ()
    objectives = tuple(Measured(objective, values[objective], 0) for objective in order)
    plan = Plan(
        "given", Status.FEASIBLE, change_set, values[Objective.COST], objectives=objectives, unused_required=unused
    )
    is_proven = all(one.is_proven for one in plan.measured)  # what is 0 can't be less
    return BestEffort(replace(plan, status=Status.OPTIMAL) if is_proven else plan, problem, {}, exact=False)


def _worth(found: BestEffort) -> tuple[bool, list[int]]:
    """A value that is greater for an update that meets more targets of the highest priority, then of the next."""
    met = [target.priority for target in found.problem.environment.targets]
    return found.plan.change_set is not None, sorted(met, reverse=True)


def _import_solver() -> None:
    import cfgplan.planners.exact.search  # noqa: F401


@contextmanager
def _timed(phase: str, seconds: dict[str, float]) -> Iterator[None]:
    """Note the wall time of a phase."""
    start = time.perf_counter()
    try:
        yield
    finally:
        seconds[phase] = time.perf_counter() - start


def without_stopping(change_set: ChangeSet, running: Environment, spared: Set[str]) -> ChangeSet:
    """The change set without the stops of `spared` units. They keep inputs from units that stay, and free topics."""
    stopped = tuple(unit for unit in change_set.stopped if unit not in spared)
    taken = {p.topic for unit in (*change_set.started, *change_set.rewired) for p in unit.publications}
    waiting = [_waiting(unit, set(stopped), taken) for unit in running.units if unit.id in spared]
    rewired = tuple(unit for unit in waiting if unit != running.unit[unit.id])
    return replace(change_set, stopped=stopped, rewired=(*change_set.rewired, *rewired))


def _waiting(unit: ComputationUnit, gone: Set[str], taken: Set[str]) -> ComputationUnit:
    subscriptions = tuple(s for s in unit.subscriptions if s.stream.unit not in gone)
    publications = tuple(p for p in unit.publications if p.topic not in taken)
    return replace(unit, subscriptions=subscriptions, publications=publications)


def where_spares_are(problem: Problem, plan: Plan) -> Plan:
    """A plan of equal cost that starts units in place of cold spares of their transformations, if one exists.

    A spare that the plan keeps moves to the place of the unit.
    """
    spares = [unit for unit in problem.environment.units if unit.standby]
    for new in plan.change_set.started if plan.change_set is not None and spares else ():
        alike = [spare for spare in spares if spare.transformation == new.transformation and not new.standby]
        alike = [spare for spare in alike if spare.host == new.host] or alike
        for spare in alike:
            other = plan if spare.host == new.host else _exchanged(problem.environment, plan, new, spare)
            if other is plan or not validity.plan_violations(problem, other):
                plan = other
                spares.remove(spare)
                break
    return plan


def _exchanged(before: Environment, plan: Plan, new: ComputationUnit, spare: ComputationUnit) -> Plan:
    """A plan with a new unit where a spare is, and, if it keeps the spare, one where the unit was to be."""
    assert plan.change_set is not None
    after = before.update(plan.change_set).unit
    units = {**after, new.id: replace(new, host=spare.host)}
    if units.pop(spare.id, None) is not None:
        known = replace(before, units=tuple({**before.unit, **after}.values()))
        (fresh,) = fresh_unit_ids(known, [spare.transformation]).values()
        units[fresh] = replace(spare, id=fresh, host=new.host)
    return replace(plan, change_set=before.change_to(units.values()), ties_proven=False)


def _judged(findings: Findings, found: BestEffort, impossible: Mapping[str, Reason], *, optimises: bool) -> Findings:
    plan, planned = found.plan, findings.planned
    # Transformations that are left out may be why a bound is missed or a cost is too large.
    left_out = f" (left out for now: {some(sorted(findings.avoided), _MOST_AVOIDED_NAMED)})" if findings.avoided else ""
    given_up = {label: why if label in impossible else why.noted(left_out) for label, why in found.given_up.items()}
    asked = found.problem
    violations = validity.violations(planned, asked.similarity, asked.survive, asked.horizon_s)
    unmet_now = {violation.target for violation in violations if violation.rule is Rule.MET}
    findings = replace(
        findings,
        found=found,
        undecided=found.undecided,
        warnings=tuple(why for name, why in plan.reasons.items() if name not in found.given_up),
        unmet={label: why for label, why in given_up.items() if label in unmet_now},
    )
    if plan.change_set is None:
        if plan.status is not Status.UNKNOWN:
            return replace(findings, cause=f"the plan is {plan.status}")
        is_open = bool(found.undecided)
        cause = "it is not decided whether there is a plan" if is_open else "no plan was found in time"
        return replace(findings, cause=cause)
    wrong = validity.plan_violations(found.problem, plan)
    if wrong:
        cause = f"the answer of planner {plan.planner} is wrong: {'; '.join(map(str, wrong))}"
        return replace(findings, cause=cause)
    findings = replace(
        findings,
        warnings=(*findings.warnings, *double_owners(found.problem.after(plan))),
        change_set=plan.change_set,
        cost_us=plan.cost_us,
        bound_us=plan.bound_us,
        is_proven=found.exact and plan.status is Status.OPTIMAL,
    )
    met_now = [target.label for target in planned.targets if target.label not in unmet_now]
    met_then = [target.label for target in found.problem.environment.targets]
    now = {**validity.values_of(asked, planned), Objective.COST: findings.cost_before_us}
    decision = _decision(
        findings,
        _served(planned, met_now, planned),
        _served(planned, met_then, found.problem.environment.update(plan.change_set)),
        is_sound=all(violation.rule is Rule.MET for violation in violations),
        saves=[one.value for one in plan.measured] < [now[one.objective] for one in plan.measured],
        optimises=optimises,
    )
    if decision is Decision.KEPT:
        return replace(findings, decision=decision, met=tuple(met_now))
    return replace(findings, decision=decision, met=tuple(met_then), unmet=given_up)


def _decision(
    findings: Findings, before: tuple[int, ...], after: tuple[int, ...], *, is_sound: bool, saves: bool, optimises: bool
) -> Decision:
    """The decision, by the targets served before and after the update, and whether it `saves` some of the
    objectives.
    """
    if is_sound and before > after and not findings.is_proven:
        return Decision.KEPT  # the planner had no time to find a plan that serves as much
    if not findings.change_set:
        return Decision.KEPT
    if not is_sound or before < after:
        return Decision.APPLIED
    if not saves and before == after:
        return Decision.KEPT
    return Decision.APPLIED if optimises else Decision.DEFERRED


def _served(wanted: Environment, met: list[str], running: Environment) -> tuple[int, ...]:
    """The number of met targets of each priority, the highest first, then that of required transformations in use."""
    levels = sorted({target.priority for target in wanted.targets}, reverse=True)
    used = _used(running).intersection(wanted.required) if wanted.required else ()
    by_priority = [sum(t.priority == level and t.label in met for t in wanted.targets) for level in levels]
    return *by_priority, len(used)


def _used(environment: Environment) -> set[str]:
    """The transformations of the units that serve some target, directly or through others."""
    needed = needed_by(environment, meeting_targets(environment))
    return {environment.unit[unit].transformation for unit in needed}
