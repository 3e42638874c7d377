"""The changes of a manager's state by incoming items: events of units, and requests."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from cfgplan.errors import Fault, InputError
from cfgplan_runtime.children.messages import Flow
from cfgplan_runtime.lifecycle.back_off import Place
from cfgplan_runtime.lifecycle.changes import (
    ApplyPlan,
    FaultyCode,
    KillUnit,
    LoseHost,
    RegainHost,
    ReplaceWorld,
    RestartUnits,
    ReviewNow,
    SetFact,
    Stop,
)
from cfgplan_runtime.lifecycle.configuration import check_host, hosts_of, is_external, is_outdated
from cfgplan_runtime.lifecycle.differences import difference
from cfgplan_runtime.lifecycle.fact_values import fact_set
from cfgplan_runtime.lifecycle.inbox import Asked, Outcome
from cfgplan_runtime.lifecycle.kinds import kind_of
from cfgplan_runtime.lifecycle.link_rates import Crossings
from cfgplan_runtime.lifecycle.perturbations import (
    CodeChanged,
    HostBack,
    HostGone,
    LinkMeasured,
    ReviewRequested,
    Started,
    SubscriptionLost,
    TargetSilent,
    UnitGone,
    UnitKeepsFailing,
    WorldChanged,
)
from cfgplan_runtime.lifecycle.reports import OldCodeRuns, WorldRefused
from cfgplan_runtime.lifecycle.seen_qualities import losing_streams
from cfgplan_runtime.lifecycle.state import Note, State, Updating
from cfgplan_runtime.lifecycle.stream_qualities import qualities_restated
from cfgplan_runtime.lifecycle.transitions import (
    LearnOfFailure,
    Match,
    Matched,
    Remember,
    Respond,
    Tell,
    Terminate,
    Transition,
)
from cfgplan_runtime.supervision import events
from cfgplan_runtime.supervision.delays import doubling_s

IN_A_ROW_S = 10.0
"""Losses of one input are in a row if less than this lies between them."""


def heard(transition: Transition, event: events.Event) -> Transition:
    """Handle an event of a unit. An event before its death (hung, too large, failed) is recorded as the cause."""
    state = transition.state
    match event:
        case events.UnitReady(unit):
            return _unnoted(transition, unit)
        case events.UnitStopped(unit):
            return _unnoted(transition, unit).answered(unit)
        case events.UnitHung(unit) | events.UnitTooLarge(unit):
            return _noted(transition, unit, replace(_note(state, unit), end=kind_of(event).blame))
        case events.UnitFailed(unit, text=text) if text:
            return _noted(transition, unit, replace(_note(state, unit), error=text))
        case events.UnitDied():
            return _gone(transition, event)
        case events.SparePrepared(spare):
            return transition.situated(replace(state.situation, prepared=state.situation.prepared | {spare}))
        case events.SpareLost(spare) | events.SpareUsed(_, spare):
            return transition.situated(replace(state.situation, prepared=state.situation.prepared - {spare}))
        case events.UnitFound(unit, age_s):
            return _found(transition, unit, age_s)
        case events.FailuresKept():
            return _restored(transition, event)
        case events.HostLost(host, cause):
            return _host_lost(transition, host, cause)
        case events.HostJoined(host, ahead_us):
            return _host_joined(transition, host, ahead_us)
        case events.ClockMoved(host, ahead_us):
            clocks = {**state.situation.clocks_ahead_us, host: ahead_us}
            return transition.situated(replace(state.situation, clocks_ahead_us=clocks))
        case events.InputLost(unit_or_none, port):
            return _lost(transition, SubscriptionLost(unit_or_none, port))
        case events.UnitStatus():
            seen = state.seen.after_status(event, transition.at_s)
            if losing := losing_streams(state.running, state.version.world.environment):
                seen = seen.after_counts(event, losing, transition.at_s)
            transition = transition.to(replace(state, seen=seen))
            return _still_failing(_giving(transition, event), event)
        case events.CrossingsStatus(crossings):
            return _crossings_counted(transition, crossings)
        case events.TopicsStatus(flows) if state.version.may_be_silent or state.situation.silences:
            return _silent(transition, flows)
    return transition


def died(transition: Transition, gone: UnitGone, lived_s: float | None) -> Transition:
    """Handle the end of a unit that was not told to end: blame its transformation unless `lived_s` is None.

    The review answers requests that wait for the unit's end.
    """
    if lived_s is not None:
        transition = transition.blamed(Place(gone.transformation, gone.host), lived_s, gone.cause)
    outcomes = transition.state.waiting.get(gone.unit, ())
    return transition.no_more_awaited(gone.unit).perturbed(gone, outcomes)


def asked(transition: Transition, request: Asked) -> Transition:
    """Handle a request for a change."""
    state, situation, outcomes = transition.state, transition.state.situation, (request.outcome,)
    try:
        match request.change:
            case Stop():
                return transition.to(replace(state, stops=(*state.stops, request.outcome)))
            case KillUnit(unit):
                return _killed(transition, unit, request)
            case RestartUnits(units):
                return _to_be_restarted(transition, units, request)
            case LoseHost(host, cause):
                check_host(state.version.world.environment, host)
                given_up = replace(situation, given_up_hosts=situation.given_up_hosts | {host})
                return transition.situated(given_up).perturbed(HostGone(host, cause), outcomes)
            case RegainHost(host):
                if host not in situation.given_up_hosts:
                    is_lost = host in situation.lost_hosts(state.version.world.environment)
                    mend = "the run uses it as soon as it can be reached" if is_lost else None
                    raise InputError.of(f"host {host!r} was not taken out of service", mend=mend)
                back = replace(situation, given_up_hosts=situation.given_up_hosts - {host})
                return transition.situated(back).perturbed(HostBack(host), outcomes)
            case SetFact(name, value):
                return fact_set(transition, name, value, request)
            case FaultyCode(faults, changed):
                return _code_looked_at(transition, faults, changed, request)
            case ReviewNow(by):
                forgiven = replace(situation, back_offs=situation.back_offs.forgiving_all())
                return transition.situated(forgiven).perturbed(ReviewRequested(by), outcomes)
            case ApplyPlan():
                return transition.to(replace(state, given=(*state.given, request)))
            case change:
                return transition.also(Match(state.version, request, change))
    except InputError as error:
        return transition.also(Respond(request.outcome, error))


def _code_looked_at(
    transition: Transition, faults: Mapping[str, str], changed: tuple[str, ...], request: Asked
) -> Transition:
    """The code of some transformations can't be started. A review is due only if other ones may start now."""
    situation = transition.state.situation
    mended = situation.code_faults.keys() - faults.keys()
    waiting = {place.label for place in situation.back_offs.avoided} & {*changed, *mended}
    left_out, back = faults.keys() - situation.code_faults.keys(), (mended | waiting) - faults.keys()
    back_offs = situation.back_offs.forgiving(*changed, *mended)
    transition = transition.situated(replace(situation, code_faults=faults, back_offs=back_offs))
    if not (left_out or back):
        return transition.also(Respond(request.outcome))
    causes = tuple(sorted({faults[label] for label in left_out}))
    return transition.perturbed(CodeChanged(tuple(sorted(left_out)), tuple(sorted(back)), causes), (request.outcome,))


