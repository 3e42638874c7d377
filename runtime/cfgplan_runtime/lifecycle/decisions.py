"""The manager's decisions: a pure function from a state and an event to the next state and effects.

A review passes through these cases: it becomes due, collects the perturbations shortly after, plans until no item
interrupts, applies the update, and is recorded.
"""

from __future__ import annotations

from dataclasses import replace
from enum import Flag, auto
from math import inf

from cfgplan.api import World
from cfgplan.domain import ChangeSet
from cfgplan.errors import InputError
from cfgplan_runtime import errors
from cfgplan_runtime.lifecycle import intake
from cfgplan_runtime.lifecycle.back_off import BackOffs, Place
from cfgplan_runtime.lifecycle.basis import basis_of, staleness
from cfgplan_runtime.lifecycle.changes import ApplyPlan, RestartUnits, Stop
from cfgplan_runtime.lifecycle.configuration import Situation, external_units, restarting, with_world
from cfgplan_runtime.lifecycle.deliberation import Looked, Thought
from cfgplan_runtime.lifecycle.fact_values import fact_seen, facts_fallen_silent
from cfgplan_runtime.lifecycle.inbox import Asked, FactSeen, Item, Leave, PreviewAsked, QualityTold, Unusable
from cfgplan_runtime.lifecycle.kinds import Urgency, kind_of
from cfgplan_runtime.lifecycle.perturbations import (
    HorizonReached,
    LookDue,
    LookOver,
    MayStartAgain,
    PlanGiven,
    RestartAsked,
    Started,
    UpdateFailed,
)
from cfgplan_runtime.lifecycle.policy import Policy
from cfgplan_runtime.lifecycle.reports import Decision, Ended, Observed, Review, ReviewBegan, Reviewed
from cfgplan_runtime.lifecycle.state import Doing, Entry, Gathering, Planning, State, Updating
from cfgplan_runtime.lifecycle.stream_qualities import qualities_faded, qualities_learned, quality_told
from cfgplan_runtime.lifecycle.turns import (
    ApplyUpdate,
    Effect,
    Finished,
    GivenJudged,
    Happened,
    Happening,
    JudgeGiven,
    MakeLook,
    MakePlan,
    MakePreview,
    Matched,
    Observe,
    Planned,
    Prepare,
    Respond,
    Seen,
    StopAll,
    Tell,
    Tick,
    Turn,
    Updated,
)
from cfgplan_runtime.lifecycle.views import silence_reason
from cfgplan_runtime.lifecycle.worlds import LivingWorld
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


def first_state(world: World, policy: Policy) -> State:
    """Nothing has happened yet."""
    situation = Situation(BackOffs(policy.back_off), awaits_hosts=policy.hosts_s is not None)
    return State(policy, LivingWorld(world, refuses_hosts=policy.refuses_hosts), situation)


def decide(state: State, happened: Happened) -> tuple[State, tuple[Effect, ...]]:
    """The state after something has happened, and the effects to carry out, in this order.

    At most one of them is MakePlan, ApplyUpdate or StopAll, as the last, and none before the one before is answered.
    Match and Observe are answered, by Matched and Seen, before anything else happens.
    """
    if state.running is not happened.running:
        state = replace(state, running=happened.running)
    turn = _case(Turn(state, happened.at_s), happened.what)
    return turn.state, turn.effects


def _case(turn: Turn, what: Happening) -> Turn:
    match what:
        case Started():
            is_short = bool(turn.state.situation.lost_hosts(turn.state.living.world.environment))
            return turn.perturbed(what, delay_s=(turn.state.policy.hosts_s or 0.0) if is_short else 0.0)
        case Tick():
            return _tick(turn, what.time_s)
        case Asked():
            return intake.asked(turn, what)
        case Matched():
            return intake.matched(turn, what)
        case FactSeen(name, value):
            return fact_seen(turn, name, value)
        case QualityTold(statement, value):
            return quality_told(turn, statement, value)
        case PreviewAsked():
            return turn.to(replace(turn.state, previews=(*turn.state.previews, what.outcome)))
        case Unusable():
            return intake.refused(turn, what.by, what.faults)
        case Leave():
            return turn.to(replace(turn.state, is_closing=True))
        case Seen():
            return _seen(turn, what)
        case Planned():
            return _planned(turn, what)
        case GivenJudged():
            return _given_judged(turn, what.thought)
        case Looked():
            return _looked(turn, what)
        case Updated():
            return _updated(turn, what)
        case Finished():
            return _finished(turn, what.cause)
        case _:
            return intake.heard(turn, what)


