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
from cfgplan_runtime.lifecycle.configuration import check_host, hosts_of, is_external
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
from cfgplan_runtime.lifecycle.reports import WorldRefused
from cfgplan_runtime.lifecycle.seen_qualities import losing_streams
from cfgplan_runtime.lifecycle.state import Note, State, Updating
from cfgplan_runtime.lifecycle.stream_qualities import qualities_restated
from cfgplan_runtime.lifecycle.turns import Match, Matched, Respond, Tell, Terminate, Turn
from cfgplan_runtime.supervision import events
from cfgplan_runtime.supervision.delays import doubling_s

IN_A_ROW_S = 10.0
"""Losses of one input are in a row if less than this lies between them."""


def heard(turn: Turn, event: events.Event) -> Turn:
    """Handle an event of a unit. An event before its death (hung, too large, failed) is recorded as the cause."""
    state = turn.state
    match event:
        case events.UnitReady(unit):
            return _unnoted(turn, unit)
        case events.UnitStopped(unit):
            return _unnoted(turn, unit).answered(unit)
        case events.UnitHung(unit) | events.UnitTooLarge(unit):
            return _noted(turn, unit, replace(_note(state, unit), end=kind_of(event).blame))
        case events.UnitFailed(unit, text=text) if text:
            return _noted(turn, unit, replace(_note(state, unit), error=text))
        case events.UnitDied(unit, cause):
            return _gone(turn, unit, cause)
        case events.SparePrepared(spare):
            return turn.situated(replace(state.situation, prepared=state.situation.prepared | {spare}))
        case events.SpareLost(spare) | events.SpareUsed(_, spare):
            return turn.situated(replace(state.situation, prepared=state.situation.prepared - {spare}))
        case events.HostLost(host, cause):
            return _host_lost(turn, host, cause)
        case events.HostJoined(host, ahead_us):
            return _host_joined(turn, host, ahead_us)
        case events.ClockMoved(host, ahead_us):
            clocks = {**state.situation.clocks_ahead_us, host: ahead_us}
            return turn.situated(replace(state.situation, clocks_ahead_us=clocks))
        case events.InputLost(unit_or_none, port):
            return _lost(turn, SubscriptionLost(unit_or_none, port))
        case events.UnitStatus():
            seen = state.seen.after_status(event, turn.at_s)
            if losing := losing_streams(state.running, state.living.world.environment):
                seen = seen.after_counts(event, losing, turn.at_s)
            turn = turn.to(replace(state, seen=seen))
            return _still_failing(_giving(turn, event), event)
        case events.CrossingsStatus(crossings):
            return _crossings_counted(turn, crossings)
        case events.TopicsStatus(flows) if state.living.may_be_silent or state.situation.silences:
            return _silent(turn, flows)
    return turn


def died(turn: Turn, gone: UnitGone, lived_s: float | None) -> Turn:
    """A unit has ended without being told to: blame it unless `lived_s` is None. The review answers requests that wait
    for its end.
    """
    if lived_s is not None:
        turn = turn.blamed(Place(gone.transformation, gone.host), lived_s, gone.cause)
    outcomes = turn.state.waiting.get(gone.unit, ())
    return turn.no_more_awaited(gone.unit).perturbed(gone, outcomes)