def matched(transition: Transition, result: Matched) -> Transition:
    """Handle the answer to Match: the world after a change, or the error of a bad change."""
    change, outcome, found = result.asked.change, result.asked.outcome, result.found
    if isinstance(found, InputError):
        if isinstance(change, ReplaceWorld):
            transition = refused(transition, change.by, found.faults)
        return transition.also(Respond(outcome, found))
    state, situation = transition.state, transition.state.situation
    differs = difference(state.version.world, found.world)
    is_new = (*differs.replaced_transformations, *differs.removed_transformations)
    transition = transition.to(replace(state, version=found, match_s=state.match_s + result.seconds))
    transition = transition.situated(replace(situation, back_offs=situation.back_offs.forgiving(*is_new)))
    transition = qualities_restated(transition, state.version.world.environment)
    if isinstance(change, ReplaceWorld):
        transition = refused(transition, change.by, ())
    if not differs:
        return transition.also(Respond(outcome))
    if isinstance(change, ReplaceWorld) and change.code_faults is not None:
        situation = transition.state.situation
        mended = situation.code_faults.keys() - change.code_faults.keys()
        back_offs = situation.back_offs.forgiving(*mended)
        transition = transition.situated(replace(situation, code_faults=change.code_faults, back_offs=back_offs))
    by = change.by if isinstance(change, ReplaceWorld) else type(change).__name__
    return transition.perturbed(WorldChanged(by, differs), [outcome])