def _tick(turn: Turn, time_s: float) -> Turn:
    """Begin the work that is due."""
    state, at_s = turn.state, turn.at_s
    if state.is_closing or state.stops:
        return _ended(turn)
    back_offs = state.situation.back_offs.at(at_s)
    ended = state.situation.back_offs.avoided - back_offs.avoided
    if ended:
        turn = turn.situated(replace(state.situation, back_offs=back_offs))
        turn = turn.perturbed(MayStartAgain(tuple(sorted({place.label for place in ended}))))
    if state.horizon_at_s <= at_s:
        turn = qualities_faded(turn.to(replace(turn.state, cycle_began_s=inf)))
        turn = turn.perturbed(HorizonReached(state.living.world.horizon_s))
    state = (turn := _look_ended(facts_fallen_silent(turn))).state
    if state.doing is None and state.due_s <= at_s:
        turn = turn.to(replace(state, doing=Gathering(at_s + state.policy.gather_s)))
    match turn.state.doing:
        case Gathering(until_s) if until_s <= at_s:
            return _begun(turn, time_s)
        case None if state.has_plans_to_see_to:
            return _seen_to(turn, time_s)
        case None if state.observe_at_s <= at_s:
            return turn.also(Observe())
        case None if state.look_at_s <= at_s:
            return _look_begun(turn, time_s)
    return turn


def _look_begun(turn: Turn, time_s: float) -> Turn:
    """Have a look planned at a transformation that was found too bad and was not observed for long."""
    state, at_s = turn.state, turn.at_s
    planning = Planning(state.number + 1, at_s, time_s, 0.0, state.living.world, plans=1)
    unmet = state.reviews[-1].unmet if state.reviews else {}
    turn = _units_known(turn.to(replace(state, doing=planning)))
    due = tuple(label for label, due_s in state.looks_due_s.items() if due_s <= at_s)
    return turn.also(MakeLook(turn.state.scene, due, unmet))


def _looked(turn: Turn, looked: Looked) -> Turn:
    """Start the units of a planned look. If something has happened meanwhile, the look is planned again later."""
    state, planning = turn.state, turn.state.doing
    assert isinstance(planning, Planning)
    if state.entries or state.is_closing or state.stops:
        return turn.to(replace(state, doing=None))
    state = replace(state, looks=state.looks.begun(looked.tried, turn.at_s, state.policy.look_every_s or 0.0))
    if looked.thought is None:
        return turn.to(replace(state, doing=None))
    planning = replace(planning, entries=(Entry(LookDue(looked.label), turn.at_s, turn.at_s),))
    looks = state.looks.at(looked.label, state.situation.qualities)
    turn = turn.to(replace(state, number=planning.number, doing=planning, looks=looks))
    turn = turn.also(Tell(ReviewBegan(planning.number, (LookDue(looked.label),))))
    return _carried_out(turn, planning, looked.thought)


def _look_ended(turn: Turn) -> Turn:
    """End a look whose time is over; a review decides whether its units stay."""
    state, looks = turn.state, turn.state.looks
    if looks.until_s > turn.at_s:
        return turn
    if (longer := looks.longer(state.running, state.seen)) is not looks:
        return turn.to(replace(state, looks=longer))
    every_s = state.policy.look_every_s or 0.0
    over = looks.over(state.living.world.environment, state.situation.qualities, every_s)
    return turn.to(replace(state, looks=over)).perturbed(LookOver(looks.units))


def _begun(turn: Turn, time_s: float) -> Turn:
    """A review begins."""
    state, number = turn.state, turn.state.number + 1
    detect_s = turn.at_s - min(entry.at_s for entry in state.entries)
    planning = Planning(number, turn.at_s, time_s, detect_s, state.living.world)
    perturbations = tuple(entry.perturbation for entry in state.entries)
    if any(isinstance(perturbation, HorizonReached) for perturbation in perturbations):
        turn = turn.also(Observe())
    turn = turn.also(Tell(ReviewBegan(number, perturbations)))
    return _planning(turn.to(replace(state, number=number, doing=planning)), planning)