def asked(turn: Turn, request: Asked) -> Turn:
    """Handle a request for a change."""
    state, situation, outcomes = turn.state, turn.state.situation, (request.outcome,)
    try:
        match request.change:
            case Stop():
                return turn.to(replace(state, stops=(*state.stops, request.outcome)))
            case KillUnit(unit):
                return _killed(turn, unit, request)
            case RestartUnits(units):
                return _to_be_restarted(turn, units, request)
            case LoseHost(host, cause):
                check_host(state.living.world.environment, host)
                given_up = replace(situation, given_up_hosts=situation.given_up_hosts | {host})
                return turn.situated(given_up).perturbed(HostGone(host, cause), outcomes)
            case RegainHost(host):
                if host not in situation.given_up_hosts:
                    is_lost = host in situation.lost_hosts(state.living.world.environment)
                    mend = "the run uses it as soon as it can be reached" if is_lost else None
                    raise InputError.of(f"host {host!r} was not taken out of service", mend=mend)
                back = replace(situation, given_up_hosts=situation.given_up_hosts - {host})
                return turn.situated(back).perturbed(HostBack(host), outcomes)
            case SetFact(name, value):
                return fact_set(turn, name, value, request)
            case FaultyCode(faults, changed):
                return _code_looked_at(turn, faults, changed, request)
            case ReviewNow(by):
                forgiven = replace(situation, back_offs=situation.back_offs.forgiving_all())
                return turn.situated(forgiven).perturbed(ReviewRequested(by), outcomes)
            case ApplyPlan():
                return turn.to(replace(state, given=(*state.given, request)))
            case change:
                return turn.also(Match(state.living, request, change))
    except InputError as error:
        return turn.also(Respond(request.outcome, error))


def _code_looked_at(turn: Turn, faults: Mapping[str, str], changed: tuple[str, ...], request: Asked) -> Turn:
    """The code of some transformations can't be started. A review is due only if other ones may start now."""
    situation = turn.state.situation
    mended = situation.code_faults.keys() - faults.keys()
    waiting = {place.label for place in situation.back_offs.avoided} & {*changed, *mended}
    left_out, back = faults.keys() - situation.code_faults.keys(), (mended | waiting) - faults.keys()
    back_offs = situation.back_offs.forgiving(*changed, *mended)
    turn = turn.situated(replace(situation, code_faults=faults, back_offs=back_offs))
    if not (left_out or back):
        return turn.also(Respond(request.outcome))
    return turn.perturbed(CodeChanged(tuple(sorted(left_out)), tuple(sorted(back))), (request.outcome,))


def matched(turn: Turn, result: Matched) -> Turn:
    """The world after a change is known, or the change is bad."""
    change, outcome, found = result.asked.change, result.asked.outcome, result.found
    if isinstance(found, InputError):
        if isinstance(change, ReplaceWorld):
            turn = refused(turn, change.by, found.faults)
        return turn.also(Respond(outcome, found))
    state, situation = turn.state, turn.state.situation
    differs = difference(state.living.world, found.world)
    is_new = (*differs.replaced_transformations, *differs.removed_transformations)
    turn = turn.to(replace(state, living=found, match_s=state.match_s + result.seconds))
    turn = turn.situated(replace(situation, back_offs=situation.back_offs.forgiving(*is_new)))
    turn = qualities_restated(turn, state.living.world.environment)
    if isinstance(change, ReplaceWorld):
        turn = refused(turn, change.by, ())
    if not differs:
        return turn.also(Respond(outcome))
    by = change.by if isinstance(change, ReplaceWorld) else type(change).__name__
    return turn.perturbed(WorldChanged(by, differs), [outcome])


def refused(turn: Turn, by: str, faults: tuple[Fault, ...]) -> Turn:
    """Report that the world's file has errors; without faults, that it is valid again."""
    if not (faults or turn.state.faults):
        return turn
    return turn.to(replace(turn.state, faults=faults)).also(Tell(WorldRefused(by, faults)))


def _crossings_counted(turn: Turn, crossings: Crossings) -> Turn:
    """Take in counts of streams between hosts. A review is due if a link is found to have another rate."""
    state, situation, world = turn.state, turn.state.situation, turn.state.living.world.environment
    known = state.link_rates.after(crossings, world, turn.at_s)
    if known is state.link_rates:
        return turn
    before, now = situation.link_rates, known.rates(world)
    turn = turn.to(replace(state, link_rates=known))
    if now == before:
        return turn
    turn = turn.situated(replace(situation, link_rates=now))
    for ends in sorted(now.keys() | before.keys()):
        if now.get(ends) != before.get(ends):
            turn = turn.perturbed(LinkMeasured(ends, now.get(ends)))
    return turn