def refused(transition: Transition, by: str, faults: tuple[Fault, ...]) -> Transition:
    """Report that the world's file has errors; without faults, that it is valid again."""
    if not (faults or transition.state.faults):
        return transition
    return transition.to(replace(transition.state, faults=faults)).also(Tell(WorldRefused(by, faults)))


def old_code_found(transition: Transition, file: str, units: tuple[str, ...]) -> Transition:
    """Report which units run with the code from before an edit of `file`; none if the last of them has ended.

    If only some of the reported ones have ended, nothing is reported.
    """
    known = transition.state.old_code
    others = {other: there for other, there in known.items() if other != file}
    transition = transition.to(replace(transition.state, old_code={**others, file: units} if units else others))
    is_less, before = set(units) < set(known.get(file, ())), bool(known.get(file))
    if (not units and not before) or (units and is_less):
        return transition
    return transition.also(Tell(OldCodeRuns(file, units)))


def _crossings_counted(transition: Transition, crossings: Crossings) -> Transition:
    """Take in counts of streams between hosts. A review is due if a link is found to have another rate."""
    state, situation, world = transition.state, transition.state.situation, transition.state.version.world.environment
    known = state.link_rates.after(crossings, world, transition.at_s)
    if known is state.link_rates:
        return transition
    before, now = situation.link_rates, known.rates(world)
    transition = transition.to(replace(state, link_rates=known))
    if now == before:
        return transition
    transition = transition.situated(replace(situation, link_rates=now))
    for ends in sorted(now.keys() | before.keys()):
        if now.get(ends) != before.get(ends):
            transition = transition.perturbed(LinkMeasured(ends, now.get(ends)))
    return transition


def _note(state: State, unit: str) -> Note:
    return state.notes.get(unit, Note())


def _noted(transition: Transition, unit: str, note: Note) -> Transition:
    return transition.to(replace(transition.state, notes={**transition.state.notes, unit: note}))


def _unnoted(transition: Transition, unit: str) -> Transition:
    """Forget the notes about a unit that has ended, or whose id another unit has now."""
    left = {other: note for other, note in transition.state.notes.items() if other != unit}
    return transition.to(replace(transition.state, notes=left, seen=transition.state.seen.without(unit)))


def _found(transition: Transition, unit: str, age_s: float) -> Transition:
    """Record the age of a unit that an earlier manager has left: failures after a short life count in a row."""
    running, situation = transition.state.running, transition.state.situation
    found = [one for one in running.units if one.id == unit]
    return transition.situated(situation.with_started(found, running, transition.at_s - age_s))


def _restored(transition: Transition, kept: events.FailuresKept) -> Transition:
    """Continue with the failures on a host that an earlier manager has counted, unless the world starts these
    units differently now: such failures are forgotten.
    """
    situation, world = transition.state.situation, transition.state.version.world.environment
    place = Place(kept.transformation, kept.host)
    if not kept.is_of(world.transformation.get(place.label)) and place not in situation.back_offs.records:
        return transition.also(Remember(place, None))
    back_offs = situation.back_offs.restoring(kept, transition.at_s)
    if back_offs is situation.back_offs:
        return transition
    transition = transition.also(*[LearnOfFailure(Place(kept.transformation, kept.host))] * kept.number)
    return transition.situated(replace(situation, back_offs=back_offs)).telling_back_off(kept.transformation)