def _planning(turn: Turn, planning: Planning) -> Turn:
    """Ask for one plan that answers all perturbations."""
    state = turn.state
    entries = (*planning.entries, *state.entries)
    planning = replace(
        planning,
        world=state.living.world,
        entries=entries,
        plans=planning.plans + 1,
        optimises=state.owes_optimising or any(kind_of(each.perturbation).optimises for each in entries),
    )
    turn = _units_known(turn.to(replace(state, doing=planning, entries=())))
    return turn.also(MakePlan(turn.state.scene, planning.optimises, _is_last(planning, state)))


def _units_known(turn: Turn) -> Turn:
    """Record running units that are not known yet, such as those that a manager starts with."""
    running = turn.state.running
    return turn.situated(turn.state.situation.with_started(running.units, running, turn.at_s))


def _seen_to(turn: Turn, time_s: float) -> Turn:
    """Judge the first given plan or restart, unless its basis is stale. Without one, make the previews."""
    state, at_s = turn.state, turn.at_s
    if not state.given:
        return turn.to(replace(state, previews=())).also(MakePreview(state.scene, state.previews))
    request, *others = state.given
    turn = turn.to(replace(state, given=tuple(others)))
    match request.change:
        case ApplyPlan(change_set, basis, by):
            asked: PlanGiven | RestartAsked = PlanGiven(by)
            if faults := staleness(basis, basis_of(state.scene.world, state.running)):
                return turn.also(Respond(request.outcome, InputError(faults)))
        case RestartUnits(units, by):
            asked, change_set = RestartAsked(units, by), restarting(state.running, units)
            if not change_set:  # none of them runs any more
                return turn.also(Respond(request.outcome))
        case other:
            raise AssertionError(other)
    entry = Entry(asked, at_s, at_s, (request.outcome,))
    planning = Planning(state.number + 1, at_s, time_s, 0.0, state.living.world, (entry,), plans=1)
    turn = _units_known(turn.to(replace(turn.state, doing=planning)))
    return turn.also(JudgeGiven(turn.state.scene, change_set))


def _given_judged(turn: Turn, thought: Thought) -> Turn:
    """Carry out a plan that was given, if it is valid."""
    state, planning = turn.state, turn.state.doing
    assert isinstance(planning, Planning)
    if thought.change_set is None:
        mend = "make a new plan by `cfgplan ctl plan --out`"
        refusal = InputError.of(f"the plan can't be carried out: {thought.cause}", mend=mend)
        outcomes = [outcome for entry in planning.entries for outcome in entry.outcomes]
        return turn.to(replace(state, doing=None)).also(*(Respond(outcome, refusal) for outcome in outcomes))
    perturbations = tuple(entry.perturbation for entry in planning.entries)
    turn = turn.to(replace(state, number=planning.number)).also(Tell(ReviewBegan(planning.number, perturbations)))
    return _carried_out(turn, planning, thought)


def _is_last(planning: Planning, state: State) -> bool:
    return planning.plans > state.policy.interruptions


def _planned(turn: Turn, planned: Planned) -> Turn:
    """Carry out the new plan, unless an item has come in between."""
    state, thought, planning = turn.state, planned.thought, turn.state.doing
    assert isinstance(planning, Planning)
    if state.is_closing or state.stops:
        return _ended(turn)
    if not _is_last(planning, state) and (state.entries or planned.was_interrupted):
        return _planning(turn, planning)
    for label in thought.hurried:
        turn = _shortened(turn, label)
    if thought.change_set is None:
        return _reviewed(turn, planning, thought, UpdateFailed(thought.cause))
    return _carried_out(turn, planning, thought)


def _carried_out(turn: Turn, planning: Planning, thought: Thought) -> Turn:
    """Apply the decision, if it changes anything."""
    state, library = turn.state, planning.world.environment
    wanted = thought.change_set if thought.decision is Decision.APPLIED else None
    change_set = with_world(wanted or ChangeSet(), library, state.running)
    if not change_set:
        return _prepared(_reviewed(turn, planning, thought, None))
    situation = turn.state.situation.without(*(unit.id for unit in change_set.started))
    turn = turn.situated(situation.with_started(change_set.started, library, turn.at_s))
    turn = turn.to(replace(turn.state, doing=Updating(planning, thought, change_set)))
    return turn.also(ApplyUpdate(change_set, thought.running))


