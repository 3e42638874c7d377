"""The manager's decisions: a pure function from a state and an event to the next state and effects.

A review passes through these cases: it becomes due, collects the perturbations shortly after, plans until no item
interrupts, applies the update, and is recorded.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from enum import Flag, auto
from math import inf

from cfgplan.api import World
from cfgplan.domain import ChangeSet, Environment
from cfgplan.errors import InputError
from cfgplan_runtime import errors
from cfgplan_runtime.lifecycle import intake
from cfgplan_runtime.lifecycle.back_off import BackOffs, Place
from cfgplan_runtime.lifecycle.basis import basis_of, staleness
from cfgplan_runtime.lifecycle.changes import ApplyPlan, RestartUnits, Stop
from cfgplan_runtime.lifecycle.configuration import Situation, external_units, is_outdated, restarting, with_world
from cfgplan_runtime.lifecycle.deliberation import Findings, Looked
from cfgplan_runtime.lifecycle.differences import can_run_as
from cfgplan_runtime.lifecycle.fact_values import fact_seen, facts_fallen_silent
from cfgplan_runtime.lifecycle.inbox import Asked, FactSeen, Item, Leave, OldCode, PreviewAsked, QualityTold, Unusable
from cfgplan_runtime.lifecycle.kinds import Urgency, kind_of
from cfgplan_runtime.lifecycle.looks import Idle, Looks, hopes_of
from cfgplan_runtime.lifecycle.perturbations import (
    HorizonReached,
    LookDue,
    LookOver,
    MayStartAgain,
    PlanGiven,
    RestartAsked,
    Started,
    UnitGone,
    UpdateFailed,
)
from cfgplan_runtime.lifecycle.policy import Policy
from cfgplan_runtime.lifecycle.reports import Decision, Ended, Observed, Review, ReviewBegan, Reviewed
from cfgplan_runtime.lifecycle.state import Doing, Entry, Gathering, Planning, State, Updating
from cfgplan_runtime.lifecycle.stream_qualities import (
    look_learned,
    qualities_faded,
    qualities_learned,
    quality_told,
)
from cfgplan_runtime.lifecycle.transitions import (
    ApplyUpdate,
    Effect,
    Finished,
    GivenJudged,
    Input,
    JudgeGiven,
    MakeLook,
    MakePlan,
    MakePreview,
    Matched,
    Observe,
    Planned,
    Prepare,
    Remember,
    Respond,
    Seen,
    StopAll,
    Tell,
    Tick,
    TimedInput,
    Transition,
    Updated,
)
from cfgplan_runtime.lifecycle.views import silence_reason
from cfgplan_runtime.lifecycle.worlds import WorldVersion
from cfgplan_runtime.supervision.backend import Failures
from cfgplan_runtime.supervision.delays import doubling_s
from cfgplan_runtime.supervision.events import Event


class BreakIn(Flag):
    """How an item breaks into the work under way."""

    INTERRUPT = auto()
    """The plan does not know the new item: it is made again."""
    ABANDON = auto()
    """The update waits for new units, and the new item is more urgent: the update is given up."""
    END = auto()
    """The manager has to end."""


def breaks_in(doing: Doing, item: Item) -> BreakIn:
    """How an item interrupts the work under way, before its effects are decided."""
    is_starting = isinstance(doing, Updating) and bool(doing.change_set.started)
    abandon = BreakIn.ABANDON if is_starting else BreakIn(0)
    match item:
        case PreviewAsked() | Asked(ApplyPlan() | RestartUnits()):
            return BreakIn(0)
        case Leave() | Asked(Stop()):
            return BreakIn.INTERRUPT | abandon | BreakIn.END
        case Asked():
            return BreakIn.INTERRUPT
        case Event() if (urgency := kind_of(item).urgency) >= Urgency.REPLAN:
            is_new = isinstance(doing, Updating) and getattr(item, "unit", None) in doing.starting
            return BreakIn.INTERRUPT if is_new or urgency is Urgency.REPLAN else BreakIn.INTERRUPT | abandon
    return BreakIn(0)


def first_state(world: World, policy: Policy, at_s: float = 0.0) -> State:
    """Return the state of a manager that has got no input yet, at this time of its clock in seconds."""
    situation = Situation(BackOffs(policy.back_off), awaits_hosts=policy.hosts_s is not None)
    version = WorldVersion(world, refuses_hosts=policy.refuses_hosts)
    return State(policy, version, situation, looks=Looks(idle=Idle(at_s)))


def decide(state: State, happened: TimedInput) -> tuple[State, tuple[Effect, ...]]:
    """The state after something has happened, and the effects to carry out, in this order.

    At most one effect is MakePlan, ApplyUpdate or StopAll. It is the last, and the next one of these follows only after
    its answer. Match and Observe are answered, by Matched and Seen, before any other input.
    """
    if state.running is not happened.running:
        state = replace(state, running=happened.running)
    transition = _case(Transition(state, happened.at_s), happened.what)
    return transition.state, (*_to_remember(state, transition), *transition.effects)


def _to_remember(before: State, transition: Transition) -> Iterator[Effect]:
    """Yield an effect for each change of failures. Refusals are left out: every manager finds them again."""
    back_offs, library = transition.state.situation.back_offs, transition.state.version.world.environment.transformation
    for place in sorted(back_offs.changed_since(before.situation.back_offs), key=str):
        record = back_offs.records.get(place)
        if record is None or place.label not in library:
            yield Remember(place, None)
        elif record.until_s < inf:
            left_s = max(0.0, record.until_s - transition.at_s)
            yield Remember(place, Failures(library[place.label], place.host, record.failures, left_s, record.cause))


def _case(transition: Transition, what: Input) -> Transition:
    match what:
        case Started():
            is_short = bool(transition.state.situation.lost_hosts(transition.state.version.world.environment))
            return transition.perturbed(what, delay_s=(transition.state.policy.hosts_s or 0.0) if is_short else 0.0)
        case Tick():
            return _tick(transition, what.time_s)
        case Asked():
            return intake.asked(transition, what)
        case Matched():
            return intake.matched(transition, what)
        case FactSeen(name, value):
            return fact_seen(transition, name, value)
        case QualityTold(statement, value):
            return quality_told(transition, statement, value)
        case PreviewAsked():
            return transition.to(replace(transition.state, previews=(*transition.state.previews, what.outcome)))
        case Unusable():
            return intake.refused(transition, what.by, what.faults)
        case OldCode(file, units):
            return intake.old_code_found(transition, file, units)
        case Leave():
            return transition.to(replace(transition.state, is_closing=True))
        case Seen():
            return _seen(transition, what)
        case Planned():
            return _planned(transition, what)
        case GivenJudged():
            return _given_judged(transition, what.findings)
        case Looked():
            return _looked(transition, what)
        case Updated():
            return _updated(transition, what)
        case Finished():
            return _finished(transition, what.cause)
        case _:
            return intake.heard(transition, what)


def _tick(transition: Transition, time_s: float) -> Transition:
    """Begin the work that is due."""
    state, at_s = transition.state, transition.at_s
    if state.is_closing or state.stops:
        return _ended(transition)
    back_offs = state.situation.back_offs.at(at_s)
    ended = state.situation.back_offs.avoided - back_offs.avoided
    if ended:
        transition = transition.situated(replace(state.situation, back_offs=back_offs))
        transition = transition.perturbed(MayStartAgain(tuple(sorted({place.label for place in ended}))))
    if state.horizon_at_s <= at_s:
        transition = qualities_faded(transition.to(replace(transition.state, cycle_began_s=inf)))
        transition = transition.perturbed(HorizonReached(state.version.world.horizon_s))
    state = (transition := _look_ended(facts_fallen_silent(transition))).state
    if state.doing is None and state.due_s <= at_s:
        transition = transition.to(replace(state, doing=Gathering(at_s + state.policy.gather_s)))
    match transition.state.doing:
        case Gathering(until_s) if until_s <= at_s:
            return _begun(transition, time_s)
        case None if state.has_waiting_plans:
            return _seen_to(transition, time_s)
        case None if state.observe_at_s <= at_s:
            return transition.also(Observe())
        case None if state.look_at_s <= at_s:
            return _look_begun(transition, time_s)
    return transition


def _look_begun(transition: Transition, time_s: float) -> Transition:
    """Have a look planned at a transformation that may be better, and was not observed for long."""
    state, at_s = transition.state, transition.at_s
    planning = Planning(state.number + 1, at_s, time_s, 0.0, state.version.world, plans=1)
    unmet = state.reviews[-1].unmet if state.reviews else {}
    transition = _units_known(transition.to(replace(state, doing=planning)))
    environment = state.version.world.environment.with_facts(state.situation.facts)
    due = (place for place, due_s in state.looks_due_s.items() if due_s <= at_s)
    hopes = {place: hopes_of(place, environment, state.seen.estimates, at_s) for place in due}
    return transition.also(MakeLook(transition.state.plan_input, hopes, unmet, state.known_places))


def _looked(transition: Transition, looked: Looked) -> Transition:
    """Start the units of a planned look. If something has happened meanwhile, the look is planned again later."""
    state, planning = transition.state, transition.state.doing
    assert isinstance(planning, Planning)
    if state.entries or state.is_closing or state.stops:
        return transition.to(replace(state, doing=None))
    every_s, qualities = state.policy.look_every_s or 0.0, state.situation.qualities
    known, is_possible = state.known_places, looked.findings is not None
    looks = state.looks.begun(looked.tried, transition.at_s, every_s, is_possible=is_possible, known=known)
    if looked.findings is None:
        looks = looks.idled(transition.at_s, qualities, state.running.units, every_s)
        return transition.to(replace(state, doing=None, looks=looks))
    look_due = LookDue(*looked.place)
    planning = replace(planning, entries=(Entry(look_due, transition.at_s, transition.at_s),))
    looks = looks.at(looked.place, looked.statements, qualities, known)
    transition = transition.to(replace(state, number=planning.number, doing=planning, looks=looks))
    transition = transition.also(Tell(ReviewBegan(planning.number, (look_due,))))
    return _carried_out(transition, planning, looked.findings)


def _look_ended(transition: Transition) -> Transition:
    """End a look whose time is over; a review decides whether its units stay."""
    state, looks = transition.state, transition.state.looks
    if looks.until_s > transition.at_s:
        return transition
    if (longer := looks.longer(state.running, state.seen)) is not looks:
        return transition.to(replace(state, looks=longer))
    state = (transition := look_learned(transition)).state
    every_s = state.policy.look_every_s or 0.0
    over = looks.over(state.version.world.environment, state.situation.qualities, every_s)
    return transition.to(replace(state, looks=over)).perturbed(LookOver(looks.units))


def _begun(transition: Transition, time_s: float) -> Transition:
    """A review begins."""
    state, number = transition.state, transition.state.number + 1
    detect_s = transition.at_s - min(entry.at_s for entry in state.entries)
    planning = Planning(number, transition.at_s, time_s, detect_s, state.version.world)
    perturbations = tuple(entry.perturbation for entry in state.entries)
    if any(isinstance(perturbation, HorizonReached) for perturbation in perturbations):
        transition = transition.also(Observe())
    transition = transition.also(Tell(ReviewBegan(number, perturbations)))
    return _planning(transition.to(replace(state, number=number, doing=planning)), planning)


def _planning(transition: Transition, planning: Planning) -> Transition:
    """Ask for one plan that answers all perturbations."""
    state = transition.state
    entries = (*planning.entries, *state.entries)
    planning = replace(
        planning,
        world=state.version.world,
        entries=entries,
        plans=planning.plans + 1,
        optimises=state.owes_optimising or any(kind_of(each.perturbation).optimises for each in entries),
    )
    transition = _units_known(transition.to(replace(state, doing=planning, entries=())))
    return transition.also(MakePlan(transition.state.plan_input, planning.optimises, _is_last(planning, state)))


def _units_known(transition: Transition) -> Transition:
    """Record running units that are not known yet, such as those that a manager starts with."""
    running = transition.state.running
    return transition.situated(transition.state.situation.with_started(running.units, running, transition.at_s))


def _seen_to(transition: Transition, time_s: float) -> Transition:
    """Judge the first given plan or restart, unless its basis is stale. Without one, make the previews."""
    state, at_s = transition.state, transition.at_s
    if not state.given:
        return transition.to(replace(state, previews=())).also(MakePreview(state.plan_input, state.previews))
    request, *others = state.given
    transition = transition.to(replace(state, given=tuple(others)))
    match request.change:
        case ApplyPlan(change_set, basis, by):
            asked: PlanGiven | RestartAsked = PlanGiven(by)
            if faults := staleness(basis, basis_of(state.plan_input.world, state.running)):
                return transition.also(Respond(request.outcome, InputError(faults)))
        case RestartUnits(units, by):
            asked, change_set = RestartAsked(units, by), restarting(state.running, units)
            if not change_set:  # none of them runs any more
                return transition.also(Respond(request.outcome))
        case other:
            raise AssertionError(other)
    entry = Entry(asked, at_s, at_s, (request.outcome,))
    planning = Planning(state.number + 1, at_s, time_s, 0.0, state.version.world, (entry,), plans=1)
    transition = _units_known(transition.to(replace(transition.state, doing=planning)))
    return transition.also(JudgeGiven(transition.state.plan_input, change_set))


def _given_judged(transition: Transition, findings: Findings) -> Transition:
    """Carry out a plan that was given, if it is valid."""
    state, planning = transition.state, transition.state.doing
    assert isinstance(planning, Planning)
    if findings.change_set is None:
        mend = "make a new plan by `cfgplan ctl plan --out`"
        refusal = InputError.of(f"the plan can't be carried out: {findings.cause}", mend=mend)
        outcomes = [outcome for entry in planning.entries for outcome in entry.outcomes]
        return transition.to(replace(state, doing=None)).also(*(Respond(outcome, refusal) for outcome in outcomes))
    perturbations = tuple(entry.perturbation for entry in planning.entries)
    transition = transition.to(replace(state, number=planning.number)).also(
        Tell(ReviewBegan(planning.number, perturbations))
    )
    return _carried_out(transition, planning, findings)


def _is_last(planning: Planning, state: State) -> bool:
    return planning.plans > state.policy.interruptions


def _planned(transition: Transition, planned: Planned) -> Transition:
    """Carry out the new plan, unless an item has come in between."""
    state, findings, planning = transition.state, planned.findings, transition.state.doing
    assert isinstance(planning, Planning)
    if state.is_closing or state.stops:
        return _ended(transition)
    if not _is_last(planning, state) and (state.entries or planned.was_interrupted):
        return _planning(transition, planning)
    for label in findings.hurried:
        transition = _shortened(transition, label)
    transition = transition.telling_of_failed()
    if findings.change_set is None:
        return _reviewed(transition, planning, findings, UpdateFailed(findings.cause))
    return _carried_out(transition, planning, findings)


def _carried_out(transition: Transition, planning: Planning, findings: Findings) -> Transition:
    """Apply the decision, if it changes anything."""
    state, library = transition.state, planning.world.environment
    wanted = findings.change_set if findings.decision is Decision.APPLIED else None
    change_set = with_world(wanted or ChangeSet(), library, state.running)
    if not change_set and not (state.failures and _has_unconnected_pinned(state.running)):
        return _prepared(_reviewed(transition, planning, findings, None))
    situation = transition.state.situation.without(*(unit.id for unit in change_set.started))
    transition = transition.situated(situation.with_started(change_set.started, library, transition.at_s))
    transition = transition.to(replace(transition.state, doing=Updating(planning, findings, change_set)))
    return transition.also(ApplyUpdate(change_set, findings.running))


def _has_unconnected_pinned(running: Environment) -> bool:
    """Whether an undone update may have left a pinned unit that waits for an update, even an empty one, to begin."""
    feeding = {subscription.stream.unit for unit in running.units for subscription in unit.subscriptions}
    alone = (unit for unit in running.units if not (unit.subscriptions or unit.publications or unit.id in feeding))
    return any(running.transformation[unit.transformation].pinned for unit in alone if not unit.standby)


def _shortened(transition: Transition, label: str) -> Transition:
    """Shorten the back-off of a transformation that nothing can replace."""
    situation = transition.state.situation
    back_offs = situation.back_offs.shortening(label, transition.at_s)
    if back_offs is situation.back_offs:
        return transition
    transition = transition.situated(replace(situation, back_offs=back_offs))
    return transition.to(replace(transition.state, failed=transition.state.failed | {label}))


def _updated(transition: Transition, updated: Updated) -> Transition:
    """An update was carried out or not."""
    updating = transition.state.doing
    assert isinstance(updating, Updating)
    findings = replace(updating.findings, seconds={**updating.findings.seconds, "apply": updated.seconds})
    if updated.error is not None:
        transition, failed = _failed(transition, updating, updated.error)
        return _reviewed(transition, updating.planning, findings, failed)
    transition = transition.situated(transition.state.situation.without(*updating.change_set.stopped))
    started = updating.change_set.started
    looks = transition.state.looks
    if _is_look(updating.planning):
        looks = looks.running(tuple(unit.id for unit in started), transition.at_s)
    seen = transition.state.seen.after_update(unit.id for unit in started)
    transition = transition.to(replace(transition.state, seen=seen, looks=looks))
    transition = _reviewed(transition, updating.planning, findings, None)
    for gone, lived_s in _deaths(transition.state, updating):
        transition = intake.died(transition, gone, lived_s)
    return _prepared(transition)


def _deaths(state: State, updating: Updating) -> list[tuple[UnitGone, float | None]]:
    """The new units that have died in an update, with how long each lived; None: blameless, also by an edit since."""
    outdated = _outdated(state, updating)
    return [(gone, None if gone.transformation in outdated else lived_s) for gone, lived_s in updating.gone]


def _outdated(state: State, updating: Updating) -> frozenset[str]:
    """The transformations that an update starts as they were before an edit: its failures say nothing about them."""
    planned, now = updating.planning.world.environment.transformation, state.version.world.environment.transformation
    labels = {unit.transformation for unit in updating.change_set.started} & planned.keys() & now.keys()
    return frozenset(label for label in labels if not can_run_as(planned[label], now[label]))


def _failed(transition: Transition, updating: Updating, error: Exception) -> tuple[Transition, UpdateFailed]:
    """The perturbation of a failed update; its transformations are refused, postponed or blamed."""
    slow: tuple[str, ...] = ()
    match error:
        case errors.StaleChangeSetError():
            failed = UpdateFailed(str(error), is_stale=True)
        case errors.NoSourceError(transformations=labels, cause=cause):
            failed = UpdateFailed(str(error), labels)
            outdated = _outdated(transition.state, updating)
            for label in [label for label in labels if label not in outdated]:
                situation = transition.state.situation
                refusing = situation.back_offs.refusing(label, cause)
                transition = transition.situated(replace(situation, back_offs=refusing)).telling_back_off(label)
        case errors.AbandonedError(units=slow):
            transition, postponed = _postponed(transition, slow)
            failed = UpdateFailed(error.cause, postponed, is_undone=True)
        case errors.ApplyError(units=slow):
            transition, blamed = _blamed(transition, updating, slow, error.cause)
            failed = UpdateFailed(error.cause, blamed, is_undone=True)
        case _:
            failed = UpdateFailed(f"the middleware failed: {type(error).__name__}: {error}", is_fault=True)
    gone = updating.starting.union(slow).difference(transition.state.running.unit)
    return transition.situated(transition.state.situation.without(*gone)), failed


def _postponed(transition: Transition, units: tuple[str, ...]) -> tuple[Transition, tuple[str, ...]]:
    """Postpone the transformations whose units were starting as the update was abandoned. Returns their labels too."""
    situation, until_s = transition.state.situation, transition.at_s + transition.state.policy.postpone_s
    world = transition.state.version.world.environment
    starting = [running for unit in units if (running := situation.units.get(unit)) is not None]
    for place in {running.place for running in starting if not is_outdated(running, world)}:
        situation = replace(situation, back_offs=situation.back_offs.postponing(place, until_s))
    return transition.situated(situation), tuple(sorted({running.place.label for running in starting}))


def _blamed(
    transition: Transition, updating: Updating, units: tuple[str, ...], cause: str
) -> tuple[Transition, tuple[str, ...]]:
    """Blame the transformations whose units did not start. Returns their labels too."""
    labels = [gone.transformation for gone, _ in updating.gone]
    for gone, lived_s in _deaths(transition.state, updating):
        if lived_s is not None:
            transition = transition.blamed(Place(gone.transformation, gone.host), lived_s, gone.cause, is_costly=True)
    world = transition.state.version.world.environment
    for unit in units:
        running = transition.state.situation.units.get(unit)
        if running is not None and running.place.label not in labels:  # it was too slow, but has not died
            if not is_outdated(running, world):
                transition = transition.blamed(running.place, 0.0, cause, is_costly=True)
            labels.append(running.place.label)
    return transition, tuple(sorted(set(labels)))


def _reviewed(
    transition: Transition, planning: Planning, findings: Findings, failed: UpdateFailed | None
) -> Transition:
    """Record a finished review, answer the requests that wait for it, and request another one if it has failed."""
    review = _record(transition.state, planning, findings, failed)
    transition = _followed_up(transition, planning, failed)
    state, at_s = transition.state, transition.at_s
    is_look = _is_look(planning)
    optimised = failed is None and not is_look and (planning.optimises or review.decision is Decision.APPLIED)
    transition = transition.to(
        replace(
            state,
            doing=None,
            reviews=(*state.reviews, review)[-state.policy.reviews_kept :],
            costs=findings.planned.transformation,
            match_s=0.0,
            cycle_began_s=at_s if optimised else state.cycle_began_s,
            observe_at_s=at_s + state.policy.observe_every_s if state.observe_at_s == inf else state.observe_at_s,
        )
    )
    outcomes = [outcome for entry in planning.entries for outcome in entry.outcomes]
    return transition.also(Tell(Reviewed(review)), *(Respond(outcome, review) for outcome in outcomes))


def _is_look(planning: Planning) -> bool:
    return any(isinstance(entry.perturbation, LookDue) for entry in planning.entries)


def _record(state: State, planning: Planning, findings: Findings, failed: UpdateFailed | None) -> Review:
    silent = {one.target: silence_reason(one, planning.at_s) for one in state.situation.silences}
    is_failed = failed is not None and findings.change_set is not None
    return Review(
        planning.number,
        planning.at_s,
        planning.time_s,
        tuple(entry.perturbation for entry in planning.entries),
        Decision.FAILED if is_failed else findings.decision,
        planning.world.horizon_s,
        findings.cost_before_us,
        findings.cost_us,
        findings.bound_us,
        findings.is_proven,
        findings.change_set,
        tuple(label for label in findings.met if label not in silent),
        {**{label: reason for label, reason in silent.items() if label in findings.met}, **findings.unmet},
        dict(sorted(findings.avoided.items())),
        {"detect": planning.detect_s, "match": state.match_s, **findings.seconds},
        findings.warnings,
        "" if failed is None else failed.cause,
        findings.undecided,
        external_units(findings.change_set, findings.planned),
        failed is not None and failed.is_undone,
    )


def _followed_up(transition: Transition, planning: Planning, failed: UpdateFailed | None) -> Transition:
    """Have another review follow a failed one: at once if its plan is sure to differ, else later."""
    if failed is None:
        return transition.to(replace(transition.state, failures=0, owes_optimising=False))
    failures, policy = transition.state.failures + 1, transition.state.policy
    is_other = bool(failed.transformations) or (failed.is_stale and failures == 1)
    delay_s = 0.0 if is_other else doubling_s(failures + 1, policy.retry_s, policy.most_retry_s)
    transition = transition.to(replace(transition.state, failures=failures, owes_optimising=planning.optimises))
    return transition.perturbed(failed, delay_s=delay_s)


def _prepared(transition: Transition) -> Transition:
    """Let the planner prepare for the units that run after an update, unless a review is due."""
    state = transition.state
    if state.reviews[-1].decision is not Decision.APPLIED or state.due_s <= transition.at_s:
        return transition
    return transition.also(Prepare(state.plan_input))


def _seen(transition: Transition, seen: Seen) -> Transition:
    """Units were observed."""
    found, state = seen.observations, transition.state
    next_s = transition.at_s + state.policy.observe_every_s
    state = replace(state, observations={one.unit: one for one in found}, observe_at_s=next_s)
    return qualities_learned(transition.to(state).also(Tell(Observed(found))))


def _ended(transition: Transition) -> Transition:
    """The end was asked for."""
    return _finished(transition, "") if transition.state.is_closing else transition.also(StopAll())


def _finished(transition: Transition, cause: str) -> Transition:
    """End the manager: answer the requests for the end, and fail all other requests."""
    state = transition.state
    match state.doing:
        case Planning(entries=begun) | Updating(Planning(entries=begun)):
            entries = (*begun, *state.entries)
        case _:
            entries = state.entries
    left = [outcome for outcomes in state.waiting.values() for outcome in outcomes]
    left += [outcome for entry in entries for outcome in entry.outcomes]
    left += [request.outcome for request in state.given]
    error = errors.RuntimeFaultError("the run has ended")
    nothing = replace(state, doing=None, entries=(), waiting={}, stops=(), given=(), previews=(), is_over=True)
    transition = transition.to(nothing).also(*(Respond(outcome, error) for outcome in state.previews))
    transition = transition.also(*(Respond(outcome) for outcome in state.stops))
    return transition.also(*(Respond(outcome, error) for outcome in left)).also(Tell(Ended(cause)))