def _gone(transition: Transition, event: events.UnitDied) -> Transition:
    unit, state, situation = event.unit, transition.state, transition.state.situation
    note = _note(state, unit)
    transition = _unnoted(transition, unit)
    if unit not in situation.units:
        return transition.answered(unit)
    running, is_killed = situation.units[unit], unit in situation.killed
    how = "killed" if is_killed else note.end or event.how
    gone = UnitGone(unit, running.transformation.label, how, event.cause, running.host)
    is_ours = is_killed or how == "was given up" or unit in situation.failing
    is_blameless = is_ours or is_outdated(running, state.version.world.environment)
    lived_s = None if is_blameless else transition.at_s - running.since_s
    transition = transition.situated(situation.without(unit))
    if isinstance(state.doing, Updating) and unit in state.doing.starting:  # the update's end tells what it means
        doing = replace(state.doing, gone=(*state.doing.gone, (gone, lived_s)))
        return transition.to(replace(transition.state, doing=doing)).answered(unit)
    return died(transition, gone, lived_s)


def _host_lost(transition: Transition, host: str, cause: str) -> Transition:
    """A host is lost with its units; no transformation is blamed. The review answers requests that wait for
    their end.
    """
    state, situation = transition.state, transition.state.situation
    gone = [unit for unit, running in situation.units.items() if running.host == host]
    outcomes = [outcome for unit in gone for outcome in state.waiting.get(unit, ())]
    for unit in gone:
        transition = _unnoted(transition, unit).no_more_awaited(unit)
    clocks = {other: ahead_us for other, ahead_us in situation.clocks_ahead_us.items() if other != host}
    presence = {**situation.presence, host: False}
    transition = transition.situated(replace(situation.without(*gone), presence=presence, clocks_ahead_us=clocks))
    is_ours = host in hosts_of(state.version.world.environment)
    return _told_of_host(transition, HostGone(host, cause), outcomes) if is_ours else transition


def _host_joined(transition: Transition, host: str, ahead_us: int) -> Transition:
    """A host has joined."""
    situation, world = transition.state.situation, transition.state.version.world.environment
    was_lost = host in situation.lost_hosts(world)
    situation = replace(
        situation,
        presence={**situation.presence, host: True},
        clocks_ahead_us={**situation.clocks_ahead_us, host: ahead_us},
    )
    transition = transition.situated(situation)
    return _told_of_host(transition, HostBack(host)) if was_lost and not situation.is_lost(host) else transition


def _told_of_host(transition: Transition, told: HostGone | HostBack, outcomes: Sequence[Outcome] = ()) -> Transition:
    """Ask for a review. The very first one waits until the middleware has spoken of each host."""
    state = transition.state
    if outcomes or not any(isinstance(entry.perturbation, Started) for entry in state.entries):
        return transition.perturbed(told, outcomes)
    if not state.situation.presence.keys() >= set(hosts_of(state.version.world.environment)):
        return transition
    entries = (
        replace(entry, due_s=transition.at_s) if isinstance(entry.perturbation, Started) else entry
        for entry in state.entries
    )
    return transition.to(replace(state, entries=tuple(entries)))


def _lost(transition: Transition, lost: SubscriptionLost) -> Transition:
    """Delay the review until the death that explains the loss may have come, and longer after losses in a row."""
    state, policy = transition.state, transition.state.policy
    times, last_s = state.losses.get(lost, (0, transition.at_s))
    times = times + 1 if transition.at_s - last_s < IN_A_ROW_S else 1
    delay_s = max(policy.explain_s, doubling_s(times - 1, policy.retry_s, policy.most_loss_s))
    transition = transition.to(replace(state, losses={**state.losses, lost: (times, transition.at_s)}))
    return transition.perturbed(lost, delay_s=delay_s)


def _giving(transition: Transition, status: events.UnitStatus) -> Transition:
    state = transition.state
    if not state.version.may_be_silent:
        return transition
    return transition.to(replace(state, giving=state.giving.after_status(status, transition.at_s)))