def _shortened(turn: Turn, label: str) -> Turn:
    """Shorten the back-off of a transformation that nothing can replace."""
    situation = turn.state.situation
    back_offs = situation.back_offs.shortening(label, turn.at_s)
    if back_offs is situation.back_offs:
        return turn
    return turn.situated(replace(situation, back_offs=back_offs)).telling_back_off(label)


def _updated(turn: Turn, updated: Updated) -> Turn:
    """An update was carried out or not."""
    updating = turn.state.doing
    assert isinstance(updating, Updating)
    thought = replace(updating.thought, seconds={**updating.thought.seconds, "apply": updated.seconds})
    if updated.error is not None:
        turn, failed = _failed(turn, updating, updated.error)
        return _reviewed(turn, updating.planning, thought, failed)
    turn = turn.situated(turn.state.situation.without(*updating.change_set.stopped))
    started = updating.change_set.started
    looks = turn.state.looks
    if _is_look(updating.planning):
        looks = looks.running(tuple(unit.id for unit in started), turn.at_s)
    seen = turn.state.seen.after_update(unit.id for unit in started)
    turn = turn.to(replace(turn.state, seen=seen, looks=looks))
    turn = _reviewed(turn, updating.planning, thought, None)
    for gone, lived_s in updating.gone:
        turn = intake.died(turn, gone, lived_s)
    return _prepared(turn)


def _failed(turn: Turn, updating: Updating, error: Exception) -> tuple[Turn, UpdateFailed]:
    """The perturbation of a failed update; its transformations are refused, postponed or blamed."""
    slow: tuple[str, ...] = ()
    match error:
        case errors.StaleChangeSetError():
            failed = UpdateFailed(str(error), is_stale=True)
        case errors.NoSourceError(transformations=labels, cause=cause):
            failed = UpdateFailed(str(error), labels)
            for label in labels:
                situation = turn.state.situation
                refusing = situation.back_offs.refusing(label, cause)
                turn = turn.situated(replace(situation, back_offs=refusing)).telling_back_off(label)
        case errors.AbandonedError(units=slow):
            turn, postponed = _postponed(turn, slow)
            failed = UpdateFailed(str(error), postponed)
        case errors.ApplyError(units=slow):
            turn, blamed = _blamed(turn, updating, slow, str(error))
            failed = UpdateFailed(str(error), blamed)
        case _:
            failed = UpdateFailed(f"the middleware failed: {type(error).__name__}: {error}", is_fault=True)
    gone = updating.starting.union(slow).difference(turn.state.running.unit)
    return turn.situated(turn.state.situation.without(*gone)), failed


def _postponed(turn: Turn, units: tuple[str, ...]) -> tuple[Turn, tuple[str, ...]]:
    """Postpone the transformations whose units were starting as the update was abandoned. Returns their labels too."""
    situation, until_s = turn.state.situation, turn.at_s + turn.state.policy.postpone_s
    places = {place for unit in units if (place := situation.place_of(unit)) is not None}
    for place in places:
        situation = replace(situation, back_offs=situation.back_offs.postponing(place, until_s))
    return turn.situated(situation), tuple(sorted({place.label for place in places}))


def _blamed(turn: Turn, updating: Updating, units: tuple[str, ...], cause: str) -> tuple[Turn, tuple[str, ...]]:
    """Blame the transformations whose units did not start. Returns their labels too."""
    labels = [gone.transformation for gone, _ in updating.gone]
    for gone, lived_s in updating.gone:
        if lived_s is not None:
            turn = turn.blamed(Place(gone.transformation, gone.host), lived_s, gone.cause, is_costly=True)
    for unit in units:
        place = turn.state.situation.place_of(unit)
        if place is not None and place.label not in labels:  # it was too slow, but has not died
            turn = turn.blamed(place, 0.0, cause, is_costly=True)
            labels.append(place.label)
    return turn, tuple(sorted(set(labels)))