def _note(state: State, unit: str) -> Note:
    return state.notes.get(unit, Note())


def _noted(turn: Turn, unit: str, note: Note) -> Turn:
    return turn.to(replace(turn.state, notes={**turn.state.notes, unit: note}))


def _unnoted(turn: Turn, unit: str) -> Turn:
    """Forget the notes about a unit that has ended, or whose id another unit has now."""
    left = {other: note for other, note in turn.state.notes.items() if other != unit}
    return turn.to(replace(turn.state, notes=left, seen=turn.state.seen.without(unit)))


def _gone(turn: Turn, unit: str, cause: str) -> Turn:
    state, situation, note = turn.state, turn.state.situation, _note(turn.state, unit)
    turn = _unnoted(turn, unit)
    if unit not in situation.units:
        return turn.answered(unit)
    running, is_killed = situation.units[unit], unit in situation.killed
    gone = UnitGone(
        unit, running.transformation.label, "killed" if is_killed else note.end or "died", cause, running.host
    )
    lived_s = None if is_killed or unit in situation.failing else turn.at_s - running.since_s
    turn = turn.situated(situation.without(unit))
    if isinstance(state.doing, Updating) and unit in state.doing.starting:  # the update's end tells what it means
        doing = replace(state.doing, gone=(*state.doing.gone, (gone, lived_s)))
        return turn.to(replace(turn.state, doing=doing)).answered(unit)
    return died(turn, gone, lived_s)


def _host_lost(turn: Turn, host: str, cause: str) -> Turn:
    """A host is lost with its units; no transformation is blamed. The review answers requests that wait for
    their end.
    """
    state, situation = turn.state, turn.state.situation
    gone = [unit for unit, running in situation.units.items() if running.host == host]
    outcomes = [outcome for unit in gone for outcome in state.waiting.get(unit, ())]
    for unit in gone:
        turn = _unnoted(turn, unit).no_more_awaited(unit)
    clocks = {other: ahead_us for other, ahead_us in situation.clocks_ahead_us.items() if other != host}
    presence = {**situation.presence, host: False}
    turn = turn.situated(replace(situation.without(*gone), presence=presence, clocks_ahead_us=clocks))
    is_ours = host in hosts_of(state.living.world.environment)
    return _told_of_host(turn, HostGone(host, cause), outcomes) if is_ours else turn


def _host_joined(turn: Turn, host: str, ahead_us: int) -> Turn:
    """A host has joined."""
    situation, world = turn.state.situation, turn.state.living.world.environment
    was_lost = host in situation.lost_hosts(world)
    situation = replace(
        situation,
        presence={**situation.presence, host: True},
        clocks_ahead_us={**situation.clocks_ahead_us, host: ahead_us},
    )
    turn = turn.situated(situation)
    return _told_of_host(turn, HostBack(host)) if was_lost and not situation.is_lost(host) else turn


def _told_of_host(turn: Turn, told: HostGone | HostBack, outcomes: Sequence[Outcome] = ()) -> Turn:
    """Ask for a review. The very first one waits until the middleware has spoken of each host."""
    state = turn.state
    if outcomes or not any(isinstance(entry.perturbation, Started) for entry in state.entries):
        return turn.perturbed(told, outcomes)
    if not state.situation.presence.keys() >= set(hosts_of(state.living.world.environment)):
        return turn
    entries = (
        replace(entry, due_s=turn.at_s) if isinstance(entry.perturbation, Started) else entry for entry in state.entries
    )
    return turn.to(replace(state, entries=tuple(entries)))


def _lost(turn: Turn, lost: SubscriptionLost) -> Turn:
    """Delay the review until the death that explains the loss may have come, and longer after losses in a row."""
    state, policy = turn.state, turn.state.policy
    times, last_s = state.losses.get(lost, (0, turn.at_s))
    times = times + 1 if turn.at_s - last_s < IN_A_ROW_S else 1
    delay_s = max(policy.explain_s, doubling_s(times - 1, policy.retry_s, policy.most_loss_s))
    turn = turn.to(replace(state, losses={**state.losses, lost: (times, turn.at_s)}))
    return turn.perturbed(lost, delay_s=delay_s)