def _still_failing(transition: Transition, status: events.UnitStatus) -> Transition:
    state, unit, policy = transition.state, status.unit, transition.state.policy
    label, note = state.situation.label_of(unit), _note(transition.state, status.unit)
    if label is None or unit in state.situation.failing:
        return transition
    well_s, steps, well_errors = note.well or (transition.at_s, status.steps, status.errors)
    errors = status.errors - well_errors
    if note.well is not None and errors == 0:
        return transition  # nothing is noted while nothing fails: notes on a thousand units take time
    # The step that has begun last may not have failed yet.
    if errors == 0 or status.steps - steps > errors + 1:
        return _noted(transition, unit, replace(note, well=(transition.at_s, status.steps, status.errors)))
    if errors < policy.failing_steps or transition.at_s - well_s < policy.failing_s:
        return transition
    return _given_up(transition, unit, note.error).perturbed(UnitKeepsFailing(unit, label, errors, note.error))


def _given_up(transition: Transition, unit: str, cause: str) -> Transition:
    """Blame a running unit, and have the next review replace it."""
    running, failing = transition.state.situation.units.get(unit), transition.state.situation.failing
    if running is None or unit in failing:
        return transition
    if not is_outdated(running, transition.state.version.world.environment):
        transition = transition.blamed(running.place, transition.at_s - running.since_s, cause)
    return transition.situated(replace(transition.state.situation, failing=failing | {unit}))


def _silent(transition: Transition, flows: Mapping[str, Flow]) -> Transition:
    """Request a review for each target that is silent for too long, repeatedly until it is not."""
    state, wanted, at_s = transition.state, transition.state.version.world.environment, transition.at_s
    giving = state.giving.after_look(state.running, at_s)
    silences = giving.silences(wanted, state.running, flows, at_s)
    giving = giving.after_silences(silences)
    transition = transition.situated(replace(state.situation, silences=silences))
    for silence in silences:
        if at_s - giving.silent_s[silence.target] <= (wanted.target[silence.target].silent_us or 0) / 1e6:
            continue
        giving = giving.after_asking(silence.target, at_s)
        silent_s = at_s - silence.since_s
        for unit in silence.units:
            transition = _given_up(transition, unit, f"it has given nothing for {silent_s:.1f} s")
        transition = transition.perturbed(TargetSilent(silence.target, silence.topic, silent_s, silence.units))
    return transition.to(replace(transition.state, giving=giving))


def _to_be_restarted(transition: Transition, units: tuple[str, ...], request: Asked) -> Transition:
    """Record the units to restart, as soon as no review is due or under way."""
    state, situation = transition.state, transition.state.situation
    library = state.version.world.environment.transformation
    for unit in units:
        _check_runs(state, unit)
        label = state.running.unit[unit].transformation
        if label not in library:
            raise InputError.of(
                f"unit {unit!r} can't be restarted: its transformation {label!r} does not exist any more"
            )
        if is_external(library[label]):
            mend = "restart the node where it was started"
            raise InputError.of(f"unit {unit!r} can't be restarted: its node was not started by this run", mend=mend)
        if label in situation.code_faults:
            mend = "it keeps running the old code; correct the new code"
            raise InputError.of(f"unit {unit!r} can't be restarted: {situation.code_faults[label]}", mend=mend)
    return transition.to(replace(state, given=(*state.given, request)))


def _killed(transition: Transition, unit: str, request: Asked) -> Transition:
    state, situation = transition.state, transition.state.situation
    _check_runs(state, unit)
    waiting = {**state.waiting, unit: (*state.waiting.get(unit, ()), request.outcome)}
    transition = transition.to(replace(state, waiting=waiting))
    return transition.situated(replace(situation, killed=situation.killed | {unit})).also(Terminate(unit))


def _check_runs(state: State, unit: str) -> None:
    running = state.running.unit
    if unit not in running:
        known = ", ".join(running)
        raise InputError.of(f"no unit {unit!r} runs", mend=f"these run: {known}" if known else None)
    if running[unit].standby:
        raise InputError.of(f"unit {unit!r} is a cold spare, and does not run")