def _reviewed(turn: Turn, planning: Planning, thought: Thought, failed: UpdateFailed | None) -> Turn:
    """Record a finished review, answer the requests that wait for it, and request another one if it has failed."""
    review = _record(turn.state, planning, thought, failed)
    turn = _followed_up(turn, planning, failed)
    state, at_s = turn.state, turn.at_s
    is_look = _is_look(planning)
    optimised = failed is None and not is_look and (planning.optimises or review.decision is Decision.APPLIED)
    turn = turn.to(
        replace(
            state,
            doing=None,
            reviews=(*state.reviews, review)[-state.policy.reviews_kept :],
            costs=thought.planned.transformation,
            match_s=0.0,
            cycle_began_s=at_s if optimised else state.cycle_began_s,
            observe_at_s=at_s + state.policy.observe_every_s if state.observe_at_s == inf else state.observe_at_s,
        )
    )
    outcomes = [outcome for entry in planning.entries for outcome in entry.outcomes]
    return turn.also(Tell(Reviewed(review)), *(Respond(outcome, review) for outcome in outcomes))


def _is_look(planning: Planning) -> bool:
    return any(isinstance(entry.perturbation, LookDue) for entry in planning.entries)


def _record(state: State, planning: Planning, thought: Thought, failed: UpdateFailed | None) -> Review:
    silent = {one.target: silence_reason(one, planning.at_s) for one in state.situation.silences}
    is_failed = failed is not None and thought.change_set is not None
    return Review(
        planning.number,
        planning.at_s,
        planning.time_s,
        tuple(entry.perturbation for entry in planning.entries),
        Decision.FAILED if is_failed else thought.decision,
        planning.world.horizon_s,
        thought.cost_before_us,
        thought.cost_us,
        thought.bound_us,
        thought.is_proven,
        thought.change_set,
        tuple(label for label in thought.met if label not in silent),
        {**{label: reason for label, reason in silent.items() if label in thought.met}, **thought.unmet},
        dict(sorted(thought.avoided.items())),
        {"detect": planning.detect_s, "match": state.match_s, **thought.seconds},
        thought.warnings,
        "" if failed is None else failed.cause,
        thought.undecided,
        external_units(thought.change_set, thought.planned),
    )


def _followed_up(turn: Turn, planning: Planning, failed: UpdateFailed | None) -> Turn:
    """Have another review follow a failed one: at once if its plan is sure to differ, else later."""
    if failed is None:
        return turn.to(replace(turn.state, failures=0, owes_optimising=False))
    failures, policy = turn.state.failures + 1, turn.state.policy
    is_other = bool(failed.transformations) or (failed.is_stale and failures == 1)
    delay_s = 0.0 if is_other else doubling_s(failures + 1, policy.retry_s, policy.most_retry_s)
    turn = turn.to(replace(turn.state, failures=failures, owes_optimising=planning.optimises))
    return turn.perturbed(failed, delay_s=delay_s)


def _prepared(turn: Turn) -> Turn:
    """Let the planner prepare for the units that run after an update, unless a review is due."""
    state = turn.state
    if state.reviews[-1].decision is not Decision.APPLIED or state.due_s <= turn.at_s:
        return turn
    return turn.also(Prepare(state.scene))


def _seen(turn: Turn, seen: Seen) -> Turn:
    """Units were observed."""
    found, state = seen.observations, turn.state
    next_s = turn.at_s + state.policy.observe_every_s
    state = replace(state, observations={one.unit: one for one in found}, observe_at_s=next_s)
    return qualities_learned(turn.to(state).also(Tell(Observed(found))))


def _ended(turn: Turn) -> Turn:
    """The end was asked for."""
    return _finished(turn, "") if turn.state.is_closing else turn.also(StopAll())


def _finished(turn: Turn, cause: str) -> Turn:
    """End the manager: answer the requests for the end, and fail all other requests."""
    state = turn.state
    match state.doing:
        case Planning(entries=begun) | Updating(Planning(entries=begun)):
            entries = (*begun, *state.entries)
        case _:
            entries = state.entries
    left = [outcome for outcomes in state.waiting.values() for outcome in outcomes]
    left += [outcome for entry in entries for outcome in entry.outcomes]
    left += [request.outcome for request in state.given]
    error = errors.RuntimeFaultError("the manager has ended")
    nothing = replace(state, doing=None, entries=(), waiting={}, stops=(), given=(), previews=(), is_over=True)
    turn = turn.to(nothing).also(*(Respond(outcome, error) for outcome in state.previews))
    turn = turn.also(*(Respond(outcome) for outcome in state.stops))
    return turn.also(*(Respond(outcome, error) for outcome in left)).also(Tell(Ended(cause)))