def _giving(turn: Turn, status: events.UnitStatus) -> Turn:
    state = turn.state
    if not state.living.may_be_silent:
        return turn
    return turn.to(replace(state, giving=state.giving.after_status(status, turn.at_s)))


def _still_failing(turn: Turn, status: events.UnitStatus) -> Turn:
    state, unit, policy = turn.state, status.unit, turn.state.policy
    label, note = state.situation.label_of(unit), _note(turn.state, status.unit)
    if label is None or unit in state.situation.failing:
        return turn
    well_s, steps, well_errors = note.well or (turn.at_s, status.steps, status.errors)
    errors = status.errors - well_errors
    if note.well is not None and errors == 0:
        return turn  # nothing is noted while nothing fails: notes on a thousand units take time
    # The step that has begun last may not have failed yet.
    if errors == 0 or status.steps - steps > errors + 1:
        return _noted(turn, unit, replace(note, well=(turn.at_s, status.steps, status.errors)))
    if errors < policy.failing_steps or turn.at_s - well_s < policy.failing_s:
        return turn
    return _given_up(turn, unit, note.error).perturbed(UnitKeepsFailing(unit, label, errors, note.error))


def _given_up(turn: Turn, unit: str, cause: str) -> Turn:
    """Blame a running unit, and have the next review replace it."""
    running, failing = turn.state.situation.units.get(unit), turn.state.situation.failing
    if running is None or unit in failing:
        return turn
    place = Place(running.transformation.label, running.host)
    turn = turn.blamed(place, turn.at_s - running.since_s, cause)
    return turn.situated(replace(turn.state.situation, failing=failing | {unit}))


def _silent(turn: Turn, flows: Mapping[str, Flow]) -> Turn:
    """Request a review for each target that is silent for too long, repeatedly until it is not."""
    state, wanted, at_s = turn.state, turn.state.living.world.environment, turn.at_s
    giving = state.giving.after_look(state.running, at_s)
    silences = giving.silences(wanted, state.running, flows, at_s)
    giving = giving.after_silences(silences)
    turn = turn.situated(replace(state.situation, silences=silences))
    for silence in silences:
        if at_s - giving.silent_s[silence.target] <= (wanted.target[silence.target].silent_us or 0) / 1e6:
            continue
        giving = giving.after_asking(silence.target, at_s)
        silent_s = at_s - silence.since_s
        for unit in silence.units:
            turn = _given_up(turn, unit, f"it has given nothing for {silent_s:.1f} s")
        turn = turn.perturbed(TargetSilent(silence.target, silence.topic, silent_s, silence.units))
    return turn.to(replace(turn.state, giving=giving))


def _to_be_restarted(turn: Turn, units: tuple[str, ...], request: Asked) -> Turn:
    """Record the units to restart, as soon as no review is due or under way."""
    state, situation = turn.state, turn.state.situation
    library = state.living.world.environment.transformation
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
    return turn.to(replace(state, given=(*state.given, request)))


def _killed(turn: Turn, unit: str, request: Asked) -> Turn:
    state, situation = turn.state, turn.state.situation
    _check_runs(state, unit)
    waiting = {**state.waiting, unit: (*state.waiting.get(unit, ()), request.outcome)}
    turn = turn.to(replace(state, waiting=waiting))
    return turn.situated(replace(situation, killed=situation.killed | {unit})).also(Terminate(unit))


def _check_runs(state: State, unit: str) -> None:
    running = state.running.unit
    if unit not in running:
        known = ", ".join(running)
        raise InputError.of(f"no unit {unit!r} runs", mend=f"these run: {known}" if known else None)
    if running[unit].standby:
        raise InputError.of(f"unit {unit!r} is a cold spare, and does not run")
